"""glTF mesh primitives as triangle meshes: modes, morph targets and skins in the rest pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.gltf_data import GltfData
from raykiln.formats.json_text import Item
from raykiln.formats.meshes import Array
from raykiln.scene import Scene

TRIANGLES, STRIP, FAN = 4, 5, 6
_MODE_NAMES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips"}


@dataclass
class Primitive:
    """The arrays of a primitive; `uv_sets` by number."""

    vertices: Array
    faces: Array
    normals: Array | None
    uv_sets: dict[int, Array]
    tint: tuple[float, float, float] | None
    material: int | None
    pointer: str


def primitives(data: GltfData, scene: Scene, mesh: Item, node: Item) -> list[Primitive]:
    """The primitives of a mesh as a node shows it: with its morph weights."""
    default = mesh.sequence("weights")
    weights = node.sequence("weights") or default
    if any(isinstance(w, bool) or not isinstance(w, int | float) for w in weights):
        raise SceneError("morph weights are numbers", pointer=f"{node.pointer}/weights")
    if not mesh.sequence("primitives"):
        raise SceneError("a mesh without primitives", pointer=mesh.pointer)
    made = (_primitive(data, scene, item, weights) for item in mesh.items("primitives"))
    return [p for p in made if p is not None]


def _primitive(data: GltfData, scene: Scene, item: Item, weights: list[float]) -> Primitive | None:
    extensions = item.item("extensions")
    if "KHR_draco_mesh_compression" in extensions:
        scene.warn(f"{item.pointer}: Draco compression is not supported")
    attributes = item.item("attributes")
    mode = item.integer("mode", TRIANGLES)
    if mode > FAN:
        raise SceneError("an unknown mode", pointer=f"{item.pointer}/mode", found=mode,
                         accepted="0 to 6")  # fmt: skip
    if mode in _MODE_NAMES:
        scene.warn(f"{item.pointer}: {_MODE_NAMES[mode]} are not supported and left out")
        return None
    if "POSITION" not in attributes:
        scene.warn(f"{item.pointer}: without positions, and left out")
        return None
    vertices = _attribute(data, attributes, "POSITION", 3)
    normals = _attribute(data, attributes, "NORMAL", 3) if "NORMAL" in attributes else None
    uv_sets: dict[int, Array] = {}
    while f"TEXCOORD_{len(uv_sets)}" in attributes:
        name = f"TEXCOORD_{len(uv_sets)}"
        uv_sets[len(uv_sets)] = _attribute(data, attributes, name, 2)
    for name, array in (("NORMAL", normals), *((f"TEXCOORD_{k}", v) for k, v in uv_sets.items())):
        if array is not None and len(array) != len(vertices):
            raise SceneError(
                f"{name} has {len(array)} elements for {len(vertices)} positions",
                pointer=item.pointer,
            )
    vertices, normals = _morphed(data, item, weights, vertices, normals)
    index = _indices(data, item, len(vertices))
    faces = _triangles(index, mode)
    material = item.integer("material") if "material" in item else None
    tint = _tint(data, scene, attributes, item)
    return Primitive(vertices, faces, normals, uv_sets, tint, material, item.pointer)


def _attribute(data: GltfData, attributes: Item, name: str, width: int) -> Array:
    pointer = f"{attributes.pointer}/{name}"
    values = data.floats(attributes.integer(name), pointer)
    if values.shape[1] != width:
        raise SceneError(f"{name} takes {width} numbers a vertex", pointer=pointer,
                         found=values.shape[1])  # fmt: skip
    return values


def _indices(data: GltfData, item: Item, count: int) -> Array:
    if "indices" not in item:
        return np.arange(count, dtype=np.uint32)
    pointer = f"{item.pointer}/indices"
    values = data.accessor(item.integer("indices"), pointer)
    if values.dtype.kind != "u" or values.shape[1] != 1:
        raise SceneError("indices are unsigned whole numbers", pointer=pointer)
    high = int(values.max())
    if high >= count or high == np.iinfo(values.dtype).max:
        raise SceneError(f"an index refers to vertex {high} of {count}", pointer=pointer)
    return values[:, 0]


def _triangles(index: Array, mode: int) -> Array:
    if mode == TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if len(index) < 3:
        return np.empty((0, 3), np.uint32)
    n = np.arange(len(index) - 2)
    if mode == FAN:
        return np.stack([index[n + 1], index[n + 2], np.broadcast_to(index[0], n.shape)], axis=1)
    odd = n % 2
    return np.stack([index[n], index[n + 1 + odd], index[n + 2 - odd]], axis=1)


def _morphed(
    data: GltfData, item: Item, weights: list[float], vertices: Array, normals: Array | None
) -> tuple[Array, Array | None]:
    """Positions and normals moved by the morph targets whose weight is not 0."""
    for target, weight in zip(item.items("targets"), weights, strict=False):
        if not weight:
            continue
        for name in ("POSITION", "NORMAL"):
            if name not in target:
                continue
            delta = _attribute(data, target, name, 3)
            if len(delta) != len(vertices):
                raise SceneError("a morph target of another size", pointer=target.pointer)
            if name == "POSITION":
                vertices = vertices + np.float32(weight) * delta
            elif normals is not None:
                normals = _unit(normals + np.float32(weight) * delta)
    return vertices, normals


def _tint(
    data: GltfData, scene: Scene, attributes: Item, item: Item
) -> tuple[float, float, float] | None:
    """The vertex colour if it is the same everywhere; else None and a warning."""
    if "COLOR_0" not in attributes:
        return None
    colors = data.floats(attributes.integer("COLOR_0"), f"{attributes.pointer}/COLOR_0")[:, :3]
    if colors.shape[1] < 3 or not (colors == colors[0]).all():
        scene.warn(f"{item.pointer}: vertex colours that vary are not supported and not used")
        return None
    r, g, b = (min(max(float(c), 0.0), 1.0) for c in colors[0])
    return None if (r, g, b) == (1.0, 1.0, 1.0) else (r, g, b)


def skinned(
    data: GltfData, item: Item, skin: Item, shape: Primitive, world: list[Array]
) -> Primitive:
    """A primitive in world space, moved by the joints of its skin (linear blend skinning).

    Parameters
    ----------
    item
        The primitive's JSON.
    world
        The matrices (4, 4) world_from_node of all nodes.
    """
    joints = skin.indices("joints")
    if not joints or max(joints) >= len(world):
        raise SceneError("joints that are not nodes", pointer=f"{skin.pointer}/joints")
    inverse_bind = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    if "inverseBindMatrices" in skin:
        pointer = f"{skin.pointer}/inverseBindMatrices"
        flat = data.floats(skin.integer("inverseBindMatrices"), pointer)
        if flat.shape[1] != 16 or len(flat) < len(joints):
            raise SceneError("not one matrix a joint", pointer=pointer)
        # Stored column by column.
        inverse_bind = flat[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    palette = np.stack([world[j] for j in joints]) @ inverse_bind
    blend = _blend(data, item.item("attributes"), palette, len(shape.vertices))
    vertices = np.einsum("nij,nj->ni", blend[:, :3, :3], shape.vertices) + blend[:, :3, 3]
    normals = shape.normals
    if normals is not None:
        normals = _unit(np.einsum("nij,nj->ni", blend[:, :3, :3], normals))
    return Primitive(vertices.astype(np.float32), shape.faces, normals, shape.uv_sets,
                     shape.tint, shape.material, shape.pointer)  # fmt: skip


def _blend(data: GltfData, attributes: Item, palette: Array, count: int) -> Array:
    """The matrix (n, 4, 4) of each vertex."""
    total = np.zeros((count, 4, 4))
    sum_of_weights = np.zeros(count)
    number = 0
    while f"JOINTS_{number}" in attributes and f"WEIGHTS_{number}" in attributes:
        pointer = f"{attributes.pointer}/JOINTS_{number}"
        joints = data.accessor(attributes.integer(f"JOINTS_{number}"), pointer)
        weights = data.floats(attributes.integer(f"WEIGHTS_{number}"), pointer)
        if joints.dtype.kind != "u" or joints.shape != (count, 4) or weights.shape != (count, 4):
            raise SceneError("joints and weights are four a vertex", pointer=pointer)
        used = np.where(weights != 0, joints, 0)
        if int(used.max(initial=0)) >= len(palette):
            raise SceneError("a vertex refers to a joint that is not there", pointer=pointer)
        for k in range(4):
            total += weights[:, k, None, None] * palette[used[:, k]]
            sum_of_weights += weights[:, k]
        number += 1
    unbound = sum_of_weights == 0
    sum_of_weights[unbound] = 1
    total /= sum_of_weights[:, None, None]
    total[unbound] = np.eye(4)
    return total


def _unit(v: Array) -> Array:
    length = np.linalg.norm(v, axis=1, keepdims=True)
    unit: Array = np.divide(v, length, out=np.zeros_like(v), where=length > 0)
    return unit.astype(np.float32)
