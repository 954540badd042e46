"""The four scenes, described once for every renderer.

Right-handed, y up, metres; radiance in linear Rec.709.  All surfaces are triangles with flat
faces, all lights are triangles or a map of the sky: what the renderers agree on to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapes
from numpy.typing import NDArray

Rgb = tuple[float, float, float]
GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)


@dataclass(frozen=True)
class Material:
    """Diffuse, rough metal (GGX, equal indices for all colours) or clear glass."""

    kind: str
    reflectance: Rgb = (0.0, 0.0, 0.0)
    alpha: float = 0.0
    eta: float = 1.5
    k: float = 0.0


@dataclass(frozen=True)
class Part:
    """A mesh with its material; `radiance` makes a light of its front sides."""

    name: str
    mesh: shapes.Triangles
    material: Material
    radiance: Rgb | None = None


@dataclass(frozen=True)
class BenchScene:
    """One of the four scenes."""

    name: str
    title: str
    size: int
    depth: int
    origin: Rgb
    target: Rgb
    fov_deg: float
    parts: list[Part] = field(default_factory=list)
    sky: NDArray[np.float32] | None = None
    """Radiance (height, 2 height, 3); u = atan2(x, -z) / 2 pi, v = acos(y) / pi."""


def diffuse(*rgb: float) -> Material:
    """A Lambertian surface."""
    r, g, b = rgb if len(rgb) == 3 else (rgb[0],) * 3
    return Material("diffuse", (r, g, b))


LAMP = diffuse(0.0)


def cornell_box() -> BenchScene:
    """The Cornell box: its measured geometry, with the lamp flush in the ceiling."""
    mm = 0.001

    def walls(*corners: Any) -> shapes.Triangles:
        return shapes.quads(np.array(corners, np.float64) * mm)

    lamp = [(343, 548.8, 227), (343, 548.8, 332), (213, 548.8, 332), (213, 548.8, 227)]
    ceiling = [(556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0)]
    around = [(ceiling[i], ceiling[(i + 1) % 4], lamp[(i + 1) % 4], lamp[i]) for i in range(4)]
    white = walls(
        [(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)],
        [(549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)],
        *around,
        *_block([(130, 165, 65), (82, 165, 225), (240, 165, 272), (290, 165, 114)]),
        *_block([(423, 330, 247), (265, 330, 296), (314, 330, 456), (472, 330, 406)]),
    )
    green = walls([(0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2)])
    red = walls([(552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)])
    return BenchScene(
        "cornell",
        "Cornell box",
        size=256,
        depth=8,
        origin=(0.278, 0.273, -0.8),
        target=(0.278, 0.273, 0.0),
        fov_deg=39.3077,
        parts=[
            Part("white", white, diffuse(0.73, 0.73, 0.73)),
            Part("green", green, diffuse(0.12, 0.45, 0.15)),
            Part("red", red, diffuse(0.57, 0.043, 0.044)),
            Part("lamp", walls(lamp), LAMP, radiance=(17.0, 12.0, 4.0)),
        ],
    )


def _block(top: list[tuple[float, float, float]]) -> list[Any]:
    """The top and the four sides of a block that stands on the floor."""
    pairs = zip(top, [*top[1:], top[0]], strict=True)
    return [top, *([p, q, (q[0], 0, q[2]), (p[0], 0, p[2])] for q, p in pairs)]


def displaced_sphere() -> BenchScene:
    """1.3 million triangles on a plane, under a sky without a sun."""
    up = _sky_directions(512)[..., 1:2]
    sky = np.where(up > 0, 0.35 + 1.2 * (1 - up) ** 3 * [1.0, 0.8, 0.6] + up * [0.1, 0.4, 1.0], 0.1)
    return BenchScene(
        "displaced_sphere",
        "Displaced sphere, 1.3 M triangles",
        size=512,
        depth=4,
        origin=(0.0, 1.3, 4.4),
        target=(0.0, -0.02, 0.0),
        fov_deg=34.0,
        parts=[
            Part("stone", shapes.displaced_sphere(8), diffuse(0.6, 0.5, 0.4)),
            Part("plane", shapes.ground(100.0, -1.0), diffuse(0.4)),
        ],
        sky=sky.astype(np.float32),
    )


def glass_and_metal() -> BenchScene:
    """Smooth glass and rough metal under a sky with a sun in its map."""
    towards = _sky_directions(512)
    up = towards[..., 1:2]
    sun = np.array([-0.55, 0.62, 0.45])
    cosine = (towards @ (sun / np.linalg.norm(sun)))[..., None]
    sky = np.where(up > 0, [0.28, 0.42, 0.75] + 0.7 * (1 - up) ** 4 * [1.0, 0.9, 0.7], 0.2)
    # A disk of 2.5 degrees about its middle, with a soft rim.
    disk = np.clip((np.degrees(np.arccos(np.clip(cosine, -1, 1))) - 2.75) / -0.5, 0, 1)
    steel = Material("metal", alpha=0.25, eta=2.9, k=3.1)
    silver = Material("metal", alpha=0.1, eta=0.2, k=3.9)
    glass = Material("glass", eta=1.5)
    places = {
        "glass": (glass, [(-1.1, 0.7, 0.6, 0.7), (0.95, 0.45, 1.5, 0.45), (0.1, 0.3, 2.0, 0.3)]),
        "steel": (steel, [(0.6, 0.8, -0.5, 0.8), (-0.45, 0.35, 1.55, 0.35)]),
        "silver": (silver, [(2.0, 0.6, 0.35, 0.6), (-2.3, 0.5, -0.6, 0.5)]),
    }
    balls = [
        Part(name, shapes.joined([shapes.sphere(p[:3], p[3], 6) for p in spheres]), material)
        for name, (material, spheres) in places.items()
    ]
    return BenchScene(
        "glass_and_metal",
        "Glass and rough metal, sun and sky",
        size=384,
        depth=16,
        origin=(0.2, 1.9, 6.0),
        target=(0.0, 0.45, 0.3),
        fov_deg=36.0,
        parts=[*balls, Part("plane", shapes.ground(100.0), diffuse(0.5, 0.48, 0.45))],
        sky=(sky + 220.0 * disk * [1.0, 0.9, 0.75]).astype(np.float32),
    )


def many_lights(count: int = 1000) -> BenchScene:
    """Small square lamps that look down on a plane with blocks: `count` of them, equal in all."""
    number = np.arange(count)
    # The seeds of a sunflower: even, without rows.
    radius, angle = 6.0 * np.sqrt((number + 0.5) / count), number * GOLDEN_ANGLE
    height = 1.4 + 0.3 * np.sin(1.7 * radius) + 0.1 * np.cos(3.0 * angle)
    centers = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1)
    half = 0.03 * (1000 / count) ** 0.5
    square = half * np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)], np.float64)
    corners = centers[:, None, :] + square
    colors: list[Rgb] = [
        (30, 10, 6), (30, 18, 6), (24, 24, 8), (8, 24, 10),
        (6, 22, 22), (6, 12, 32), (18, 8, 30), (26, 7, 18),
    ]  # fmt: skip
    lamps = [
        Part(f"lamps_{i}", shapes.quads(corners[i :: len(colors)]), LAMP, radiance=color)
        for i, color in enumerate(colors)
        if i < count
    ]
    towers = [
        shapes.box((5.5 * t**0.5 * np.cos(a), 0.2, 5.5 * t**0.5 * np.sin(a)), (0.18, 0.2, 0.18), a)
        for t, a in ((i / 60, i * GOLDEN_ANGLE + 0.7) for i in range(1, 61))
    ]
    return BenchScene(
        "many_lights",
        "1,000 small lights" if count == 1000 else f"{count:,} small lights",
        size=384,
        depth=4,
        origin=(0.0, 4.2, 9.0),
        target=(0.0, 0.0, 0.6),
        fov_deg=45.0,
        parts=[
            Part("plane", shapes.ground(20.0), diffuse(0.5)),
            Part("towers", shapes.joined(towers), diffuse(0.7, 0.68, 0.65)),
            *lamps,
        ],
    )


def _sky_directions(height: int) -> NDArray[np.float64]:
    """Directions (height, 2 height, 3) of the pixel centres of a sky map."""
    u = (np.arange(2 * height) + 0.5) / (2 * height) * 2 * np.pi
    v = ((np.arange(height) + 0.5) / height * np.pi)[:, None]
    ones = np.ones_like(u)
    return np.stack([np.sin(v) * np.sin(u), np.cos(v) * ones, -np.sin(v) * np.cos(u)], axis=-1)


SCENES = {
    "cornell": cornell_box,
    "displaced_sphere": displaced_sphere,
    "glass_and_metal": glass_and_metal,
    "many_lights": many_lights,
}
