"""The camera and the lights that bare scenes get."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from format_support import LoadText
from hypothesis import given
from hypothesis import strategies as st
from raykiln.scene import (
    ConstantLight,
    EnvironmentLight,
    PerspectiveCamera,
    Rectangle,
    Scene,
    fov_y_rad,
)
from raykiln.studio import complete, scene_points, studio_light, studio_pixels

ASPECTS = ((512, 512), (1920, 1080), (1080, 1920), (100, 10))


def on_image(camera: PerspectiveCamera, points: Any, width: int, height: int) -> Any:
    """Image coordinates in -1..1 of points, and their depths."""
    matrix = np.array(camera.transform)
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    tan_y = math.tan(fov_y_rad(camera, width, height) / 2)
    depth = -local[:, 2]
    return local[:, 0] / depth / (tan_y * width / height), local[:, 1] / depth / tan_y, depth


@given(st.integers(0, 2**31), st.floats(1e-4, 1e4))
def test_the_view_holds_all_points_and_fills_the_frame(seed: int, size: float) -> None:
    random = np.random.default_rng(seed)
    vertices = random.normal(size=(50, 3)) * size * random.uniform(0.1, 3, 3) + size
    scene = Scene()
    scene.add_mesh(vertices, random.integers(0, 50, (20, 3)))
    complete(scene)
    (camera,) = scene.cameras
    for width, height in ASPECTS:
        x, y, depth = on_image(camera, vertices, width, height)
        assert depth.min() > 0
        assert max(np.abs(x).max(), np.abs(y).max()) <= 1
        # Along the shorter side of the image, or across it, at least four fifths are used.
        shorter = (np.ptp(y) if width >= height else np.ptp(x)) / 2
        across = (np.ptp(x) * width if width >= height else np.ptp(y) * height) / 2
        assert max(shorter, across / min(width, height)) > 0.8


def test_the_view_is_upright_from_the_front_and_above() -> None:
    scene = Scene()
    scene.add_sphere()
    complete(scene)
    matrix = np.array(scene.cameras[0].transform)
    right, up, back = matrix[:3, 0], matrix[:3, 1], matrix[:3, 2]
    assert np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3))
    assert abs(right[1]) < 1e-12
    assert up[1] > 0.8
    assert 0.2 < back[1] < 0.6
    assert back[0] > 0
    assert back[2] > 0


def test_shapes_of_all_kinds_span_the_bounds(load_text: LoadText) -> None:
    scene = Scene()
    scene.add_sphere((5, 0, 0), 2)
    scene.shapes.append(
        Rectangle(transform=((1, 0, 0, 0), (0, 1, 0, 9), (0, 0, 1, 0), (0, 0, 0, 1)))
    )
    scene.add_sphere((0, 0, 0), 1, group="g")
    moved = np.eye(4)
    moved[:3, 3] = (0, 0, -7)
    scene.add_instances("g", [moved])
    points = scene_points(scene)
    assert points.max(axis=0).tolist() == pytest.approx([7, 10, 2])
    assert points.min(axis=0).tolist() == pytest.approx([-1, -2, -8])


@pytest.mark.parametrize("vertices", [np.zeros((3, 3)), np.ones((3, 3)) * 1e20, np.empty((0, 3))])
def test_bounds_without_a_size_still_give_a_camera(vertices: Any) -> None:
    scene = Scene()
    scene.add_mesh(vertices, np.empty((0, 3), np.uint32))
    complete(scene)
    assert np.isfinite(np.array(scene.cameras[0].transform)).all()


def test_what_is_there_is_left_alone() -> None:
    scene = Scene()
    scene.add_sphere(emission=1.0)
    camera = scene.set_camera(origin=(0, 0, 5), target=(0, 0, 0))
    complete(scene)
    assert scene.cameras == [camera]
    assert scene.lights == []
    assert scene.warnings == []


def test_a_light_in_a_group_counts_only_if_the_group_is_used() -> None:
    scene = Scene()
    scene.add_sphere(emission=1.0, group="lamp")
    complete(scene)
    assert len(scene.lights) == 1
    scene.lights.clear()
    scene.add_instances("lamp", [np.eye(4)])
    complete(scene)
    assert scene.lights == []
    scene.add_light(ConstantLight(radiance=1))


def test_both_additions_are_said() -> None:
    scene = Scene()
    scene.add_sphere()
    complete(scene)
    assert len(scene.warnings) == 2
    assert "camera" in scene.warnings[0]
    assert "light" in scene.warnings[1]


def test_the_studio_has_a_mean_radiance_of_one() -> None:
    pixels = studio_pixels()
    assert pixels.dtype == np.float32
    assert pixels.shape == (64, 128, 3)
    weight = np.sin((np.arange(64) + 0.5) / 64 * math.pi)[:, None, None]
    assert float((pixels * weight).sum() / (weight.sum() * 128 * 3)) == pytest.approx(1, abs=1e-4)
    assert pixels.min() > 0


def test_the_key_light_is_to_the_left_of_the_camera_wherever_it_looks() -> None:
    for origin in ((0, 0, 5), (5, 1, 0), (-3, 2, -4)):
        scene = Scene()
        camera = scene.set_camera(origin=origin, target=(0, 0, 0))
        light = studio_light(camera)
        assert isinstance(light, EnvironmentLight)
        assert light.pixels is not None
        assert light.transform is not None
        row, column = np.unravel_index(light.pixels[..., 0].argmax(), light.pixels.shape[:2])
        theta, phi = (row + 0.5) / 64 * math.pi, (column + 0.5) / 128 * 2 * math.pi
        local = np.array([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)])
        to_key = np.array(light.transform)[:3, :3] @ local
        assert to_key @ np.cross([0, 1, 0], origin) < 0
        assert to_key @ np.array(origin, np.float64) > 0
        assert to_key[1] > 0
