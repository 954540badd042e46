"""Scenes whose size is a number, and what is measured on them (each in a fresh process)."""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np
import raykiln as rk
from numpy.typing import NDArray

Json = dict[str, Any]
GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)
# References have so many times the samples of what is measured against them.
REFERENCE_FACTOR = 16


def hills(triangles: int) -> rk.Scene:
    """A landscape of about so many triangles under an even sky."""
    side = max(1, round((triangles / 2) ** 0.5))
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1), indexing="ij")
    y = 0.12 * np.sin(5 * x + 2 * np.sin(3 * z)) * np.cos(4 * z) + 0.01 * np.sin(60 * x) * np.sin(
        60 * z
    )
    i = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    step = np.array([[0, 1, side + 2], [0, side + 2, side + 1]]).reshape(1, 6)
    scene = rk.Scene()
    scene.add_mesh(
        np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32),
        (i + step).reshape(-1, 3).astype(np.uint32),
        material=rk.Diffuse(reflectance=0.5),
    )
    scene.add_light(rk.ConstantLight(radiance=1.0))
    scene.set_camera(origin=(0.9, 0.9, 1.4), target=(0, -0.05, 0), fov_deg=45)
    return scene


def lamps(count: int) -> rk.Scene:
    """So many square lamps over a plane with blocks; their area in all is always the same."""
    number = np.arange(count)
    radius, angle = 6 * np.sqrt((number + 0.5) / count), number * GOLDEN_ANGLE
    centers = np.stack([radius * np.cos(angle), 1 + 0 * radius, radius * np.sin(angle)], axis=1)
    half = 0.6 / count**0.5
    square = half * np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)])
    first = 4 * np.arange(count)[:, None]
    scene = rk.Scene()
    scene.add_mesh(
        (centers[:, None, :] + square).reshape(-1, 3).astype(np.float32),
        (first + np.array([[0, 1, 2, 0, 2, 3]])).reshape(-1, 3).astype(np.uint32),
        material=rk.Diffuse(reflectance=0.0),
        emission=(40.0, 34.0, 26.0),
    )
    plane = np.array([(-20, 0, -20), (-20, 0, 20), (20, 0, 20), (20, 0, -20)], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    scene.add_mesh(plane, faces, material=rk.Diffuse(reflectance=0.5))
    for i in range(1, 41):
        distance, turn = 5.5 * (i / 40) ** 0.5, i * GOLDEN_ANGLE + 0.7
        scene.add_sphere((distance * np.cos(turn), 0.25, distance * np.sin(turn)), 0.25)
    scene.set_camera(origin=(0, 4.2, 9), target=(0, 0, 0.6), fov_deg=45)
    return scene


def render(
    scene: rk.Scene | rk.PreparedScene, size: int, spp: int, **settings: Any
) -> rk.RenderResult:
    """A square image of depth 4, box filter."""
    chosen = {"max_depth": 4, "filter": "box", **settings}
    return rk.render(scene, rk.RenderSettings(width=size, height=size, spp=spp, **chosen))


def timed(kind: str, value: Any, size: int, spp: int, threads: int) -> Json:
    """Times of one render; `kind` says what `value` is."""
    scene = hills(int(value)) if kind == "triangles" else rk.load_scene(str(value))
    stats = render(scene, size, spp, threads=threads).stats
    return {
        "triangles": stats.triangles,
        "samples": stats.samples,
        "render_s": stats.render_s,
        "bvh_s": stats.bvh_s,
        "samples_per_s": stats.samples / stats.render_s,
        "peak_bytes": stats.peak_memory_bytes,
    }


def lit(count: int, size: int, spp: int) -> Json:
    """Time and error with so many lamps, against two independent references of the same scene."""
    scene = rk.prepare(lamps(count))
    same = [render(scene, size, spp, seed=1) for _ in range(3)]
    first, second = (render(scene, size, REFERENCE_FACTOR * spp, seed=s).image for s in (2, 3))
    rel_mse = error(same[0].image, first, second)
    seconds = statistics.median(result.stats.render_s for result in same)
    return {
        "lights": count,
        "render_s": seconds,
        "rel_mse": rel_mse,
        "error_per_sample": rel_mse * spp,
        "cost": rel_mse * seconds,
    }


def error(
    image: NDArray[np.float32], first: NDArray[np.float32], second: NDArray[np.float32]
) -> float:
    """relMSE; as the two references are independent, their noise cancels in the mean."""
    mean = (first + second) / 2
    product = (image - first).astype(np.float64) * (image - second)
    return float(np.mean(product / (mean.astype(np.float64) ** 2 + 0.01)))
