"""Shapes, and how they emit."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from raykiln.arrays import Float2, Float3, Index3, Matrices
from raykiln.scene.base import Matrix4, Name, Node, Positive, Vec3
from raykiln.scene.textures import ColorInput


class Emission(Node):
    """Light given off by a surface."""

    radiance: ColorInput
    """W / (sr m^2)."""
    two_sided: bool = False
    """Also from the back (against the normal)."""


class ShapeBase(Node):
    """What every shape has."""

    name: Name | None = None
    material: Name | None = None
    """Name of an entry of `Scene.materials`; None = a grey diffuse."""
    transform: Matrix4 | None = None
    """world_from_shape (within a group: group_from_shape)."""
    emission: Emission | None = None
    flip_normals: bool = False


class Mesh(ShapeBase):
    """Indexed triangles, counter-clockwise seen from outside; arrays here, or a file."""

    type: Literal["mesh"] = "mesh"
    file: Name | None = None
    """.ply, .obj or .stl beside the scene file, in place of the arrays."""
    vertices: Float3 | None = None
    """(n, 3) float32."""
    faces: Index3 | None = None
    """(m, 3) uint32, each below n."""
    normals: Float3 | None = None
    """(n, 3) float32, or None: face normals."""
    uvs: Float2 | None = None
    """(n, 2) float32."""

    @model_validator(mode="after")
    def _whole(self) -> Mesh:
        if (self.file is None) == (self.vertices is None and self.faces is None):
            raise ValueError("a mesh takes either 'file' or 'vertices' and 'faces'")
        if self.file is None:
            _check_mesh_arrays(self)
        return self


def _check_mesh_arrays(mesh: Mesh) -> None:
    if mesh.vertices is None or mesh.faces is None:
        raise ValueError("a mesh takes both 'vertices' and 'faces'")
    count = len(mesh.vertices)
    if mesh.faces.size and int(mesh.faces.max()) >= count:
        face = int(np.argmax((mesh.faces >= count).any(axis=1)))
        raise ValueError(f"face {face} refers to vertex {int(mesh.faces.max())} of {count}")
    for label, array in (("vertices", mesh.vertices), ("normals", mesh.normals), ("uvs", mesh.uvs)):
        if array is None:
            continue
        if len(array) != count:
            raise ValueError(f"{label} has {len(array)} rows for {count} vertices")
        if not np.isfinite(array.sum(dtype=np.float64)):
            finite = np.isfinite(array).all(axis=1)
            if not finite.all():
                raise ValueError(f"{label} row {int(np.argmin(finite))} is not finite")


class Sphere(ShapeBase):
    """An analytic sphere."""

    type: Literal["sphere"] = "sphere"
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 1.0


class Rectangle(ShapeBase):
    """The square [-1, 1]^2 in the xy plane, facing +z, uv (0, 0) to (1, 1)."""

    type: Literal["rectangle"] = "rectangle"


class Cube(ShapeBase):
    """The cube [-1, 1]^3, facing outwards."""

    type: Literal["cube"] = "cube"


class Disk(ShapeBase):
    """The unit disk in the xy plane, facing +z."""

    type: Literal["disk"] = "disk"


class Instance(Node):
    """A group, placed once for each matrix."""

    type: Literal["instance"] = "instance"
    name: Name | None = None
    group: Name
    """Name of an entry of `Scene.groups`."""
    transforms: Matrices
    """(n, 4, 4) float32, world_from_group."""


GroupShape = Annotated[Mesh | Sphere | Rectangle | Cube | Disk, Field(discriminator="type")]
Shape = Annotated[Mesh | Sphere | Rectangle | Cube | Disk | Instance, Field(discriminator="type")]
