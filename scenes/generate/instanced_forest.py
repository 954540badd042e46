"""A wooded valley: over a million triangles from a few prototypes, placed thousands of times."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from kit import Array, coarse, directions, lobe, quad_faces, scene_json, unit
from numpy.random import Generator, default_rng

GRID = 1 / 1024  # vertices are rounded to this many metres
SIZE, CELLS = 130.0, 104  # of the terrain, in metres and in cells a side
SUN = unit([-0.62, 0.62, 0.3])
UP = np.array([0.0, 1.0, 0.0])
EYE = np.array([0.0, 0.0, 50.0])


class Triangles(NamedTuple):
    """Vertices (n, 3) and faces (m, 3)."""

    vertices: Array
    faces: np.ndarray[Any, np.dtype[np.int64]]


def joined(parts: list[Triangles]) -> Triangles:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    return Triangles(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def trunk(height: float, radius: float, sides: int = 7, bend: float = 0.0) -> Triangles:
    """A cone that stands on the ground, with a bend along x."""
    rings = 5
    share = np.linspace(0, 1, rings)
    angle = np.arange(sides) / sides * 2 * np.pi
    width = radius * (1 - 0.85 * share)[:, None]
    x = width * np.cos(angle) + bend * share[:, None] ** 2
    z = width * np.sin(angle)
    y = np.broadcast_to(height * share[:, None], x.shape)
    low = np.arange(sides * (rings - 1))
    beside = low // sides * sides + (low + 1) % sides
    above = low + sides
    faces = np.concatenate(
        [np.stack([low, above, beside], 1), np.stack([beside, above, beside + sides], 1)]
    )
    return Triangles(np.stack([x, y, z], -1).reshape(-1, 3), faces)


def leaves(centers: Array, along: Array, across: Array) -> Triangles:
    """A pointed leaf of two triangles at each centre, from its stalk to its tip."""
    corners = np.stack(
        [centers - along, centers + across - 0.2 * along, centers + along, centers - across], axis=1
    )
    return Triangles(corners.reshape(-1, 3), quad_faces(len(centers)))


def spruce(random: Generator) -> tuple[Triangles, Triangles]:
    """Whorls of drooping boughs, each a feather of twigs to both sides; 10 m high."""
    stems, twigs = [np.array([0.0, 9.9, 0.0])], [np.array([0.0, 0.45, 0.0])]
    levels, boughs, pairs = 19, 8, 5
    for level in range(levels):
        share = level / levels
        reach = 2.2 * (1 - share) ** 0.85 + 0.2
        for bough in range(boughs - 3 * level // levels):
            angle = 2 * math.pi * (bough / boughs + 0.381 * level) + random.normal(0, 0.12)
            out = np.array([math.cos(angle), 0.0, math.sin(angle)])
            aside = np.array([-out[2], 0.0, out[0]])
            droop = 0.2 + 0.3 * (1 - share) + random.normal(0, 0.06)
            for t in np.linspace(0.2, 1.0, pairs):
                point = out * reach * t + [0, 1.1 + 8.7 * share - droop * reach * t * t, 0]
                for side in (-1.0, 1.0):
                    way = out * 0.75 + aside * side * (1.15 - 0.75 * t) - [0, 0.35 + 0.4 * t, 0]
                    twigs.append((way + random.normal(0, 0.12, 3)) * (0.16 + 0.15 * reach) * 0.8)
                    stems.append(point + 0.75 * twigs[-1])
    along = np.array(twigs)
    across = unit(np.cross(along, random.normal(0, 0.35, along.shape) + UP))
    width = 0.22 * np.linalg.norm(along, axis=1, keepdims=True)
    return trunk(9.6, 0.17), leaves(np.array(stems), along, across * width)


def broadleaf(random: Generator, height: float, blobs: int, count: int) -> tuple[Triangles, ...]:
    """A bent trunk under a crown of rounded masses of leaves."""
    bend = random.normal(0, 0.35)
    middle = np.array([bend, 0.68 * height, 0])
    centers = middle + random.normal(0, 1, (blobs, 3)) * height * np.array([0.15, 0.1, 0.15])
    radii = height * random.uniform(0.11, 0.19, blobs)
    chosen = random.integers(blobs, size=count)
    outward = unit(random.normal(0, 1, (count, 3)) + 0.25 * UP)
    depth = radii[chosen] * random.uniform(0.72, 1.05, count)
    points = centers[chosen] + outward * depth[:, None]
    # Leaves hang outwards and down, turned a little at random.
    along = unit(outward - 0.7 * UP + random.normal(0, 0.45, (count, 3)))
    across = unit(np.cross(along, outward + random.normal(0, 0.5, (count, 3))))
    size = height * 0.021 * random.uniform(0.8, 1.25, (count, 1))
    return trunk(0.72 * height, 0.03 * height, bend=bend), leaves(
        points, along * size, across * size * 0.62
    )


def bush(random: Generator, count: int) -> Triangles:
    """A low cushion of leaves, 1 m high."""
    outward = unit(random.normal(0, 1, (count, 3)) * [1, 0.7, 1] + 0.35 * UP)
    points = outward * random.uniform(0.6, 0.95, (count, 1)) * [0.9, 0.75, 0.9]
    points[:, 1] = np.abs(points[:, 1])
    along = unit(outward + 0.5 * UP + random.normal(0, 0.4, (count, 3)))
    across = unit(np.cross(along, random.normal(0, 1, (count, 3))))
    return leaves(points, along * 0.1, across * 0.045)


def grass(random: Generator, blades: int) -> Triangles:
    """A tuft of single-triangle blades, half a metre high."""
    foot = random.normal(0, 0.34, (blades, 3)) * [1, 0, 1]
    lean = random.normal(0, 0.16, (blades, 3)) * [1, 0, 1] + foot * 0.5
    tip = foot + lean + random.uniform(0.25, 0.55, (blades, 1)) * UP
    side = unit(random.normal(0, 1, (blades, 3)) * [1, 0, 1]) * 0.022
    vertices = np.stack([foot - side, foot + side, tip], axis=1).reshape(-1, 3)
    return Triangles(vertices, np.arange(3 * blades).reshape(-1, 3))


def ground(x: Any, z: Any) -> Array:
    """Height of the terrain: a valley along z that winds, between rolling slopes."""
    middle = 5.0 * np.sin(z / 17.0 + 0.6)
    off = np.abs(np.asarray(x) - middle)
    slopes = 13.0 * (1 - np.exp(-((off / 30.0) ** 2))) + 0.004 * off**2
    rolling = 1.1 * np.sin(x / 7.3 + 1.7) * np.cos(z / 9.1) + 0.5 * np.sin(x / 3.1 - z / 4.3)
    rise = 5.0 / (1.0 + np.exp((np.asarray(z) + 38.0) / 6.0))
    heights: Array = slopes + rolling * (1 - np.exp(-((off / 9.0) ** 2))) + rise
    return heights


def terrain() -> Triangles:
    """The ground as a height field."""
    line = np.linspace(-SIZE / 2, SIZE / 2, CELLS + 1)
    x, z = np.meshgrid(line, line)
    vertices = np.stack([x, ground(x, z), z], -1).reshape(-1, 3)
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).reshape(-1)
    below = corner + CELLS + 1
    faces = np.concatenate(
        [np.stack([corner, below, corner + 1], 1), np.stack([corner + 1, below, below + 1], 1)]
    )
    return Triangles(vertices, faces)


def scattered(
    random: Generator, count: int, clearing: float, apart: float, sizes: tuple[float, float]
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Matrices (n, 4, 4) of plants on the slopes, `clearing` metres from the valley's middle on."""
    places: list[Array] = []
    while len(places) < count:
        x, z = random.uniform(-SIZE / 2, SIZE / 2, 2)
        off = abs(x - 5.0 * math.sin(z / 17.0 + 0.6))
        in_view = z < EYE[2] - 5.0 and math.hypot(x, z - EYE[2]) > 15.0
        place = np.array([x, z])
        near = places[-160:]
        crowded = near and np.min(np.linalg.norm(np.array(near) - place, axis=1)) < apart
        if in_view and off > clearing * random.uniform(0.75, 1.5) and not crowded:
            places.append(place)
    x, z = np.array(places).T
    turn, scale = random.uniform(0, 2 * np.pi, count), random.uniform(*sizes, count)
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, 0, 0] = matrices[:, 2, 2] = scale * np.cos(turn)
    matrices[:, 0, 2] = scale * np.sin(turn)
    matrices[:, 2, 0] = -matrices[:, 0, 2]
    matrices[:, 1, 1] = scale * random.uniform(0.9, 1.15, count)
    matrices[:, :3, 3] = np.stack([x, ground(x, z) - 0.05, z], -1)
    return coarse(matrices, 1 / 4096)


def sky() -> np.ndarray[Any, np.dtype[np.float32]]:
    """A clear morning sky without the sun's disk (64, 128, 3), hazy near the sun."""
    toward = directions(64)
    height = np.clip(toward[..., 1:2], 0.0, 1.0)
    blue, haze = np.array([0.13, 0.3, 0.75]), np.array([0.85, 0.83, 0.76])
    gradient = blue + (haze - blue) * np.exp(-6.0 * height)
    glow = lobe(toward, SUN, 5.0) * [0.75, 0.55, 0.3] + lobe(toward, SUN, 60.0) * [2.6, 2.1, 1.4]
    return coarse(gradient + glow, 1 / 64)


def shape(mesh: Triangles, material: str) -> dict[str, Any]:
    """A mesh of the scene file."""
    return {
        "type": "mesh",
        "material": material,
        "vertices": coarse(mesh.vertices, GRID),
        "faces": mesh.faces.astype(np.uint32),
    }


def prototypes(random: Generator) -> dict[str, list[dict[str, Any]]]:
    """The groups that instances place."""
    tall, crown_of_tall = spruce(random)
    birch, crown_of_birch = broadleaf(random, 7.5, 8, 1100)
    oak, crown_of_oak = broadleaf(random, 8.5, 13, 1700)
    return {
        "spruce": [shape(tall, "bark"), shape(crown_of_tall, "needles")],
        "birch": [shape(birch, "white bark"), shape(crown_of_birch, "yellow leaves")],
        "oak": [shape(oak, "bark"), shape(crown_of_oak, "leaves")],
        "bush": [shape(bush(random, 420), "shrub")],
        "grass": [shape(grass(random, 240), "grass")],
    }


def plants(random: Generator) -> list[dict[str, Any]]:
    """The instances."""
    places = {
        "spruce": scattered(random, 620, 13.0, 2.0, (0.7, 1.35)),
        "birch": scattered(random, 170, 8.0, 2.6, (0.7, 1.1)),
        "oak": scattered(random, 160, 9.5, 3.2, (0.75, 1.15)),
        "bush": scattered(random, 650, 5.0, 0.8, (0.6, 1.5)),
        "grass": scattered(random, 3200, 0.6, 0.25, (0.6, 1.3)),
    }
    return [{"type": "instance", "group": g, "transforms": t} for g, t in places.items()]


def build() -> dict[str, bytes]:
    """The files of the scene."""
    random = default_rng(7)
    eye = [3.0, float(ground(3.0, 50.0)) + 6.5, 50.0]
    colors = {
        "earth": [0.14, 0.14, 0.05],
        "bark": [0.12, 0.08, 0.05],
        "white bark": [0.5, 0.48, 0.43],
        "needles": [0.045, 0.12, 0.055],
        "leaves": [0.12, 0.22, 0.04],
        "yellow leaves": [0.55, 0.32, 0.035],
        "shrub": [0.24, 0.16, 0.04],
        "grass": [0.28, 0.3, 0.07],
    }
    scene = {
        "version": 1,
        "name": "A wooded valley",
        "description": "Over a million triangles by instancing: 4,800 spruces, birches, oaks, "
        "bushes and tufts of five prototypes in a valley, under a low sun and a hazy sky.",
        "settings": {"width": 720, "height": 405, "spp": 64, "max_depth": 5},
        "cameras": [
            {
                "type": "perspective",
                "fov_deg": 36,
                "look_at": {"origin": eye, "target": [0.5, eye[1] - 3.0, 20]},
            }
        ],
        "materials": {n: {"type": "diffuse", "reflectance": c} for n, c in colors.items()},
        "groups": prototypes(random),
        "shapes": [{**shape(terrain(), "earth"), "name": "terrain"}, *plants(random)],
        "lights": [
            {"type": "environment", "pixels": sky(), "scale": 1.1},
            {"type": "directional", "direction": (-SUN).tolist(), "irradiance": [10.5, 8.8, 6.2]},
        ],
    }
    return {"instanced_forest.json": scene_json(scene)}
