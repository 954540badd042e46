"""Triangulation and smooth normals."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from raykiln.formats.meshes import fan, smooth_normals, triangulate


def _area(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    p = points[triangles]
    return float(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2)


def test_fans_of_mixed_polygons() -> None:
    triangles = fan(np.array([3, 4, 5]))
    expected = [[0, 1, 2], [3, 4, 5], [3, 5, 6], [7, 8, 9], [7, 9, 10], [7, 10, 11]]
    assert triangles.tolist() == expected


def test_a_concave_polygon_is_covered_once() -> None:
    arrow = np.array([[0, 0, 0], [2, -2, 0], [0, 3, 0], [-2, -2, 0]], np.float64)
    for turn in range(4):
        ring = np.roll(np.arange(4), turn)
        for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2]):
            points = arrow[:, axes]
            triangles = ring[triangulate(np.array([4]), points, ring)]
            assert np.isclose(_area(points, triangles), 6.0)
            corner = points[triangles]
            normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            assert normal[0] @ normal[1] > 0


@given(st.integers(4, 12), st.integers(0, 2**31))
def test_star_polygons_keep_their_area(corners: int, seed: int) -> None:
    """A polygon that is seen whole from its centre has the area of its sectors."""
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0, 2 * np.pi, corners))
    angle = angle * 0.5 + np.linspace(0, 2 * np.pi, corners, endpoint=False) * 0.5
    radius = random.uniform(0.3, 1.0, corners)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    after = np.roll(points, -1, axis=0)
    shoelace = float((points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum() / 2)
    ring = np.arange(corners)
    triangles = triangulate(np.array([corners]), points, ring)
    assert len(triangles) == corners - 2
    assert np.isclose(_area(points, triangles), shoelace)


def test_smooth_normals_weigh_by_angle_not_by_count() -> None:
    """The corner of a cube has the same normal however its faces are cut."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], np.float32)
    faces = np.array([[0, 4, 1], [0, 2, 4], [0, 1, 3], [0, 3, 2]], np.uint32)
    normals = smooth_normals(vertices, faces)
    assert np.allclose(normals[0], -np.ones(3) / np.sqrt(3), atol=1e-6)
    assert normals.dtype == np.float32


def test_a_vertex_without_a_face_has_no_normal() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]], np.float32)
    normals = smooth_normals(vertices, np.array([[0, 1, 2], [1, 1, 2]], np.uint32))
    assert normals[:3].tolist() == [[0, 0, 1]] * 3
    assert normals[3].tolist() == [0, 0, 0]
