"""Mitsuba's rectangle, cube and disk as meshes with its own texture coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

_SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
_HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
# For each face of the cube: its normal, and the directions in which u and v grow.
_CUBE_FACES = (
    ((0, -1, 0), (0, 0, 1), (1, 0, 0)),
    ((0, 1, 0), (-1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 0, -1), (0, -1, 0), (1, 0, 0)),
)
DISK_SEGMENTS = 256


def rectangle() -> dict[str, Any]:
    """[-1, 1]^2 facing +z; uv (0, 0) at (-1, -1)."""
    vertices = np.concatenate([_SQUARE, np.zeros((4, 1), np.float32)], axis=1)
    return {"vertices": vertices, "faces": _HALVES, "uvs": (_SQUARE + 1) / 2}


def cube() -> dict[str, Any]:
    """[-1, 1]^3 facing outwards, the whole uv square on each face."""
    vertices, faces = [], []
    for i, directions in enumerate(_CUBE_FACES):
        normal, along_u, along_v = (np.array(d, np.float32) for d in directions)
        vertices.append(normal + _SQUARE[:, :1] * along_u + _SQUARE[:, 1:] * along_v)
        outwards = float(np.cross(along_u, along_v) @ normal) > 0
        faces.append((_HALVES if outwards else _HALVES[:, ::-1]) + 4 * i)
    return {
        "vertices": np.concatenate(vertices),
        "faces": np.concatenate(faces).astype(np.uint32),
        "uvs": np.tile((_SQUARE + 1) / 2, (6, 1)),
    }


def disk() -> dict[str, Any]:
    """The unit disk facing +z; u is the radius and v the angle over a full turn."""
    turn = np.linspace(0, 1, DISK_SEGMENTS + 1)
    phi = 2 * math.pi * turn
    rim = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=1)
    # A polygon of the same area as the disk.
    step = 2 * math.pi / DISK_SEGMENTS
    rim *= math.sqrt(step / math.sin(step))
    middle = (turn[:-1] + turn[1:]) / 2
    vertices = np.concatenate([rim, np.zeros((DISK_SEGMENTS, 3))])
    uvs = np.concatenate(
        [np.stack([np.ones_like(turn), turn], 1), np.stack([np.zeros_like(middle), middle], 1)]
    )
    n = np.arange(DISK_SEGMENTS)
    faces = np.stack([n + DISK_SEGMENTS + 1, n, n + 1], axis=1)
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "uvs": uvs.astype(np.float32),
    }


PATCHES: dict[str, Callable[[], dict[str, Any]]] = {
    "rectangle": rectangle,
    "cube": cube,
    "disk": disk,
}
