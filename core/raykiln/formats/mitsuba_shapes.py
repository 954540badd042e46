"""Mitsuba shapes and shape groups."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats import obj, ply, serialized
from raykiln.formats.files import scene_errors
from raykiln.formats.meshes import MeshData, smooth_normals
from raykiln.formats.mitsuba_bsdfs import Materials
from raykiln.formats.mitsuba_objects import MitsubaObject
from raykiln.formats.mitsuba_patches import PATCHES
from raykiln.formats.mitsuba_textures import Context
from raykiln.formats.mitsuba_transforms import Matrix
from raykiln.formats.names import unique_name
from raykiln.scene import (
    Cube,
    Disk,
    Emission,
    Instance,
    Mesh,
    NormalMap,
    Rectangle,
    Sphere,
    TextureRef,
)
from raykiln.studio import rows

_PRIMITIVES: dict[str, type[Rectangle] | type[Cube] | type[Disk]] = {
    "rectangle": Rectangle,
    "cube": Cube,
    "disk": Disk,
}
# Our spheres have their poles on y and u = 0 at -z; Mitsuba's have them on z and u = 0 at +x.
_MITSUBA_FROM_OUR_SPHERE = np.array(
    [[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
_MESHES = ("obj", "ply", "serialized")


class Shapes:
    """Makes shapes and puts them into the scene."""

    def __init__(self, context: Context, materials: Materials) -> None:
        self.context, self.materials = context, materials
        self._meshes: dict[tuple[Path, int], MeshData] = {}
        self._groups: dict[int, str] = {}
        self._instances: dict[str, list[Matrix]] = defaultdict(list)

    def add(self, owner: MitsubaObject) -> None:
        """Add a top-level shape object."""
        if owner.type == "shapegroup":
            self._group(owner)
        elif owner.type == "instance":
            self._instance(owner)
        else:
            shape = self._shape(owner)
            if shape is not None:
                self.context.scene.shapes.append(shape)

    def finish(self) -> None:
        """Add the collected instances: one entry a group."""
        for group, matrices in self._instances.items():
            transforms = np.array(matrices, np.float32)
            self.context.scene.shapes.append(Instance(group=group, transforms=transforms))

    def _group(self, owner: MitsubaObject) -> str:
        key = id(owner)
        if key not in self._groups:
            groups = self.context.scene.groups
            name = unique_name(owner.id or f"group_line_{owner.line}", groups)
            made = [self._shape(child) for child in owner.tagged("shape")]
            groups[name] = [shape for shape in made if shape is not None]
            self._groups[key] = name
            owner.used.update(name for name, _ in owner.children)
        return self._groups[key]

    def _instance(self, owner: MitsubaObject) -> None:
        groups = [child for child in owner.tagged("shape") if child.type == "shapegroup"]
        if len(groups) != 1:
            raise SceneError("an instance takes one shape group", pointer=owner.pointer)
        owner.used.update(name for name, _ in owner.children)
        matrix = owner.matrix("to_world")
        self._instances[self._group(groups[0])].append(np.eye(4) if matrix is None else matrix)

    def _shape(self, owner: MitsubaObject) -> Any:
        if owner.type not in _MESHES and owner.type not in _PRIMITIVES and owner.type != "sphere":
            self.context.warn(owner, "this shape is not supported and left out")
            return None
        values: dict[str, Any] = {
            "name": owner.id[:256] if owner.id else None,
            "material": self._material(owner),
            "emission": self._emission(owner),
            "flip_normals": owner.boolean("flip_normals", False),
        }
        if owner.tagged("medium"):
            self.context.warn(owner, "media are not supported and not used")
        owner.used.update(name for name, child in owner.children if child.tag != "texture")
        matrix = owner.matrix("to_world")
        if owner.type in _MESHES:
            return self._mesh(owner, matrix, values)
        if owner.type == "sphere":
            return self._sphere(owner, matrix, values)
        values["transform"] = None if matrix is None else rows(matrix)
        if self._shows_uv(values):
            return Mesh.model_validate({**values, **PATCHES[owner.type]()})
        return _PRIMITIVES[owner.type](**values)

    def _shows_uv(self, values: dict[str, Any]) -> bool:
        """Whether texture coordinates matter: then the shape is made with Mitsuba's."""
        material = self.context.scene.materials[values["material"]]
        emission = values["emission"]
        if getattr(material, "alpha_v", None) is not None:
            return True  # roughness that differs along u and v
        fields = [*material.__dict__.values(), emission.radiance if emission else None]
        return any(isinstance(field, TextureRef | NormalMap) for field in fields)

    def _sphere(
        self, owner: MitsubaObject, matrix: Matrix | None, values: dict[str, Any]
    ) -> Sphere:
        radius = owner.float("radius", 1.0)
        if not radius > 0:
            raise SceneError("a radius must be positive", pointer=owner.pointer, found=radius)
        if matrix is not None and np.linalg.det(matrix[:3, :3]) < 0:
            # A mirrored sphere of Mitsuba turns inside out.
            values["flip_normals"] = not values["flip_normals"]
        center = owner.get("center", list, [0.0, 0.0, 0.0])
        if self._shows_uv(values):
            place = np.eye(4) if matrix is None else matrix.copy()
            place[:3, 3] += place[:3, :3] @ center
            center, matrix = [0.0, 0.0, 0.0], place @ _MITSUBA_FROM_OUR_SPHERE
        transform = None if matrix is None else rows(matrix)
        return Sphere(center=tuple(center), radius=radius, transform=transform, **values)

    def _mesh(self, owner: MitsubaObject, matrix: Matrix | None, values: dict[str, Any]) -> Mesh:
        """A mesh in world space: Mitsuba smooths the normals after the transform."""
        data, flipped, smooth = self._data(owner)
        vertices, faces, uvs = data.vertices, data.faces, data.uvs
        normals = None if owner.boolean("face_normals", False) else data.normals
        if matrix is not None:
            inverse = _inverse(matrix[:3, :3], owner)
            vertices = (vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
            if normals is not None:
                normals = _unit(normals @ inverse)
                if np.linalg.det(inverse) < 0:
                    # The given normals say which side is out, so the faces must turn with them.
                    faces = faces[:, ::-1]
        if owner.boolean("face_normals", False):
            smooth = False
        if normals is None and smooth and len(faces):
            _check_faces(data, owner)
            normals = smooth_normals(vertices, faces)
        if uvs is not None and owner.boolean("flip_tex_coords", owner.type == "obj") != flipped:
            uvs = np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)
        owner.used.update(("flip_tex_coords", "face_normals", "max_smooth_angle"))
        return Mesh.model_validate(
            {**values, "vertices": vertices, "faces": faces, "normals": normals, "uvs": uvs}
        )

    def _data(self, owner: MitsubaObject) -> tuple[MeshData, bool, bool]:
        """Arrays of a mesh file; whether v was flipped; whether to smooth if without normals."""
        path = self.context.document.resolve(
            owner.string("filename", ""), owner, f"{owner.pointer}, filename"
        )
        index = owner.integer("shape_index", 0) if owner.type == "serialized" else 0
        readers: dict[str, Callable[[Path], MeshData]] = {
            "obj": obj.read_mesh,
            "ply": ply.read_mesh,
            "serialized": lambda path: serialized.read_mesh(path, index),
        }
        with scene_errors(path):
            if (path, index) not in self._meshes:
                self._meshes[path, index] = readers[owner.type](path)
            smooth = owner.type != "serialized" or serialized.smooth(path, index)
        data = self._meshes[path, index]
        for message in data.warnings:
            self.context.warn(owner, message)
        return data, owner.type == "obj", smooth

    def _material(self, owner: MitsubaObject) -> str:
        found = owner.tagged("bsdf")
        if not found:
            return self.materials.default_name(shines=bool(owner.tagged("emitter")))
        if len(found) > 1:
            self.context.warn(owner, "more than one BSDF; the last is used")
        return self.materials.name(found[-1])

    def _emission(self, owner: MitsubaObject) -> Emission | None:
        for emitter in owner.tagged("emitter"):
            if emitter.type != "area":
                self.context.warn(emitter, "only area emitters are supported on shapes")
                continue
            radiance = self.context.color(emitter, "radiance", 1.0, "emission")
            scale = emitter.float("scale", 1.0)
            if scale != 1.0:
                self.context.warn(emitter, "'scale' of an area emitter is not supported")
            return Emission(radiance=radiance)
        return None


def _unit(normals: Any) -> Any:
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0).astype(
        np.float32
    )


def _inverse(linear: Any, owner: MitsubaObject) -> Any:
    try:
        return np.linalg.inv(linear)
    except np.linalg.LinAlgError:
        raise SceneError("the transform is singular", pointer=owner.pointer) from None


def _check_faces(data: MeshData, owner: MitsubaObject) -> None:
    high = int(data.faces.max())
    if high >= len(data.vertices):
        raise SceneError(
            f"a face refers to vertex {high} of {len(data.vertices)}", pointer=owner.pointer
        )
