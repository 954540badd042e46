"""The textures of the product shot: painted by arithmetic, with distances to strokes."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from kit import Array
from numpy.random import default_rng

WIDTH, HEIGHT = 1024, 384
# The outer wall of the mug, unrolled: centimetres along and down from the rim.
AROUND_CM, DOWN_CM = 27.0, 10.125
PIXEL_CM = AROUND_CM / WIDTH

CLAY = np.array([0.45, 0.25, 0.15])
GLAZE = np.array([0.012, 0.075, 0.095])
GLAZE_THIN = np.array([0.06, 0.2, 0.21])
SPECKLE = np.array([0.55, 0.5, 0.4])
GOLD = np.array([0.98, 0.7, 0.27])

# Letters as strokes in a box 1 wide and 1.5 high, y down.
LETTERS: dict[str, list[list[tuple[float, float]]]] = {
    "R": [[(0, 1.5), (0, 0), (0.6, 0), (0.9, 0.2), (0.9, 0.55), (0.6, 0.78), (0, 0.78)],
          [(0.5, 0.78), (0.95, 1.5)]],
    "A": [[(0, 1.5), (0.5, 0), (1, 1.5)], [(0.18, 1.0), (0.82, 1.0)]],
    "Y": [[(0, 0), (0.5, 0.75), (1, 0)], [(0.5, 0.75), (0.5, 1.5)]],
    "K": [[(0, 0), (0, 1.5)], [(0.92, 0), (0, 0.85)], [(0.3, 0.6), (0.95, 1.5)]],
    "I": [[(0, 0), (0, 1.5)]],
    "L": [[(0, 0), (0, 1.5), (0.85, 1.5)]],
    "N": [[(0, 1.5), (0, 0), (0.95, 1.5), (0.95, 0)]],
}  # fmt: skip
ADVANCE = {"I": 0.5, "L": 1.3}
WORD = "RAYKILN"

Strokes = list[list[tuple[float, float]]]


class Paint(NamedTuple):
    """The three textures of the mug, as 8-bit pixels."""

    base_color: np.ndarray
    metal_roughness: np.ndarray
    normal: np.ndarray


def grid() -> tuple[Array, Array]:
    """Centimetres to the right of the middle, and down from the rim, of each pixel."""
    x = (np.arange(WIDTH) + 0.5) * PIXEL_CM - AROUND_CM / 2
    y = (np.arange(HEIGHT) + 0.5) * DOWN_CM / HEIGHT
    return np.meshgrid(x, y)


def distance_to(strokes: Strokes, x: Array, y: Array) -> Array:
    """Distance to the nearest of the line strokes."""
    nearest = np.full(x.shape, np.inf)
    for stroke in strokes:
        for (ax, ay), (bx, by) in pairwise(stroke):
            dx, dy = bx - ax, by - ay
            t = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - ax - t * dx, y - ay - t * dy))
    return nearest


def word(center: float, top: float, scale: float) -> Strokes:
    """The name in letters `1.5 scale` high."""
    total = sum(ADVANCE.get(c, 1.45) for c in WORD) - 0.45
    left = center - total * scale / 2
    strokes: Strokes = []
    for c in WORD:
        for line in LETTERS[c]:
            strokes.append([(left + px * scale, top + py * scale) for px, py in line])
        left += ADVANCE.get(c, 1.45) * scale
    return strokes


def emblem(center: float, base: float, radius: float) -> Strokes:
    """A kiln's arch with a fire within and rays above."""
    turn = np.linspace(np.pi, 0, 25)
    arch = [(center + radius * np.cos(a), base - radius * (0.55 + np.sin(a))) for a in turn]
    arch = [(center - radius, base), *arch, (center + radius, base), (center - radius, base)]
    strokes = [[(float(px), float(py)) for px, py in arch]]
    for a in np.linspace(0.12, 0.88, 7) * np.pi:
        way = np.array([np.cos(a), -np.sin(a)])
        start, end = np.array([center, base - 0.55 * radius]) + np.outer([1.3, 1.72], way) * radius
        strokes.append([(float(start[0]), float(start[1])), (float(end[0]), float(end[1]))])
    flame = np.array([(0, 0), (-0.42, -0.35), (-0.2, -0.75), (0, -1.2), (0.12, -0.8),
                      (0.42, -0.4), (0, 0)])  # fmt: skip
    lit = np.array([center, base - 0.12 * radius]) + flame * radius
    strokes.append([(float(px), float(py)) for px, py in lit])
    return strokes


def waves(x: Array, seed: int, count: int, slowest: int, fastest: int) -> Array:
    """A smooth random curve around the mug that closes on itself, about -1 to 1."""
    random = default_rng(seed)
    turns = random.integers(slowest, fastest, count)
    phases = random.uniform(0, 2 * np.pi, count)
    angle = 2 * np.pi * x / AROUND_CM
    curves = [np.sin(n * angle + p) for n, p in zip(turns, phases, strict=True)]
    total: Array = np.sum(curves, axis=0) / np.sqrt(count)
    return total


def covered(distance: Array) -> Array:
    """Coverage of a pixel by what is at negative distances."""
    share: Array = np.clip(0.5 - distance / PIXEL_CM, 0, 1)
    return share


def speckles(x: Array, y: Array) -> Array:
    """Iron spots in the glaze."""
    random = default_rng(11)
    spots = np.zeros(x.shape)
    for _ in range(420):
        cx = random.uniform(-AROUND_CM / 2, AROUND_CM / 2)
        cy, radius = random.uniform(0.5, DOWN_CM), 0.014 + 0.035 * random.random() ** 3
        columns = np.abs(x[0] - cx) < 0.2
        patch = covered(np.hypot(x[:, columns] - cx, y[:, columns] - cy) - radius)
        spots[:, columns] = np.maximum(spots[:, columns], patch * random.uniform(0.3, 0.9))
    return spots


def mug() -> Paint:
    """A mug of raw clay below, dipped in glaze, with a name in gold leaf and a gilded rim."""
    x, y = grid()
    line = 6.7 + 0.28 * waves(x[0], 3, 5, 1, 6) + 0.1 * waves(x[0], 4, 4, 7, 19)
    glaze = covered(y - line)
    strokes = distance_to(word(0.0, 4.45, 0.68), x, y) - 0.068
    sign = distance_to(emblem(0.0, 3.75, 0.85), x, y) - 0.058
    band = np.minimum(np.abs(y - 0.2) - 0.2, np.abs(y - 0.72) - 0.035)
    gold = covered(np.minimum(np.minimum(strokes, sign), band))

    # Glaze runs thin at its edge and pools in streaks.
    thin = np.exp(-np.abs(line - y) / 0.35) + 0.18 * (1 + waves(x[0], 8, 9, 20, 60)) * (y / 7)
    color = GLAZE + (GLAZE_THIN - GLAZE) * np.clip(thin, 0, 1)[..., None]
    color = mixed(color, SPECKLE, speckles(x, y))
    color = mixed(np.broadcast_to(CLAY, color.shape), color, glaze)
    color = mixed(color, GOLD, gold)

    roughness = 0.78 + (0.14 - 0.78) * glaze
    roughness = roughness + (0.27 - roughness) * gold
    packed = np.stack([np.zeros_like(gold), roughness, gold], axis=-1)

    ridges = 0.012 * np.sin(2 * np.pi * y / 0.42 + 0.5 * np.sin(1.3 * y))
    height = ridges * (1 - 0.75 * glaze) + 0.03 * smoothed(glaze) + 0.012 * smoothed(gold)
    return Paint(encoded_srgb(color), eight_bits(packed), normals(height))


def mixed(below: Array, above: Array, share: Array) -> Array:
    """`above` laid over `below` where `share` is 1."""
    result: Array = below + (above - below) * share[..., None]
    return result


def smoothed(image: Array) -> Array:
    """The image with soft edges, so that its slope spans a few pixels."""
    for _ in range(2):
        image = (np.roll(image, 1, 1) + image + np.roll(image, -1, 1)) / 3
        padded = np.pad(image, ((1, 1), (0, 0)), mode="edge")
        image = (padded[:-2] + image + padded[2:]) / 3
    return image


def normals(height_cm: Array) -> np.ndarray:
    """The tangent-space normal map (x right, y up) of a height field."""
    right = (np.roll(height_cm, -1, 1) - np.roll(height_cm, 1, 1)) / (2 * PIXEL_CM)
    down = np.gradient(height_cm, DOWN_CM / HEIGHT, axis=0)
    n = np.stack([-right, down, np.ones_like(right)], axis=-1)
    return eight_bits(0.5 + 0.5 * n / np.linalg.norm(n, axis=-1, keepdims=True))


def wood(size: int = 384) -> np.ndarray:
    """A slab of oiled walnut, cut along the grain."""
    random = default_rng(5)
    v, u = np.meshgrid(*[(np.arange(size) + 0.5) / size - 0.5] * 2, indexing="ij")
    bend = sum(
        0.03 / k * np.sin(2 * np.pi * k * (u * random.uniform(0.4, 0.9) + random.random()))
        for k in range(1, 6)
    )
    across = v + bend + 0.25 * u * u
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (13 * across + 1.2 * np.sin(5 * across)))
    pores = random.random((size, size // 16)).repeat(16, axis=1)
    fine = 0.5 * pores + 0.5 * np.roll(pores, 7, axis=1)
    dark, light = np.array([0.09, 0.04, 0.018]), np.array([0.3, 0.155, 0.07])
    share = np.clip(0.25 + 0.55 * rings**1.6 + 0.3 * (np.round(fine * 8) / 8 - 0.5), 0, 1)
    return encoded_srgb(dark + (light - dark) * share[..., None])


def encoded_srgb(linear: Array) -> np.ndarray:
    """8-bit sRGB pixels."""
    x = np.clip(linear, 0, 1)
    return eight_bits(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055))


def eight_bits(values: Array) -> np.ndarray:
    """0..1 as 0..255."""
    return np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)
