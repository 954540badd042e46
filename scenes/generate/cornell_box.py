"""The Cornell box from its published measurements.

Source: "Cornell Box Data", Cornell University Program of Computer Graphics.  Positions are given
there in millimetres, reflectances at every 4 nm from 400 nm, the emission at every 100 nm.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from kit import quad_faces, scene_json
from raykiln.formats.spectra import rgb_of_constant, rgb_of_samples

MM = 0.001
REFLECTANCE_NM = np.arange(400.0, 701.0, 4.0)
# fmt: off
WHITE = [
    0.343, 0.445, 0.551, 0.624, 0.665, 0.687, 0.708, 0.723, 0.715, 0.710, 0.745, 0.758, 0.739,
    0.767, 0.777, 0.765, 0.751, 0.745, 0.748, 0.729, 0.745, 0.757, 0.753, 0.750, 0.746, 0.747,
    0.735, 0.732, 0.739, 0.734, 0.725, 0.721, 0.733, 0.725, 0.732, 0.743, 0.744, 0.748, 0.728,
    0.716, 0.733, 0.726, 0.713, 0.740, 0.754, 0.764, 0.752, 0.736, 0.734, 0.741, 0.740, 0.732,
    0.745, 0.755, 0.751, 0.744, 0.731, 0.733, 0.744, 0.731, 0.712, 0.708, 0.729, 0.730, 0.727,
    0.707, 0.703, 0.729, 0.750, 0.760, 0.751, 0.739, 0.724, 0.730, 0.740, 0.737,
]
GREEN = [
    0.092, 0.096, 0.098, 0.097, 0.098, 0.095, 0.095, 0.097, 0.095, 0.094, 0.097, 0.098, 0.096,
    0.101, 0.103, 0.104, 0.107, 0.109, 0.112, 0.115, 0.125, 0.140, 0.160, 0.187, 0.229, 0.285,
    0.343, 0.390, 0.435, 0.464, 0.472, 0.476, 0.481, 0.462, 0.447, 0.441, 0.426, 0.406, 0.373,
    0.347, 0.337, 0.314, 0.285, 0.277, 0.266, 0.250, 0.230, 0.207, 0.186, 0.171, 0.160, 0.148,
    0.141, 0.136, 0.130, 0.126, 0.123, 0.121, 0.122, 0.119, 0.114, 0.115, 0.117, 0.117, 0.118,
    0.120, 0.122, 0.128, 0.132, 0.139, 0.144, 0.146, 0.150, 0.152, 0.157, 0.159,
]
RED = [
    0.040, 0.046, 0.048, 0.053, 0.049, 0.050, 0.053, 0.055, 0.057, 0.056, 0.059, 0.057, 0.061,
    0.061, 0.060, 0.062, 0.062, 0.062, 0.061, 0.062, 0.060, 0.059, 0.057, 0.058, 0.058, 0.058,
    0.056, 0.055, 0.056, 0.059, 0.057, 0.055, 0.059, 0.059, 0.058, 0.059, 0.061, 0.061, 0.063,
    0.063, 0.067, 0.068, 0.072, 0.080, 0.090, 0.099, 0.124, 0.154, 0.192, 0.255, 0.287, 0.349,
    0.402, 0.443, 0.487, 0.513, 0.558, 0.584, 0.620, 0.606, 0.609, 0.651, 0.612, 0.610, 0.650,
    0.638, 0.627, 0.620, 0.630, 0.628, 0.642, 0.639, 0.657, 0.639, 0.635, 0.642,
]
# fmt: on
LIGHT_NM = [400.0, 500.0, 600.0, 700.0]
LIGHT_EMISSION = [0.0, 8.0, 15.6, 18.4]
LIGHT_REFLECTANCE = 0.78
# The emission is published in relative units; this brings the walls to a middle grey.
EXPOSURE = 2.0

# Corners of the quadrilaterals, counter-clockwise from inside the box (of the blocks: outside).
Corner = tuple[float, float, float]
Quad = list[Corner]

FLOOR: Quad = [(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]
CEILING: Quad = [(556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0)]
LIGHT: Quad = [(343, 548.8, 227), (343, 548.8, 332), (213, 548.8, 332), (213, 548.8, 227)]
BACK_WALL: Quad = [(549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)]
RIGHT_WALL: Quad = [(0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2)]
LEFT_WALL: Quad = [(552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)]
SHORT_BLOCK_TOP: Quad = [(130, 165, 65), (82, 165, 225), (240, 165, 272), (290, 165, 114)]
TALL_BLOCK_TOP: Quad = [(423, 330, 247), (265, 330, 296), (314, 330, 456), (472, 330, 406)]

FOCAL_LENGTH, FILM_WIDTH = 0.035, 0.025


def block(top: Quad) -> list[Quad]:
    """The top and the four sides of a block that stands on the floor."""
    sides: list[Quad] = [
        [p, q, (q[0], 0, q[2]), (p[0], 0, p[2])]
        for q, p in zip(top, [*top[1:], top[0]], strict=True)
    ]
    return [top, *sides]


def around(outer: list[Any], inner: list[Any]) -> list[Quad]:
    """What lies between two quadrilaterals: the ceiling has a hole where the light is."""
    turned = [(*outer[1:], outer[0]), (*inner[1:], inner[0])]
    return [list(q) for q in zip(outer, turned[0], turned[1], inner, strict=True)]


def mesh(name: str, material: str, quads: list[Quad]) -> dict[str, Any]:
    """A mesh of quadrilaterals, in metres."""
    corners = np.array(quads, np.float64).reshape(-1, 3) * MM
    faces = quad_faces(len(quads))
    return {
        "type": "mesh",
        "name": name,
        "material": material,
        "vertices": corners.tolist(),
        "faces": faces.tolist(),
    }


def paint(values: list[float]) -> dict[str, Any]:
    """A material of the measured reflectance, as linear Rec.709."""
    color = rgb_of_samples(REFLECTANCE_NM.tolist(), values, "reflectance")
    return {"type": "diffuse", "reflectance": list(color)}


def radiance() -> list[float]:
    """The measured emission as linear Rec.709, where an equal-energy light is white."""
    color = np.array(rgb_of_samples(LIGHT_NM, LIGHT_EMISSION, "emission"))
    scaled: list[float] = (EXPOSURE * color / rgb_of_constant(1.0, "emission")).tolist()
    return scaled


def build() -> dict[str, bytes]:
    """The files of the scene."""
    materials: dict[str, Any] = {
        "white": paint(WHITE),
        "green": paint(GREEN),
        "red": paint(RED),
        "lamp": {"type": "diffuse", "reflectance": LIGHT_REFLECTANCE},
    }
    lamp = mesh("light", "lamp", [LIGHT])
    lamp["emission"] = {"radiance": radiance()}
    scene = {
        "version": 1,
        "name": "Cornell box",
        "description": "The Cornell box from its published measurements: geometry, reflectance "
        "spectra and emission spectrum (integrated to linear Rec.709), and camera.",
        "settings": {"width": 512, "height": 512, "spp": 256, "max_depth": 12},
        "cameras": [
            {
                "type": "perspective",
                "fov_deg": math.degrees(2 * math.atan(FILM_WIDTH / 2 / FOCAL_LENGTH)),
                "look_at": {"origin": [0.278, 0.273, -0.8], "target": [0.278, 0.273, 0]},
            }
        ],
        "materials": materials,
        "shapes": [
            mesh("floor", "white", [FLOOR]),
            mesh("ceiling", "white", around(CEILING, LIGHT)),
            mesh("back wall", "white", [BACK_WALL]),
            mesh("right wall", "green", [RIGHT_WALL]),
            mesh("left wall", "red", [LEFT_WALL]),
            mesh("short block", "white", block(SHORT_BLOCK_TOP)),
            mesh("tall block", "white", block(TALL_BLOCK_TOP)),
            lamp,
        ],
    }
    return {"cornell_box.json": scene_json(scene)}
