"""Two spheres over a checkered floor, after the best-known picture of Whitted 1980."""

from __future__ import annotations

from typing import Any

import numpy as np
from kit import coarse, placement, rows, scene_json

GLASS_IOR = 1.5
# The clear sphere is blown hollow: its wall is a tenth of its radius.
CLEAR = {"center": [-0.25, 1.75, 1.1], "radius": 0.85}
SHINY = {"center": [0.95, 1.05, -0.95], "radius": 0.9}


def sky() -> np.ndarray[Any, np.dtype[np.float32]]:
    """The sky (32, 1, 3) from the zenith down: blue, paler towards the horizon and below it."""
    elevation = np.linspace(1.0, -1.0, 32)[:, None]
    zenith, horizon = np.array([0.04, 0.17, 0.62]), np.array([0.2, 0.42, 0.85])
    share = np.clip(1.0 - elevation, 0.0, 1.0) ** 2
    return coarse(zenith + (horizon - zenith) * share, 1 / 1024)[:, None, :]


def build() -> dict[str, bytes]:
    """The files of the scene."""
    floor = placement([-0.6, -0.35, 0.0], [4.2, 0, 0], [0, 0, -5.5], [0, 1, 0])
    scene = {
        "version": 1,
        "name": "Whitted's spheres",
        "description": "Two spheres over a checkered floor, after Whitted 1980: one clear and "
        "hollow, one diffuse under a clear coat. Rendered with the whitted integrator; path "
        "works too.",
        "settings": {
            "width": 640,
            "height": 480,
            "spp": 64,
            "max_depth": 12,
            "integrator": "whitted",
        },
        "cameras": [
            {
                "type": "perspective",
                "fov_deg": 33,
                "look_at": {"origin": [-0.1, 2.05, 8.2], "target": [0.15, 1.02, 0]},
            }
        ],
        "textures": {
            "squares": {
                "type": "checker",
                "color0": [0.82, 0.05, 0.03],
                "color1": [0.9, 0.74, 0.06],
                "uv_transform": [[5, 0, 0], [0, 6.5, 0]],
            }
        },
        "materials": {
            "floor": {"type": "diffuse", "reflectance": {"texture": "squares"}},
            "glass": {"type": "dielectric", "int_ior": GLASS_IOR, "ext_ior": 1},
            "hollow": {"type": "dielectric", "int_ior": 1, "ext_ior": GLASS_IOR},
            "coated": {
                "type": "plastic",
                "diffuse_reflectance": [0.62, 0.42, 0.66],
                "int_ior": 1.9,
            },
        },
        "shapes": [
            {"type": "sphere", "name": "clear sphere", "material": "glass", **CLEAR},
            {
                "type": "sphere",
                "name": "its hollow",
                "material": "hollow",
                "center": CLEAR["center"],
                "radius": 0.9 * 0.85,
            },
            {"type": "sphere", "name": "diffuse sphere", "material": "coated", **SHINY},
            {"type": "rectangle", "name": "floor", "material": "floor", "transform": rows(floor)},
        ],
        "lights": [
            {"type": "environment", "pixels": sky()},
            {"type": "directional", "direction": [-0.35, -1, -0.45], "irradiance": [2.3, 2.2, 2.0]},
        ],
    }
    return {"whitted_spheres.json": scene_json(scene)}
