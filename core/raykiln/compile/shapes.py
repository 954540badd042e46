"""Shapes: moved to where they belong, as meshes, spheres and instances of the core."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln import primitives
from raykiln.compile.build import Build, Rgb, names_of
from raykiln.compile.materials import Materials
from raykiln.compile.textures import Textures
from raykiln.errors import SceneError
from raykiln.scene import Cube, Disk, Emission, Instance, Mesh, Rectangle, Shape, Sphere

Matrix = NDArray[np.float64]


class Shapes:
    """Adds groups, then the shapes of the world."""

    def __init__(self, build: Build, textures: Textures, materials: Materials) -> None:
        self._build = build
        self._textures = textures
        self._materials = materials
        self._groups: dict[str, int] = {}

    def add_all(self) -> None:
        """Add every shape of the scene."""
        scene = self._build.scene
        for name, shapes in scene.groups.items():
            self._groups[name] = self._build.core.add_group()
            for i, inner in enumerate(shapes):
                self._add(inner, self._groups[name], f"/groups/{name}/{i}")
        for i, shape in enumerate(scene.shapes):
            self._add(shape, 0, f"/shapes/{i}")

    def _add(self, shape: Shape, group: int, pointer: str) -> None:
        if isinstance(shape, Instance):
            self._instances(shape, pointer)
            return
        material = self._materials.index(shape.material, pointer)
        emission = self._emission(shape.emission, f"{pointer}/emission")
        flip = shape.flip_normals
        matrix = None if shape.transform is None else np.array(shape.transform, np.float64)
        if isinstance(shape, Sphere):
            baked = _baked_sphere(shape, matrix)
            if baked is not None and not self._uses_uv(shape, matrix):
                self._build.core.add_sphere(group, *baked, material, emission, flip)
                return
            place = np.diag([shape.radius] * 3 + [1.0])
            place[:3, 3] = shape.center
            matrix = place if matrix is None else matrix @ place
        mesh = primitives.transformed(_triangles(shape, pointer), matrix)
        if not len(mesh.faces):
            self._build.warnings.append(f"{pointer}: the mesh has no triangles")
            return
        if not np.isfinite(mesh.vertices.sum(dtype=np.float64)):
            raise SceneError("the transform moves vertices out of range", pointer=pointer)
        self._build.core.add_mesh(group, *mesh, material, emission, flip)

    def _uses_uv(self, shape: Sphere, matrix: Matrix | None) -> bool:
        """Whether a turn of the sphere would show."""
        turned = matrix is not None and not np.allclose(
            matrix[:3, :3], np.eye(3) * matrix[0, 0], atol=1e-6
        )
        if not turned or shape.material is None:
            return False
        material = self._build.scene.materials[shape.material]
        if getattr(material, "alpha_v", None) is not None:
            return True
        return "texture" in repr(material.model_dump())

    def _instances(self, instance: Instance, pointer: str) -> None:
        if instance.group not in self._groups:
            raise SceneError(
                "no group of this name",
                pointer=f"{pointer}/group",
                found=instance.group,
                accepted=names_of(self._build.scene.groups),
            )
        linear = instance.transforms[:, :3, :3].astype(np.float64)
        if not np.isfinite(instance.transforms).all():
            raise SceneError("a transform is not finite", pointer=f"{pointer}/transforms")
        singular = np.abs(np.linalg.det(linear)) < 1e-30
        if singular.any():
            raise SceneError(
                f"transform {int(np.argmax(singular))} flattens the group to nothing",
                pointer=f"{pointer}/transforms",
            )
        if self._has_emissive_sphere(instance.group) and not _all_similarities(linear):
            raise SceneError(
                "a group with an emissive sphere can be moved, turned and scaled evenly only",
                pointer=f"{pointer}/transforms",
            )
        self._build.core.add_instances(self._groups[instance.group], instance.transforms)

    def _has_emissive_sphere(self, group: str) -> bool:
        shapes = self._build.scene.groups[group]
        return any(isinstance(s, Sphere) and s.emission is not None for s in shapes)

    def _emission(self, emission: Emission | None, pointer: str) -> dict[str, Any] | None:
        if emission is None:
            return None
        radiance = self._textures.color(emission.radiance, f"{pointer}/radiance")
        if radiance[1] < 0 and not any(radiance[0]):
            return None
        return {"radiance": radiance, "two_sided": emission.two_sided}


def _triangles(shape: Any, pointer: str) -> primitives.Triangles:
    if isinstance(shape, Rectangle):
        return primitives.rectangle()
    if isinstance(shape, Cube):
        return primitives.cube()
    if isinstance(shape, Disk):
        return primitives.disk()
    if isinstance(shape, Sphere):
        return primitives.sphere()
    assert isinstance(shape, Mesh)
    if shape.vertices is None or shape.faces is None:
        raise SceneError("the mesh file was not read", pointer=f"{pointer}/file", found=shape.file)
    return primitives.Triangles(shape.vertices, shape.faces, shape.normals, shape.uvs)


def _baked_sphere(shape: Sphere, matrix: Matrix | None) -> tuple[Rgb, float] | None:
    """Centre and radius in the outer space, or None if the transform makes it no sphere."""
    if matrix is None:
        return shape.center, shape.radius
    if not _all_similarities(matrix[None, :3, :3]):
        return None
    center = matrix[:3, :3] @ np.array(shape.center) + matrix[:3, 3]
    scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1 / 3)
    return (float(center[0]), float(center[1]), float(center[2])), shape.radius * scale


def _all_similarities(linear: NDArray[np.float64]) -> bool:
    gram = np.einsum("nij,nik->njk", linear, linear)
    scale = np.trace(gram, axis1=1, axis2=2)[:, None, None] / 3
    return bool(np.all(np.abs(gram - scale * np.eye(3)) <= 1e-4 * scale))
