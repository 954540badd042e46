"""A thousand small lamps, each of its own colour, over a plaza of plain blocks.

The lamps float where the seeds of a sunflower would grow: turned by the golden angle from one to
the next, so that they lie evenly without ever lying in rows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from kit import placement, rows, scene_json

LAMPS = 1000
LAMP_RADIUS = 0.03
LAMP_RADIANCE = 24.0
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
SPACING = 0.235
TOWERS = 80


def spiral(number: float) -> tuple[float, float, float]:
    """x, z and distance from the middle of a place on the spiral."""
    distance, angle = SPACING * math.sqrt(number + 0.5), number * GOLDEN_ANGLE
    return distance * math.cos(angle), distance * math.sin(angle), distance


def wave(distance: float) -> float:
    """How high things reach at a distance from the middle: rings, dying away."""
    return 1.0 + 1.15 * math.cos(1.75 * distance) * math.exp(-0.16 * distance)


def color(turn: float) -> list[float]:
    """A saturated hue; a whole turn goes once round the circle."""
    rgb = 0.5 + 0.5 * np.cos(2 * math.pi * (turn - np.array([0.0, 1 / 3, 2 / 3])))
    saturated: list[float] = (0.03 + rgb**1.5).tolist()
    return saturated


def lamp(number: int) -> dict[str, Any]:
    """A lamp above the rings; the hue goes round with the distance and the direction."""
    x, z, distance = spiral(number)
    turn = math.atan2(z, x) / (2 * math.pi) + 0.11 * distance
    return {
        "type": "sphere",
        "center": [x, wave(distance) + 0.14, z],
        "radius": LAMP_RADIUS,
        "emission": {"radiance": [LAMP_RADIANCE * c for c in color(turn)]},
    }


def tower(number: int) -> dict[str, Any]:
    """A block between the lamps, turned towards the middle."""
    x, z, distance = spiral(0.5 + number * LAMPS / TOWERS)
    height = 0.8 * wave(distance)
    outward = np.array([x, 0.0, z]) / distance
    across = np.array([-outward[2], 0.0, outward[0]])
    center = [x, height / 2, z]
    matrix = placement(center, 0.26 * outward, [0, height / 2, 0], -0.26 * across)
    return {"type": "cube", "material": "stone", "transform": rows(matrix)}


def build() -> dict[str, bytes]:
    """The files of the scene."""
    ground = placement([0, 0, 0], [40, 0, 0], [0, 0, -40], [0, 1, 0])
    stage = {"type": "rectangle", "name": "ground", "material": "ground", "transform": rows(ground)}
    scene = {
        "version": 1,
        "name": "A thousand lamps",
        "description": "A thousand small sphere lights of as many colours on a golden-angle "
        "spiral, over plain blocks and a glossy ground: a test of choosing lights.",
        "settings": {"width": 768, "height": 432, "spp": 160, "max_depth": 5},
        "cameras": [
            {
                "type": "perspective",
                "fov_deg": 30,
                "look_at": {"origin": [0, 6.2, 15.5], "target": [0, 0.2, 0.6]},
            }
        ],
        "materials": {
            "stone": {"type": "diffuse", "reflectance": 0.8},
            "ground": {"type": "plastic", "diffuse_reflectance": 0.3, "alpha": 0.12},
        },
        "shapes": [
            stage,
            *(tower(i) for i in range(TOWERS)),
            *(lamp(i) for i in range(LAMPS)),
        ],
    }
    return {"many_lights.json": scene_json(scene)}
