"""What the mesh file readers return, and how faces become triangles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import SceneError

Array = NDArray[Any]

# More vertices or faces than this are refused (indices are 32 bits).
MAX_COUNT = 0xFFFFFFFF


@dataclass
class MeshData:
    """Arrays of one triangle mesh, as in `raykiln.scene.Mesh`."""

    vertices: Array
    faces: Array
    normals: Array | None = None
    uvs: Array | None = None
    name: str | None = None
    material: str | None = None
    warnings: list[str] = field(default_factory=list)


def fan(counts: Array) -> Array:
    """Corner numbers (m, 3) of the fans that cut polygons into triangles.

    Parameters
    ----------
    counts
        (n,) corners of each polygon; corners are numbered through all polygons in order.
        Polygons of fewer than three corners give no triangle.
    """
    counts = np.asarray(counts, np.int64)
    starts = np.cumsum(counts) - counts
    triangles = np.maximum(counts - 2, 0)
    total = int(triangles.sum())
    first = np.repeat(starts, triangles)
    step = np.arange(total) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def triangulate(counts: Array, positions: Array, corners: Array) -> Array:
    """Corner numbers (m, 3) of triangles that cover polygons, concave ones included.

    Parameters
    ----------
    counts
        (n,) corners of each polygon.
    positions
        (v, 3) vertices.
    corners
        (sum(counts),) vertex of each corner.
    """
    triangles = fan(counts)
    if counts.size == 0 or int(counts.max()) <= 3:
        return triangles
    polygon = np.repeat(np.arange(len(counts)), np.maximum(counts - 2, 0))
    p = np.asarray(positions, np.float64)[corners[triangles]]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    # The fan of a concave polygon has triangles that turn against the polygon's own normal.
    whole = np.zeros((len(counts), 3))
    np.add.at(whole, polygon, normal)
    against = np.einsum("ij,ij->i", normal, whole[polygon]) < 0
    concave = np.unique(polygon[against])
    if concave.size == 0:
        return triangles
    starts = np.cumsum(counts) - counts
    for index in concave:
        own = polygon == index
        ring = np.arange(starts[index], starts[index] + counts[index])
        triangles[own] = _ears(ring, positions[corners[ring]], whole[index])
    return triangles


def _ears(ring: Array, points: Array, normal: Array) -> Array:
    """Triangles (n - 2, 3) of one polygon by cutting ears (Meisters 1975)."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(np.asarray(points, np.float64), axis, axis=1)
    if (normal[axis] < 0) != (axis == 1):
        flat = flat[:, ::-1]
    left = list(range(len(ring)))
    found: list[tuple[int, int, int]] = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat, left, i)), 0)
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    found.append((left[0], left[1], left[2]))
    triangles: Array = ring[np.array(found)]
    return triangles


def _is_ear(flat: Array, left: list[int], i: int) -> bool:
    a, b, c = flat[left[i - 1]], flat[left[i]], flat[left[(i + 1) % len(left)]]
    if _turn(a, b, c) <= 0:
        return False
    corners = {left[i - 1], left[i], left[(i + 1) % len(left)]}
    others = flat[[k for k in left if k not in corners]]
    inside = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    return not bool(np.any(inside))


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of a, b, c; c may be (n, 2)."""
    result: Array = (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
    return result


def smooth_normals(vertices: Array, faces: Array) -> Array:
    """Vertex normals (n, 3): the face normals, weighted by the angle at the vertex.

    Thürmer and Wüthrich, "Computing vertex normals from polygonal facets", 1998.  A vertex without
    a proper face gets a zero normal.
    """
    p = np.asarray(vertices, np.float64)
    face_index = faces.astype(np.int64, copy=False)
    corner = p[face_index]
    normal = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    total = np.zeros_like(p)
    for i in range(3):
        u = _unit(corner[:, (i + 1) % 3] - corner[:, i])
        v = _unit(corner[:, (i + 2) % 3] - corner[:, i])
        # Half-angle form: exact for angles near 0 and pi, where acos of the cosine is not.
        angle = 2 * np.arctan2(np.linalg.norm(u - v, axis=1), np.linalg.norm(u + v, axis=1))
        weighted = normal * angle[:, None]
        for k in range(3):
            total[:, k] += np.bincount(face_index[:, i], weighted[:, k], minlength=len(p))
    return _unit(total).astype(np.float32)


def _unit(v: Array) -> Array:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    unit: Array = np.divide(v, length, out=np.zeros_like(v), where=length > 0)
    return unit


def check_count(what: str, count: int, *, pointer: str | None = None) -> int:
    """`count`, if it is one that a mesh may have."""
    if not 0 <= count <= MAX_COUNT:
        raise SceneError(
            f"the number of {what} is out of range",
            pointer=pointer,
            found=count,
            accepted=f"0 to {MAX_COUNT}",
        )
    return count
