"""Four plates and four lamps, after Veach's test of multiple importance sampling.

Each plate is tilted so that its middle mirrors the row of lamps to the camera.  From the first
plate to the last the roughness grows, and from the first lamp to the last the size, while the
power of the lamps stays the same: no single way of sampling is good everywhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from kit import placement, rows, scene_json, unit

CAMERA = np.array([0.0, 2.3, 13.5])
LAMPS = np.array([0.0, 4.6, -3.2])
# From the far plate to the near one.
PLATES = [(0.95, -0.6, 0.0035), (0.35, 1.0, 0.018), (-0.2, 2.6, 0.06), (-0.7, 4.3, 0.16)]
LAMP_RADII = [0.035, 0.125, 0.4, 0.95]
LAMP_X = [-3.9, -1.75, 0.75, 3.7]
LAMP_COLORS = [(1.0, 0.55, 0.3), (1.0, 0.86, 0.4), (0.42, 0.92, 0.6), (0.45, 0.66, 1.0)]
POWER = 60.0


def plate(number: int, height: float, depth: float) -> dict[str, Any]:
    """A plate whose normal halves the angle between lamps and camera."""
    center = np.array([0.0, height, depth])
    normal = unit(unit(LAMPS - center) + unit(CAMERA - center))
    across = np.array([3.6, 0.0, 0.0])
    along = 0.62 * np.cross(normal, [1.0, 0.0, 0.0])
    return {
        "type": "rectangle",
        "name": f"plate {number}",
        "material": f"metal {number}",
        "transform": rows(placement(center, across, along, normal)),
    }


def lamp(number: int) -> dict[str, Any]:
    """A sphere of the common power; a sphere of radiance L has the power 4 pi^2 r^2 L."""
    radius, color = LAMP_RADII[number], np.array(LAMP_COLORS[number])
    luminance = color @ [0.2126, 0.7152, 0.0722]
    radiance = color / luminance * POWER / (4 * math.pi**2 * radius**2)
    return {
        "type": "sphere",
        "name": f"lamp {number + 1}",
        "center": [LAMP_X[number], LAMPS[1], LAMPS[2]],
        "radius": radius,
        "emission": {"radiance": radiance.tolist()},
    }


def build() -> dict[str, bytes]:
    """The files of the scene."""
    wall = placement([0, 5, -6], [22, 0, 0], [0, 14, 0], [0, 0, 1])
    floor = placement([0, -1.6, 4], [22, 0, 0], [0, 0, -14], [0, 1, 0])
    overhead = placement([0, 11, 9], [2.5, 0, 0], [0, -1.2, 1.6], [0, -0.8, -0.6])
    metals = {
        f"metal {i}": {
            "type": "conductor",
            "metal": "Al",
            "alpha": alpha,
            "specular_reflectance": 0.85,
        }
        for i, (_, _, alpha) in enumerate(PLATES, 1)
    }
    scene = {
        "version": 1,
        "name": "Veach's plates",
        "description": "Four metal plates, from polished to rough, mirror four lamps of equal "
        "power, from a point to a globe: a test of multiple importance sampling, after Veach.",
        "settings": {"width": 768, "height": 512, "spp": 128, "max_depth": 6},
        "cameras": [
            {
                "type": "perspective",
                "fov_deg": 37,
                "look_at": {"origin": CAMERA.tolist(), "target": [0, 1.35, 0]},
            }
        ],
        "materials": {"grey": {"type": "diffuse", "reflectance": 0.4}, **metals},
        "shapes": [
            *(plate(i, height, depth) for i, (height, depth, _) in enumerate(PLATES, 1)),
            *(lamp(i) for i in range(len(LAMP_RADII))),
            {"type": "rectangle", "name": "wall", "material": "grey", "transform": rows(wall)},
            {"type": "rectangle", "name": "floor", "material": "grey", "transform": rows(floor)},
            {
                "type": "rectangle",
                "name": "overhead light",
                "transform": rows(overhead),
                "emission": {"radiance": 5},
            },
        ],
    }
    return {"veach_mis.json": scene_json(scene)}
