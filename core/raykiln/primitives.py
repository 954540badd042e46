"""Triangles for the shapes of the description that the core does not know."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Triangles(NamedTuple):
    """Arrays of a mesh: (n, 3), (m, 3), (n, 3) or None, (n, 2) or None."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32] | None
    uvs: NDArray[np.float32] | None


def rectangle() -> Triangles:
    """[-1, 1]^2 in the xy plane, facing +z; uv (0, 0) at (-1, 1), the upper left."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    return Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), None, uvs)


def cube() -> Triangles:
    """[-1, 1]^3, facing outwards, each side with its own uv square."""
    side = rectangle()
    axes = [np.eye(3)[list(order)] for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))]
    vertices, faces = [], []
    for i, (axis, sign) in enumerate((axis, sign) for axis in axes for sign in (1.0, -1.0)):
        # Turning both the second axis and the normal keeps the orientation.
        points = (side.vertices + np.array([0, 0, 1])) * [1, sign, sign]
        vertices.append(points @ axis)
        faces.append(side.faces + 4 * i)
    assert side.uvs is not None
    return Triangles(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(faces).astype(np.uint32),
        None,
        np.tile(side.uvs, (6, 1)),
    )


def disk(segments: int = 256) -> Triangles:
    """The unit disk in the xy plane, facing +z, as a polygon of the same area."""
    angle = 2 * math.pi / segments
    radius = math.sqrt(angle / math.sin(angle))
    turns = angle * np.arange(segments)
    rim = radius * np.stack([np.cos(turns), np.sin(turns), np.zeros(segments)], axis=1)
    vertices = np.concatenate([np.zeros((1, 3)), rim]).astype(np.float32)
    second = 1 + np.arange(segments)
    third = 1 + np.roll(np.arange(segments), -1)
    faces = np.stack([np.zeros(segments), second, third], axis=1).astype(np.uint32)
    uvs = (0.5 + 0.5 * vertices[:, :2] * [1, -1]).astype(np.float32)
    return Triangles(vertices, faces, None, uvs)


def sphere(columns: int = 128, rows: int = 64) -> Triangles:
    """The unit sphere with smooth normals and the uv of the analytic one (poles on y)."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    phi, theta = 2 * math.pi * (u.ravel() - 0.5), math.pi * v.ravel()
    points = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=1
    )
    upper = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = upper + columns + 1
    faces = np.concatenate(
        [np.stack([upper, lower, lower + 1], 1), np.stack([upper, lower + 1, upper + 1], 1)]
    )
    vertices = points.astype(np.float32)
    uvs = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
    return Triangles(vertices, _solid(vertices, faces.astype(np.uint32)), vertices, uvs)


def _solid(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The faces that have an area (those at the poles have none)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    solid: NDArray[np.uint32] = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9]
    return solid


def transformed(mesh: Triangles, matrix: NDArray[np.float64] | None) -> Triangles:
    """The mesh moved by a 4 x 4 matrix; a mirroring one turns the faces so that out stays out."""
    if matrix is None or np.array_equal(matrix, np.eye(4)):
        return mesh
    linear = matrix[:3, :3]
    vertices = mesh.vertices @ linear.T + matrix[:3, 3]
    faces = mesh.faces
    normals = mesh.normals
    mirrored = np.linalg.det(linear) < 0
    if normals is not None:
        cofactors = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
        normals = _float32(normals @ cofactors.T * (-1 if mirrored else 1))
    if mirrored:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return Triangles(_float32(vertices), faces, normals, mesh.uvs)


def _float32(array: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)
