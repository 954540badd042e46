"""Geometry of the benchmark's scenes: triangles with flat faces, the same in every renderer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Triangles:
    """Vertices (n, 3) in metres and faces (m, 3), counter-clockwise seen from outside."""

    vertices: Floats
    faces: Ints


def joined(parts: list[Triangles]) -> Triangles:
    """Many meshes as one."""
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = [p.faces + start for p, start in zip(parts, starts[:-1], strict=True)]
    return Triangles(np.concatenate([p.vertices for p in parts]), np.concatenate(faces))


def quads(corners: Any) -> Triangles:
    """Quadrilaterals (n, 4, 3), two triangles each."""
    vertices = np.asarray(corners, np.float64).reshape(-1, 3)
    first = 4 * np.arange(len(vertices) // 4)[:, None]
    faces = np.concatenate([first + np.array(t) for t in ((0, 1, 2), (0, 2, 3))], axis=1).reshape(
        -1, 3
    )
    return Triangles(vertices, faces)


def ground(half_size: float, height: float = 0.0) -> Triangles:
    """A horizontal square that faces up."""
    s, y = half_size, height
    return quads([[(-s, y, -s), (-s, y, s), (s, y, s), (s, y, -s)]])


def box(center: Any, half: Any, turn: float = 0.0) -> Triangles:
    """A box, turned about the vertical axis by `turn` radians."""
    unit = np.array(
        [
            [(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)],
            [(-1, -1, -1), (-1, -1, 1), (-1, 1, 1), (-1, 1, -1)],
            [(-1, 1, -1), (-1, 1, 1), (1, 1, 1), (1, 1, -1)],
            [(-1, -1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1)],
            [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
            [(-1, -1, -1), (-1, 1, -1), (1, 1, -1), (1, -1, -1)],
        ],
        np.float64,
    ).reshape(-1, 3)
    c, s = np.cos(turn), np.sin(turn)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return quads((unit * np.asarray(half)) @ about_y.T + np.asarray(center))


def icosphere(levels: int) -> Triangles:
    """A unit sphere of 20 * 4^levels triangles."""
    g = (1 + 5**0.5) / 2
    vertices = np.array(
        [
            *((-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)),
            *((0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)),
        ],
        np.float64,
    )
    # fmt: off
    faces = np.array([
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
        (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
        (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ])
    # fmt: on
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(levels):
        vertices, faces = _halved(vertices, faces)
    return Triangles(vertices, faces)


def _halved(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Each triangle as four, with the new vertices on the sphere."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, inverse = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_inverse=True)
    middles = vertices[keys // len(vertices)] + vertices[keys % len(vertices)]
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = (inverse.reshape(-1, 3) + len(vertices)).T
    a, b, c = faces.T
    finer = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([vertices, middles]), finer


def sphere(center: Any, radius: float, levels: int) -> Triangles:
    """A sphere of flat triangles."""
    unit = icosphere(levels)
    return Triangles(unit.vertices * radius + np.asarray(center), unit.faces)


def displaced_sphere(levels: int) -> Triangles:
    """A sphere of radius 1 about the origin, with folds and pores on it."""
    unit = icosphere(levels)
    p = unit.vertices
    folds = np.sin(7.0 * p[:, 0] + 2.0 * np.sin(5.0 * p[:, 1])) * np.sin(6.0 * p[:, 2] + p[:, 0])
    pores = np.prod(np.sin(41.0 * p + np.array([0.3, 1.1, 2.3])), axis=1)
    grain = np.prod(np.sin(173.0 * p), axis=1)
    height = 1.0 + 0.09 * folds + 0.025 * pores + 0.003 * grain
    return Triangles(p * height[:, None], unit.faces)
