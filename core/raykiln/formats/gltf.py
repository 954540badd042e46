"""glTF 2.0 and GLB scenes."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import MAX_FILE_BYTES, Files
from raykiln.formats.gltf_animation import animate
from raykiln.formats.gltf_data import GLB_MAGIC, GltfData, split_glb
from raykiln.formats.gltf_extras import add_extras
from raykiln.formats.gltf_images import EmbeddedImages
from raykiln.formats.gltf_materials import GltfMaterial, Materials
from raykiln.formats.gltf_meshes import Primitive, primitives, skinned
from raykiln.formats.gltf_textures import Textures
from raykiln.formats.json_text import Item
from raykiln.formats.meshes import Array
from raykiln.formats.names import unique_name
from raykiln.scene import (
    DirectionalLight,
    Instance,
    Mesh,
    PerspectiveCamera,
    PointLight,
    Scene,
    SpotLight,
    TextureRef,
)
from raykiln.studio import rows

SUPPORTED = {
    "KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_ior",
    "KHR_materials_specular", "KHR_materials_transmission", "KHR_materials_unlit",
    "KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp",
}  # fmt: skip
MAX_DEPTH = 512
MAX_CAMERAS = 1024
# A mesh used more than once is instanced from this many triangles on.
INSTANCED_FROM = 64


def read(path: Path, files: Files) -> Scene:
    """The default scene of a glTF or GLB file."""
    content = files.read(path, limit=MAX_FILE_BYTES)
    text, binary = content, None
    if path.suffix.lower() == ".glb" or content[:4] == GLB_MAGIC.to_bytes(4, "little"):
        text, binary = split_glb(content)
    data = GltfData(files, text, binary)
    scene = Scene(name=path.stem)
    _check_asset(data, scene)
    images = EmbeddedImages(data)
    with images.decoding():
        _Reader(data, scene, images).read()
    return scene


def _check_asset(data: GltfData, scene: Scene) -> None:
    root = data.root
    asset = root.item("asset")
    version = asset.string("minVersion", asset.string("version"))
    if not version.startswith("2."):
        raise SceneError("another version of glTF", pointer="/asset/version", found=version,
                         accepted="2.0")  # fmt: skip
    required = [name for name in root.sequence("extensionsRequired") if name not in SUPPORTED]
    if required:
        raise SceneError(
            "the file requires an extension that is not supported",
            pointer="/extensionsRequired",
            found=required[0],
            accepted=" ".join(sorted(SUPPORTED)),
        )
    for name in root.sequence("extensionsUsed"):
        # Those of materials are named where they are used.
        if name not in SUPPORTED and not str(name).startswith("KHR_materials_"):
            scene.warn(f"the extension {str(name)[:100]} is not supported and not used")


class _Reader:
    def __init__(self, data: GltfData, scene: Scene, images: EmbeddedImages) -> None:
        self.data, self.scene, self.images = data, scene, images
        self.root = data.root
        self.nodes = list(data.root.items("nodes"))
        animate(data, self.nodes, scene, data.files.time_s)
        self.materials = Materials(data, scene, Textures(data, scene, images))
        self.world: list[Array] = [np.eye(4) for _ in self.nodes]
        self.shown: list[int] = []

    def read(self) -> None:
        """Fill the scene."""
        self._walk()
        placed: dict[int, list[int]] = defaultdict(list)
        for number in self.shown:
            node = self.nodes[number]
            if "mesh" in node:
                placed[node.integer("mesh")].append(number)
            if "camera" in node:
                self._camera(node, self.world[number])
            lights = node.item("extensions").item("KHR_lights_punctual")
            if "light" in lights:
                self._light(lights, self.world[number])
        for mesh, numbers in placed.items():
            self._mesh(mesh, numbers)
        if self.root.sequence("scenes"):
            index = self.root.integer("scene", 0)
            shown = self.root.entry("scenes", index, "/scene")
            add_extras(shown, self.data.files, self.scene)
        self._check_unshown(set(placed))

    def _check_unshown(self, shown_meshes: set[int]) -> None:
        """Read what the scene does not show too, so that a broken file is never half accepted."""
        aside = _Reader(self.data, Scene(), self.images)
        seen = [False] * len(self.nodes)
        aside._descend(self._tops(), seen)
        if not all(seen):
            number = seen.index(False)
            raise SceneError("a node is its own ancestor", pointer=self.nodes[number].pointer)
        for i, mesh in enumerate(self.root.items("meshes")):
            if i not in shown_meshes:
                for primitive in primitives(self.data, aside.scene, mesh, Item({}, "")):
                    aside.materials.get(primitive.material, f"{primitive.pointer}/material")
        for i, material in enumerate(self.root.items("materials")):
            if not self.materials.has(i):
                aside.materials.get(i, material.pointer)
        for i, _ in enumerate(self.root.items("cameras")):
            aside._camera(Item({"camera": i}, "/cameras"), np.eye(4))
        extension = self.root.item("extensions").item("KHR_lights_punctual")
        for i, _ in enumerate(extension.items("lights")):
            aside._light(Item({"light": i}, extension.pointer), np.eye(4))

    def _walk(self) -> None:
        """Find the nodes of the scene and their matrices; a node may be shown once."""
        self._descend(self._roots(), [False] * len(self.nodes))

    def _descend(self, roots: list[int], seen: list[bool]) -> None:
        pending = [(number, np.eye(4), 0) for number in reversed(roots)]
        while pending:
            number, parent, depth = pending.pop()
            if number >= len(self.nodes):
                raise SceneError("a reference to no node", found=number)
            node = self.nodes[number]
            if seen[number]:
                raise SceneError(
                    "a node is the child of two nodes or of itself", pointer=node.pointer
                )
            if depth > MAX_DEPTH:
                raise SceneError(f"nodes are nested over {MAX_DEPTH} deep", pointer=node.pointer)
            seen[number] = True
            self.world[number] = parent @ _local(node)
            self.shown.append(number)
            children = reversed(node.indices("children"))
            pending.extend((child, self.world[number], depth + 1) for child in children)

    def _roots(self) -> list[int]:
        if self.root.sequence("scenes") or "scene" in self.root:
            index = self.root.integer("scene", 0)
            return self.root.entry("scenes", index, "/scene").indices("nodes")
        return self._tops()

    def _tops(self) -> list[int]:
        """The nodes that are no node's child."""
        children = {c for node in self.nodes for c in node.indices("children")}
        return [number for number in range(len(self.nodes)) if number not in children]

    def _mesh(self, index: int, numbers: list[int]) -> None:
        """Add a mesh at all nodes that show it."""
        mesh = self.root.entry("meshes", index, f"{self.nodes[numbers[0]].pointer}/mesh")
        alike = [n for n in numbers if not ({"skin", "weights"} & self.nodes[n].data.keys())]
        for number in sorted(set(numbers) - set(alike)):
            self._shapes(mesh, [number])
        if alike:
            self._shapes(mesh, alike)

    def _shapes(self, mesh: Item, numbers: list[int]) -> None:
        node = self.nodes[numbers[0]]
        found = primitives(self.data, self.scene, mesh, node)
        name = mesh.string("name", "")[:200] or node.string("name", "")[:200] or None
        matrices: list[Array] | None = [self.world[n] for n in numbers]
        if "skin" in node:
            skin = self.root.entry("skins", node.integer("skin"), f"{node.pointer}/skin")
            items = {item.pointer: item for item in mesh.items("primitives")}
            if any("JOINTS_0" in items[p.pointer].item("attributes") for p in found):
                found = [skinned(self.data, items[p.pointer], skin, p, self.world) for p in found]
                matrices = None
        instanced: list[Mesh] = []
        for primitive in found:
            if not len(primitive.faces):
                continue
            shape = self._shape(primitive, name)
            if matrices is None:
                self.scene.shapes.append(shape)
            elif (
                len(matrices) > 1
                and shape.emission is None
                and len(primitive.faces) >= INSTANCED_FROM
            ):
                instanced.append(shape)
            else:
                for matrix in matrices:
                    placed = shape.model_copy(update={"transform": _placement(matrix)})
                    self.scene.shapes.append(placed)
        if instanced and matrices:
            self._instances(mesh, instanced, matrices)

    def _instances(self, mesh: Item, shapes: list[Mesh], matrices: list[Array]) -> None:
        label = mesh.string("name", "") or mesh.pointer.lstrip("/")
        name = unique_name(label, self.scene.groups)
        self.scene.groups[name] = list(shapes)
        transforms = np.array(matrices, np.float32)
        self.scene.shapes.append(Instance(group=name, transforms=transforms))

    def _shape(self, primitive: Primitive, name: str | None) -> Mesh:
        material = self.materials.get(primitive.material, f"{primitive.pointer}/material")
        uvs = primitive.uv_sets.get(material.coordinates)
        material_name = self._tinted(material, primitive.tint)
        try:
            return Mesh.model_validate(
                {
                    "name": name,
                    "material": material_name,
                    "emission": material.emission,
                    "vertices": primitive.vertices,
                    "faces": primitive.faces,
                    "normals": primitive.normals,
                    "uvs": uvs,
                }
            )
        except ValueError as error:
            reason = str(error).split("Value error, ")[-1].split(" [")[0]
            raise SceneError(reason, pointer=primitive.pointer) from None

    def _tinted(self, material: GltfMaterial, tint: tuple[float, float, float] | None) -> str:
        """The material whose base colour is multiplied by a vertex colour."""
        if tint is None:
            return material.name
        base = self.scene.materials[material.name]
        if base.type != "principled":
            return material.name
        color = base.base_color
        inner: Any = color.factor if isinstance(color, TextureRef) else color
        factors = inner if isinstance(inner, tuple) else (inner,) * 3
        product = tuple(a * b for a, b in zip(factors, tint, strict=True))
        new: Any = product
        if isinstance(color, TextureRef):
            new = color.model_copy(update={"factor": product})
        name = f"{material.name} x {tint[0]:.4g} {tint[1]:.4g} {tint[2]:.4g}"
        self.scene.materials[name] = base.model_copy(update={"base_color": new})
        return name

    def _camera(self, node: Item, world: Array) -> None:
        camera = self.root.entry("cameras", node.integer("camera"), f"{node.pointer}/camera")
        if camera.string("type") != "perspective":
            self.scene.warn(f"{camera.pointer}: only perspective cameras are supported; left out")
            return
        lens = camera.item("perspective")
        fov = math.degrees(lens.number("yfov"))
        if not 0 < fov < 180:
            self.scene.warn(f"{lens.pointer}: a field of view of {fov:.4g} degrees; left out")
            return
        near, far = lens.number("znear"), lens.number("zfar", 1e30)
        if not 0 <= near < far:
            raise SceneError("znear and zfar out of order", pointer=lens.pointer)
        if len(self.scene.cameras) >= MAX_CAMERAS:
            raise SceneError(f"more than {MAX_CAMERAS} cameras", pointer=node.pointer)
        label = camera.string("name", "") or node.string("name", "") or "camera"
        name = unique_name(label, {c.name for c in self.scene.cameras})
        self.scene.cameras.append(
            PerspectiveCamera(
                name=name, fov_deg=fov, fov_axis="y", transform=rows(world), near=near, far=far
            )
        )

    def _light(self, reference: Item, world: Array) -> None:
        extension = self.root.item("extensions").item("KHR_lights_punctual")
        light = extension.entry("lights", reference.integer("light"), f"{reference.pointer}/light")
        color = light.numbers("color", 3, [1.0, 1.0, 1.0])
        strength = light.number("intensity", 1.0)
        if strength < 0 or min(color) < 0:
            raise SceneError("a negative light", pointer=light.pointer)
        power = (color[0] * strength, color[1] * strength, color[2] * strength)
        if "range" in light:
            self.scene.warn(f"{light.pointer}: the range of a light is not used")
        position = tuple(float(x) for x in world[:3, 3])
        direction = tuple(float(x) for x in _direction(world))
        match light.string("type"):
            case "directional":
                self.scene.add_light(DirectionalLight(direction=direction, irradiance=power))
            case "point":
                self.scene.add_light(PointLight(position=position, intensity=power))
            case "spot":
                spot = light.item("spot")
                inner = spot.number("innerConeAngle", 0.0)
                outer = spot.number("outerConeAngle", math.pi / 4)
                if not 0 <= inner < outer <= math.pi / 2 + 1e-6:
                    raise SceneError("cone angles out of order", pointer=spot.pointer)
                self.scene.add_light(
                    SpotLight(
                        position=position,
                        direction=direction,
                        intensity=power,
                        inner_angle_deg=math.degrees(inner),
                        outer_angle_deg=math.degrees(outer),
                    )
                )
            case other:
                self.scene.warn(f"{light.pointer}: lights of type '{other[:100]}' are left out")


def _local(node: Item) -> Array:
    """The matrix parent_from_node."""
    if "matrix" in node:
        # Stored column by column.
        return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
    x, y, z, w = node.numbers("rotation", 4, [0.0, 0.0, 0.0, 1.0])
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not norm > 0:
        raise SceneError("a rotation of zero length", pointer=f"{node.pointer}/rotation")
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * node.numbers("scale", 3, [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.numbers("translation", 3, [0.0, 0.0, 0.0])
    return matrix


def _placement(matrix: Array) -> Any:
    return None if (matrix == np.eye(4)).all() else rows(matrix)


def _direction(world: Array) -> Array:
    """The way a light at a node shines: along its -z."""
    direction = -world[:3, 2]
    length = np.linalg.norm(direction)
    unit: Array = direction / length if length > 0 else np.array([0.0, 0.0, -1.0])
    return unit
