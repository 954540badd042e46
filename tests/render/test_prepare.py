"""Scenes that are built once and rendered often: the same bits, none of the waiting."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .bit_scene import bit_scene

SMALL: dict[str, Any] = {"width": 24, "height": 16, "spp": 4}


def lit_from_nowhere() -> rk.Scene:
    """A ball without a light of its own: it gets a studio light beside its camera."""
    scene = rk.Scene()
    scene.add_sphere()
    scene.set_camera(origin=(0, 0, 4), target=(0, 0, 0))
    return scene


def side_camera() -> rk.PerspectiveCamera:
    look_at = rk.LookAt(origin=(3, 2, 1), target=(0, 0.5, 0))
    return rk.PerspectiveCamera(name="side", look_at=look_at)


def same(one: rk.RenderResult, other: rk.RenderResult) -> bool:
    return (
        one.image.tobytes() == other.image.tobytes()
        and one.scene_sha256 == other.scene_sha256
        and one.warnings == other.warnings
    )


@pytest.mark.parametrize("make", [bit_scene, lit_from_nowhere])
def test_every_render_has_the_bits_of_a_cold_one(make: Any) -> None:
    prepared = rk.prepare(make())
    wide, tall = rk.RenderSettings(**SMALL), rk.RenderSettings(width=9, height=20, spp=2, seed=5)
    for settings in (wide, tall, wide):
        assert same(rk.render(prepared, settings), rk.render(make(), settings))


@pytest.mark.parametrize("make", [bit_scene, lit_from_nowhere])
def test_another_camera_is_that_of_the_scene(make: Any) -> None:
    prepared = rk.prepare(make())
    settings = rk.RenderSettings(**SMALL)
    moved = make()
    moved.set_camera(side_camera())
    result = rk.render(prepared.with_camera(side_camera()), settings)
    assert same(result, rk.render(moved, settings))
    assert not same(result, rk.render(prepared, settings))
    assert same(rk.render(prepared, settings), rk.render(make(), settings))


def test_the_statistics_tell_what_was_not_done_again() -> None:
    prepared = rk.prepare(bit_scene())
    assert prepared.load_s > 0
    assert prepared.bvh_s > 0
    assert prepared.memory_bytes > 0
    warm = rk.render(prepared, rk.RenderSettings(**SMALL)).stats
    assert (warm.warm, warm.load_s, warm.bvh_s) == (True, 0.0, 0.0)
    assert warm.scene_sha256 == prepared.sha256
    cold = rk.render(bit_scene(), rk.RenderSettings(**SMALL)).stats
    assert not cold.warm
    assert cold.bvh_s > 0


def test_settings_of_the_scene_apply() -> None:
    scene = bit_scene()
    scene.settings = SMALL
    prepared = rk.prepare(scene)
    scene.settings["width"] = 99
    assert rk.render(prepared).image.shape == (16, 24, 3)


def test_a_bad_scene_is_refused_at_once() -> None:
    with pytest.raises(rk.SceneError, match="empty"):
        rk.prepare(rk.Scene())
    with pytest.raises(rk.SettingsError, match="no camera is named 'x'"):
        rk.render(rk.prepare(bit_scene()), rk.RenderSettings(camera="x"))


def test_stopping_while_denoising_leaves_the_image_noisy(monkeypatch: pytest.MonkeyPatch) -> None:
    started, leave = threading.Event(), threading.Event()

    def slow(image: Any, albedo: Any, normal: Any) -> Any:
        started.set()
        leave.wait(30)
        return np.zeros_like(image)

    monkeypatch.setattr("raykiln.denoise.require", lambda: None)
    monkeypatch.setattr("raykiln.denoise.denoise", slow)
    settings = rk.RenderSettings(**SMALL, denoise=True)
    try:
        result = rk.render(bit_scene(), settings, lambda _: not started.is_set())
    finally:
        leave.set()
    plain = rk.render(bit_scene(), rk.RenderSettings(**SMALL))
    assert not result.complete
    assert result.image.tobytes() == plain.image.tobytes()
    assert result.aovs == {}
