"""Meshes and images that the Mitsuba scenes refer to, made by code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from raykiln.image import write_exr, write_png

Array = NDArray[Any]


def write_assets(folder: Path) -> None:
    """Write `meshes/` and `textures/` into a folder."""
    meshes, textures = folder / "meshes", folder / "textures"
    meshes.mkdir()
    textures.mkdir()
    _write_gem(meshes / "gem.obj")
    _write_vase(meshes / "vase.ply", with_normals=True)
    _write_vase(meshes / "vase_bare.ply", with_normals=False)
    write_png(textures / "chart.png", chart())
    write_png(textures / "holes.png", holes())
    write_exr(textures / "sky.exr", {"beauty": sky()})


def chart() -> NDArray[np.uint8]:
    """A picture that looks different whichever way it is turned or mirrored: (6, 8, 3)."""
    v, u = np.mgrid[0:6, 0:8]
    red = 30 + 28 * u
    green = 220 - 35 * v
    blue = np.where((u + v) % 2 == 0, 200, 40)
    picture = np.stack([red, green, blue], axis=-1).astype(np.uint8)
    picture[0, 0] = 255, 255, 255
    picture[5, 7] = 0, 0, 0
    return picture


def holes() -> NDArray[np.uint8]:
    """A grey picture with solid, half there and open parts: (4, 4, 1)."""
    rows = [[255, 0, 255, 255], [255, 255, 128, 0], [0, 255, 64, 255], [255, 0, 0, 255]]
    return np.array(rows, np.uint8)[:, :, None]


def sky(width: int = 512, height: int = 256) -> NDArray[np.float32]:
    """A blue sky with a soft sun above a brown ground: (height, width, 3).

    Fine enough that it does not matter where a row lies: Mitsuba puts the first on the pole
    itself, we half a row below.
    """
    v, u = np.mgrid[0:height, 0:width]
    phi, theta = 2 * np.pi * (u + 0.5) / width, np.pi * (v + 0.5) / height
    up = np.cos(theta)
    image = np.where(
        (up > 0)[..., None],
        np.stack([0.2 + 0.3 * (1 - up), 0.4 + 0.2 * (1 - up), 0.8 - 0.1 * up], -1),
        np.array([0.15, 0.1, 0.07]),
    )
    to_sun = np.sin(theta) * np.sin(1.0) * np.cos(phi - 2.0) + np.cos(theta) * np.cos(1.0)
    image = image + (12 * np.exp(20 * (to_sun - 1)))[..., None] * [1.0, 0.9, 0.7]
    # A mark that no rotation of the map leaves alone.
    image[:, width // 4 : width // 4 + 8] += [0.5, 0.0, 0.0]
    return np.asarray(image, dtype=np.float32)


def _grid(columns: int, rows: int) -> tuple[Array, Array, Array]:
    """u and v of the vertices of a grid, and its quads, counter-clockwise seen from outside."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quads = np.stack([first, first + columns + 1, first + columns + 2, first + 1], axis=1)
    return u.ravel(), v.ravel(), quads


def _write_gem(path: Path) -> None:
    """A ball of quads and triangles with smooth normals and texture coordinates."""
    u, v, quads = _grid(16, 10)
    phi, theta = 2 * np.pi * u, np.pi * v
    normals = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)])
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals.T]
    lines += [f"vt {s:.6f} {1 - t:.6f}" for s, t in zip(u, v, strict=True)]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals.T]
    for quad in quads + 1:
        row = (quad[0] - 1) // 17
        # At the poles one side of a quad has no length.
        corners = quad[[0, 1, 2]] if row == 0 else quad[[0, 1, 3]] if row == 9 else quad
        lines.append("f " + " ".join(f"{i}/{i}/{i}" for i in corners))
    path.write_text("\n".join(lines) + "\n")


def _write_vase(path: Path, *, with_normals: bool) -> None:
    """A surface of revolution, open above, 1.8 high."""
    u, v, quads = _grid(32, 20)
    phi, height = 2 * np.pi * u, 1.8 * (1 - v)
    radius = 0.55 + 0.25 * np.sin(4 * height)
    points = np.stack([radius * np.cos(phi), height, -radius * np.sin(phi)], axis=1)
    leaning = np.stack([np.cos(phi), -np.cos(4 * height), -np.sin(phi)], axis=1)
    normals = leaning / np.linalg.norm(leaning, axis=1, keepdims=True)
    table = np.hstack([points, normals]) if with_normals else points
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if with_normals else [])]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    body = [" ".join(f"{x:.7f}" for x in row) for row in table]
    body += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join([*header, "end_header", *body]) + "\n")
