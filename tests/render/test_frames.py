"""Turntables: where their cameras stand, and that each is a camera like any other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import raykiln as rk
from raykiln.frames import frame_times, targets_of
from raykiln.scene import look_at_matrix


@pytest.fixture
def scene() -> rk.Scene:
    made = rk.Scene()
    made.add_sphere(center=(1, 0, 0), radius=0.5, material=rk.Diffuse(reflectance=(0.8, 0.1, 0.1)))
    made.add_sphere(center=(-1, 0, 0), radius=0.5, material=rk.Diffuse(reflectance=0.4))
    made.add_light(rk.ConstantLight(radiance=(1, 1, 1)))
    made.set_camera(origin=(0, 1, 5), target=(0, 0, 0), name="front")
    return made


def eye(camera: rk.PerspectiveCamera) -> Any:
    if camera.look_at is not None:
        return look_at_matrix(camera.look_at)[:3, 3]
    return np.array(camera.transform)[:3, 3]


def test_the_turn_goes_counter_clockwise_and_its_end_is_left_out(scene: rk.Scene) -> None:
    cameras = rk.turntable(scene, 4)
    expected = [(0, 1, 5), (5, 1, 0), (0, 1, -5), (-5, 1, 0)]
    assert [eye(camera) for camera in cameras] == [pytest.approx(e, abs=1e-12) for e in expected]
    assert [camera.name for camera in cameras] == [f"turntable_000{i}" for i in (1, 2, 3, 4)]
    assert cameras[0].look_at == scene.cameras[0].look_at


def test_every_camera_looks_at_the_target(scene: rk.Scene) -> None:
    for axis in ("x", "y", "z"):
        for camera in rk.turntable(scene, 7, axis=axis, start_degrees=10):
            matrix = np.array(camera.transform)
            to_target = -matrix[:3, 3] / np.linalg.norm(matrix[:3, 3])
            assert -matrix[:3, 2] == pytest.approx(to_target)
            assert np.linalg.norm(matrix[:3, 3]) == pytest.approx(math.sqrt(26))
            assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)


def test_an_arc_and_its_start(scene: rk.Scene) -> None:
    cameras = rk.turntable(scene, 2, degrees=-180, start_degrees=90)
    assert eye(cameras[0]) == pytest.approx((5, 1, 0), abs=1e-12)
    assert eye(cameras[1]) == pytest.approx((0, 1, 5), abs=1e-12)


def test_elevation_keeps_the_distance(scene: rk.Scene) -> None:
    (camera,) = rk.turntable(scene, 1, elevation_degrees=30)
    distance = math.sqrt(26)
    assert eye(camera) == pytest.approx((0, distance / 2, distance * math.sqrt(3) / 2))


def placed(x: float, y: float, z: float, **more: Any) -> rk.PerspectiveCamera:
    """A camera at a point that looks along -z."""
    rows = ((1, 0, 0, x), (0, 1, 0, y), (0, 0, 1, z), (0, 0, 0, 1))
    return rk.PerspectiveCamera(transform=rows, **more)


def test_a_thing_alone_is_turned_about_its_centre() -> None:
    scene = rk.Scene()
    scene.add_sphere(center=(4, 2, 0), radius=1)
    scene.set_camera(placed(4, 2.5, 9))
    assert targets_of(scene, scene.cameras) == [pytest.approx((4, 2, 0))]
    assert eye(rk.turntable(scene, 2)[1]) == pytest.approx((4, 2.5, -9))
    assert eye(rk.turntable(scene, 2, target=(0, 0, 0))[1]) == pytest.approx((-4, 2.5, -9))


def test_a_thing_on_a_stage_is_what_is_turned_about() -> None:
    scene = rk.Scene()
    floor = np.array([[-20, 0, -30], [10, 0, -30], [10, 0, 10], [-20, 0, 10]], np.float32)
    scene.add_mesh(floor, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    scene.add_sphere(center=(0, 1, 0), radius=1, name="mug")
    scene.add_sphere(center=(0, 1, 0.98), radius=0.05, name="label")
    scene.add_sphere(center=(0, 1, -8), radius=1, name="behind")
    scene.set_camera(placed(0, 1, 6))
    assert targets_of(scene, scene.cameras) == [pytest.approx((0, 1, 0))]
    aside = placed(5, 1, 6)
    x, y, _ = targets_of(scene, [aside])[0]
    assert (x, y) == pytest.approx((5, 1)), "nothing in the middle: somewhere along the view"
    aimed = rk.PerspectiveCamera(look_at=rk.LookAt(origin=(0, 1, 6), target=(3, 0, 0)))
    assert targets_of(scene, [aimed]) == [(3, 0, 0)]


def test_a_scene_without_a_camera_turns_its_three_quarter_view() -> None:
    scene = rk.Scene()
    scene.add_sphere()
    cameras = rk.turntable(scene, 3)
    assert len({round(float(eye(c)[1]), 9) for c in cameras}) == 1


def test_turning_the_camera_is_turning_the_scene_the_other_way(scene: rk.Scene) -> None:
    """A second, independent way to the same picture."""
    settings = rk.RenderSettings(width=32, height=24, spp=64)
    camera = rk.turntable(scene, 12)[2]
    scene.set_camera(camera)
    turned_camera = rk.render(scene, settings).image
    angle = -math.radians(60)
    turned = rk.Scene(materials=scene.materials, lights=scene.lights)
    for sphere in scene.shapes:
        assert isinstance(sphere, rk.Sphere)
        x, y, z = sphere.center
        c, s = math.cos(angle), math.sin(angle)
        turned.add_sphere((c * x + s * z, y, -s * x + c * z), 0.5, sphere.material)
    turned.set_camera(origin=(0, 1, 5), target=(0, 0, 0))
    turned_scene = rk.render(turned, settings).image
    assert np.abs(turned_camera - turned_scene).mean() < 0.005
    still = rk.render(scene, settings.model_copy(update={"camera": "front"})).image
    assert np.abs(turned_camera - still).mean() > 0.05


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"count": 0}, "count"),
        ({"count": 3, "axis": "w"}, "axis"),
        ({"count": 3, "degrees": math.inf}, "degrees"),
        ({"count": 3, "elevation_degrees": 90}, "elevation_degrees"),
        ({"count": 3, "elevation_degrees": 0, "target": (0, 1, 5)}, "elevation_degrees"),
        ({"count": 3, "elevation_degrees": 0, "target": (0, 7, 5)}, "elevation_degrees"),
        ({"count": 3, "camera": "back"}, "camera"),
    ],
)
def test_what_cannot_be_turned_is_named(
    scene: rk.Scene, options: dict[str, Any], where: str
) -> None:
    with pytest.raises(rk.SettingsError, match=f"^{where}: "):
        rk.turntable(scene, **options)


def test_moments() -> None:
    assert frame_times(0, 1, 2) == [0, 0.5, 1]
    assert len(frame_times(0, 0.1, 30)) == 4
    assert frame_times(2, 2, 24) == [2]
    for wrong in ((1, 0, 24), (0, 1, 0), (0, math.nan, 1), (0, 1e9, 1000)):
        with pytest.raises(rk.SettingsError):
            frame_times(*wrong)
