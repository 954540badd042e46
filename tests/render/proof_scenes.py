"""Small scenes that each ask something else of light transport."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import raykiln as rk

from .support import ceiling_light, floor, looking, placed


def _room(floor_material: Any) -> rk.Scene:
    scene = rk.Scene()
    scene.add_material("floor", floor_material)
    scene.add_material("black", rk.Diffuse(reflectance=0.0))
    scene.shapes.append(floor("floor"))
    return looking(scene, (0, 2.2, 5), (0, 0.9, 0))


def area_light() -> rk.Scene:
    """Diffuse surfaces under a square lamp."""
    scene = _room(rk.Diffuse(reflectance=(0.7, 0.5, 0.3)))
    scene.add_sphere((0, 1, 0), 0.9, rk.Diffuse(reflectance=(0.2, 0.4, 0.8)))
    scene.shapes.append(ceiling_light((8.0, 7.0, 6.0), 0.8, 3.0))
    return scene


def glossy_lamps() -> rk.Scene:
    """Lamps of very different sizes above brushed metal."""
    scene = _room(rk.Conductor(metal="Al", alpha=0.15, alpha_v=0.4))
    for x, radius in ((-1.5, 0.05), (0.0, 0.3), (1.5, 0.7)):
        scene.add_sphere((x, 1.2, -0.5), radius, "black", emission=0.5 / radius**2)
    return scene


def environment() -> rk.Scene:
    """Rough plastic under a map with a small sun."""
    scene = _room(rk.Diffuse(reflectance=0.4))
    scene.add_sphere((0, 1, 0), 0.9, rk.Plastic(diffuse_reflectance=0.5, alpha=0.2))
    pixels = np.full((32, 64, 3), 0.3, np.float32)
    pixels[6:9, 20:23] = 40, 35, 20
    scene.add_light(rk.EnvironmentLight(pixels=pixels))
    return scene


def glass_under_a_sky() -> rk.Scene:
    """Frosted glass, which takes light from all sides, under a turned map with a sun."""
    scene = _room(rk.Diffuse(reflectance=0.4))
    scene.add_sphere((0, 1, 0), 0.9, rk.Dielectric(alpha=0.4))
    pixels = np.full((18, 37, 3), 0.3, np.float32)
    pixels[3:5, 11:13] = 40, 35, 20
    turned = [[0.6, 0, 0.8, 0], [0, 1, 0, 0], [-0.8, 0, 0.6, 0], [0, 0, 0, 1]]
    scene.add_light(rk.EnvironmentLight(pixels=pixels, transform=turned))
    return scene


def rough_glass() -> rk.Scene:
    """Frosted glass, a lamp behind it and a constant sky."""
    scene = _room(rk.Diffuse(reflectance=0.6))
    scene.add_sphere((0, 1, 0), 0.9, rk.Dielectric(alpha=0.3))
    scene.add_sphere((0.8, 1.6, -2.0), 0.6, "black", emission=(6.0, 4.0, 2.0))
    scene.add_light(rk.ConstantLight(radiance=(0.1, 0.1, 0.2)))
    return scene


def cut_out_instances() -> rk.Scene:
    """Mirrored, unevenly scaled lamps seen through a grid of holes; a principled floor."""
    scene = _room(rk.Principled(base_color=(0.8, 0.6, 0.4), roughness=0.4, metallic=0.3))
    holes = np.array([[255, 0, 128], [0, 255, 255]], np.uint8)[:, :, None]
    scene.add_texture("holes", rk.ImageTexture(pixels=holes, filter="nearest"))
    opacity = rk.TextureRef(texture="holes", channel="r")
    scene.add_material("screen", rk.Diffuse(reflectance=0.5, opacity=opacity))
    scene.shapes.append(rk.Rectangle(material="screen", transform=placed((0, 1.2, 0.5))))
    points = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint32)
    shine = rk.Emission(radiance=(3.0, 4.0, 5.0), two_sided=True)
    scene.add_mesh(points, faces, material="black", emission=shine, group="lamp")
    places = [placed((-1, 1.5, -1), (0.8, 1.0, 0.5)), placed((1, 1.2, -1), (-0.5, 1.0, 0.9))]
    scene.add_instances("lamp", np.array(places, np.float32))
    return scene


def inside_a_lamp() -> rk.Scene:
    """Within a large sphere that shines inwards, under a small one."""
    scene = _room(rk.Diffuse(reflectance=0.5))
    scene.add_material("shell", rk.Diffuse(reflectance=0.1))
    shell = {"material": "shell", "flip_normals": True, "radius": 12.0}
    scene.shapes.append(rk.Sphere(**shell, emission=rk.Emission(radiance=0.2)))
    scene.add_sphere((1, 2, 0), 0.3, "black", emission=8.0)
    scene.add_sphere((-0.5, 0.8, 0), 0.7, rk.Conductor(metal="Au", alpha=0.1))
    return scene


def small_lamps() -> rk.Scene:
    """Lamps that look small from the floor, and large from what stands below one of them."""
    scene = _room(rk.Diffuse(reflectance=(0.7, 0.5, 0.3)))
    for x in (-2.0, -1.0, 0.0, 1.0, 2.0):
        place = placed((x, 2.2, -0.3), (0.08, 0.08, 1), turn_x_deg=90)
        shine = rk.Emission(radiance=(80.0, 70.0, 60.0))
        scene.shapes.append(rk.Rectangle(material="black", transform=place, emission=shine))
    scene.add_sphere((0, 1.0, -0.3), 0.8, rk.Diffuse(reflectance=(0.2, 0.4, 0.8)))
    scene.add_sphere((1.6, 0.5, 0.8), 0.5, rk.Plastic(diffuse_reflectance=0.5, alpha=0.3))
    return scene


SCENES: dict[str, Callable[[], rk.Scene]] = {
    make.__name__: make
    for make in (
        area_light, glossy_lamps, environment, glass_under_a_sky, rough_glass,
        cut_out_instances, inside_a_lamp, small_lamps,
    )
}  # fmt: skip
