"""The Python way in: names, defaults, progress, stopping, saving, errors that name the place."""

from __future__ import annotations

import _thread
import json
import signal
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .bit_scene import bit_scene

LONG: dict[str, Any] = {"width": 256, "height": 256, "spp": 1 << 16}
TINY: dict[str, Any] = {"width": 24, "height": 16, "spp": 4}


def ball() -> rk.Scene:
    """A grey ball under a constant sky."""
    scene = rk.Scene()
    scene.add_sphere()
    scene.add_light(rk.ConstantLight(radiance=1.0))
    scene.set_camera(origin=(0, 0, 4), target=(0, 0, 0))
    return scene


class TestSettings:
    def test_defaults_are_those_of_the_contract(self) -> None:
        assert rk.RenderSettings().model_dump() == {
            "width": 512,
            "height": 512,
            "spp": 64,
            "max_depth": 8,
            "rr_depth": 5,
            "seed": 0,
            "integrator": "path",
            "sampler": "sobol",
            "filter": "gaussian",
            "threads": 0,
            "camera": None,
            "crop": None,
            "time_budget_s": None,
            "noise_threshold": None,
            "denoise": False,
            "aovs": (),
        }

    def test_scene_settings_apply_where_the_caller_gives_none(self) -> None:
        scene = ball()
        scene.settings = {"width": 20, "height": 10, "spp": 3, "integrator": "ao", "max_depth": 2}
        result = rk.render(scene, rk.RenderSettings(spp=5))
        assert result.image.shape == (10, 20, 3)
        assert result.settings.spp == result.stats.spp == 5
        assert result.settings.integrator == "ao"
        assert rk.render(scene).stats.spp == 3

    def test_a_default_given_by_hand_is_given(self) -> None:
        scene = ball()
        scene.settings = {"width": 20, "height": 10, "spp": 3}
        assert rk.RenderSettings(width=512).over(scene.settings).width == 512

    @pytest.mark.parametrize(
        ("values", "place"),
        [
            ({"spp": 0}, "spp"),
            ({"width": -3}, "width"),
            ({"height": 0}, "height"),
            ({"width": 100_000, "height": 100_000}, "width"),
            ({"width": 60_000, "height": 60_000}, "pixels"),
            ({"max_depth": 0}, "max_depth"),
            ({"max_depth": -2}, "max_depth"),
            ({"seed": -1}, "seed"),
            ({"integrator": "magic"}, "integrator"),
            ({"filter": "sinc"}, "filter"),
            ({"aovs": ["beauty"]}, "aovs"),
            ({"crop": (0, 0, 600, 10)}, "crop"),
            ({"crop": (5, 5, 5, 6)}, "crop"),
            ({"time_budget_s": 0}, "time_budget_s"),
            ({"noise_threshold": float("nan")}, "noise_threshold"),
            ({"colour": 1}, "colour"),
        ],
        ids=str,
    )
    def test_bad_settings_name_the_place(self, values: dict[str, Any], place: str) -> None:
        if "crop" not in values:  # measured by the size that the scene may give
            for make in (rk.RenderSettings, rk.RenderSettings.create):
                with pytest.raises(rk.SettingsError, match=place):
                    make(**values)
        scene = ball()
        scene.settings = values
        with pytest.raises(rk.SettingsError, match=place):
            rk.render(scene)


class TestScenes:
    def test_bundled_scenes_load_by_name(self) -> None:
        for name, path in rk.bundled_scenes().items():
            assert path.is_file()
            assert rk.load_scene(name).shapes

    def test_mesh_arrays_are_not_copied(self) -> None:
        scene = rk.Scene()
        vertices = np.random.default_rng(0).random((300, 3), np.float32)
        faces = np.arange(300, dtype=np.uint32).reshape(100, 3)
        normals, uvs = vertices.copy(), vertices[:, :2].copy()
        mesh = scene.add_mesh(vertices, faces, normals=normals, uvs=uvs)
        for ours, theirs in (
            (mesh.vertices, vertices),
            (mesh.faces, faces),
            (mesh.normals, normals),
            (mesh.uvs, uvs),
        ):
            assert ours is not None
            assert np.shares_memory(ours, theirs)

    def test_other_array_kinds_are_converted(self) -> None:
        scene = rk.Scene()
        points = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]
        mesh = scene.add_mesh(np.array(points, np.float64), np.array([[0, 1, 2]], np.int64))
        assert mesh.vertices is not None
        assert mesh.faces is not None
        assert mesh.vertices.dtype == np.dtype(np.float32)
        assert mesh.faces.dtype == np.dtype(np.uint32)

    def test_json_round_trip_renders_the_same_bits(self, tmp_path: Path) -> None:
        scene = bit_scene()
        path = tmp_path / "scene.json"
        path.write_text(scene.to_json())
        settings = rk.RenderSettings(**TINY)
        there, back = rk.render(scene, settings), rk.render(rk.load_scene(path), settings)
        np.testing.assert_array_equal(there.image, back.image)
        assert there.scene_sha256 == back.scene_sha256

    def test_check_reports_what_is_there(self) -> None:
        report = rk.check(bit_scene()).summary()
        assert report["spheres"] == 3
        assert report["instances"] == 3
        assert report["triangles"] == 2 + 4 * 3 or report["triangles"] == 2 + 4
        assert report["cameras"] == ["camera"]
        json.dumps(report)

    def test_the_camera_is_chosen_by_name(self) -> None:
        scene = ball()
        scene.set_camera(origin=(0, 0, -9), target=(0, 0, 0), name="far")
        settings = rk.RenderSettings(**TINY, aovs=("depth",))
        far = rk.render(scene, settings).aovs["depth"].max()
        near = rk.render(scene, settings.model_copy(update={"camera": "camera"})).aovs["depth"]
        assert far > near.max()


def broken(change: Any) -> rk.Scene:
    scene = ball()
    change(scene)
    return scene


class TestBadScenes:
    def test_nan_vertex(self) -> None:
        points = np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], np.float32)
        with pytest.raises(rk.SceneError, match="vertices row 2 is not finite"):
            rk.Scene().add_mesh(points, [[0, 1, 2]])

    def test_index_out_of_range(self) -> None:
        points = np.zeros((3, 3), np.float32)
        with pytest.raises(rk.SceneError, match="face 1 refers to vertex 7 of 3"):
            rk.Scene().add_mesh(points, [[0, 1, 2], [0, 1, 7]])

    def test_vertices_changed_behind_the_scene(self) -> None:
        scene = ball()
        points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
        scene.add_mesh(points, [[0, 1, 2]])
        points[1, 1] = np.nan
        with pytest.raises(rk.SceneError, match="/shapes/1"):
            rk.render(scene, rk.RenderSettings(**TINY))

    def test_negative_radius(self) -> None:
        with pytest.raises(rk.SceneError, match="radius"):
            rk.Scene().add_sphere(radius=-1)

    @pytest.mark.parametrize(
        ("change", "place"),
        [
            (lambda s: s.shapes.clear(), "/shapes"),
            (lambda s: s.add_sphere(material="gold"), "/shapes/1/material"),
            (lambda s: s.add_material("m", rk.Conductor(metal="Xx")), "/materials/m/metal"),
            (
                lambda s: s.add_material("m", rk.Diffuse(reflectance=rk.TextureRef(texture="t"))),
                "/materials/m/reflectance",
            ),
            (
                lambda s: s.add_texture("t", rk.ImageTexture(file="missing.png")),
                "/textures/t/file",
            ),
            (
                lambda s: s.add_texture("t", rk.ImageTexture(file="../../etc/passwd")),
                "/textures/t/file",
            ),
            (lambda s: s.add_instances("nobody", np.eye(4)[None]), "/shapes/1/group"),
            (
                lambda s: s.add_light(rk.DirectionalLight(direction=(0, 0, 0), irradiance=1.0)),
                "/lights/1/direction",
            ),
        ],
        ids=["empty", "material", "metal", "texture", "file", "outside", "group", "direction"],
    )
    def test_a_bad_scene_names_the_place(self, change: Any, place: str) -> None:
        for use in (rk.check, rk.render):
            with pytest.raises(rk.SceneError) as caught:
                use(broken(change), rk.RenderSettings(**TINY))
            assert str(caught.value).startswith(place)

    def test_unknown_camera(self) -> None:
        with pytest.raises(rk.SettingsError, match=r"camera: .*'left'; accepted: camera"):
            rk.render(ball(), rk.RenderSettings(**TINY, camera="left"))

    def test_a_missing_file(self, tmp_path: Path) -> None:
        for name in ("none.json", "none.glb", "none.xml", "none.obj", "none.ply", "none.stl"):
            with pytest.raises(rk.SceneError, match=name):
                rk.load_scene(tmp_path / name)


class TestProgress:
    def test_it_rises_to_one(self) -> None:
        seen: list[rk.Progress] = []
        settings = rk.RenderSettings(width=64, height=64, spp=64)
        result = rk.render(bit_scene(), settings, seen.append)
        assert result.complete
        fractions = [p.fraction for p in seen]
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1.0
        assert seen[-1].samples == result.stats.samples == 64**3
        assert seen[-1].spp_done == seen[-1].spp == 64
        assert all(b.elapsed_s >= a.elapsed_s for a, b in pairwise(seen))

    def test_it_comes_often_and_from_the_calling_thread(self) -> None:
        calls: list[int] = []

        def watch(progress: rk.Progress) -> bool:
            calls.append(threading.get_ident())
            return len(calls) < 10 and progress.elapsed_s < 60

        result = rk.render(bit_scene(), rk.RenderSettings(**LONG), watch)
        assert not result.complete
        assert set(calls) == {threading.get_ident()}
        assert len(calls) >= 10

    def test_the_preview_is_the_image_so_far(self) -> None:
        shapes = []

        def watch(progress: rk.Progress) -> bool:
            preview = progress.preview()
            assert preview.dtype == np.float32
            assert np.isfinite(preview).all()
            shapes.append(preview.shape)
            return progress.spp_done < 1

        rk.render(bit_scene(), rk.RenderSettings(**LONG), watch)
        assert set(shapes) == {(256, 256, 3)}

    def test_other_threads_go_on(self) -> None:
        counted = 0
        stop = threading.Event()

        def count() -> None:
            nonlocal counted
            while not stop.is_set():
                counted += 1
                time.sleep(0.001)

        other = threading.Thread(target=count)
        other.start()
        before_after: list[int] = []

        def watch(progress: rk.Progress) -> bool:
            before_after.append(counted)
            return counted - before_after[0] <= 10 and progress.elapsed_s < 60

        try:
            rk.render(bit_scene(), rk.RenderSettings(**LONG), watch)
        finally:
            stop.set()
            other.join()
        assert before_after[-1] - before_after[0] > 10

    def test_two_renders_at_once(self) -> None:
        settings = rk.RenderSettings(width=48, height=32, spp=16)
        alone = rk.render(bit_scene(), settings).image
        found: dict[int, Any] = {}

        def work(index: int) -> None:
            found[index] = rk.render(bit_scene(), settings).image

        workers = [threading.Thread(target=work, args=(i,)) for i in range(3)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        assert len(found) == 3
        for image in found.values():
            np.testing.assert_array_equal(image, alone)


class TestStopping:
    def test_false_stops(self) -> None:
        result = rk.render(bit_scene(), rk.RenderSettings(**LONG), lambda p: p.spp_done < 2)
        assert not result.complete
        assert 2 <= result.stats.spp < 100
        assert result.image.shape == (256, 256, 3)
        assert result.image.mean() > 0

    def test_none_goes_on(self) -> None:
        assert rk.render(ball(), rk.RenderSettings(**TINY), lambda _: None).complete

    def test_ctrl_c(self) -> None:
        last: list[rk.Progress] = []

        def watch(progress: rk.Progress) -> None:
            last[:] = [progress]
            if progress.spp_done == 1:
                _thread.interrupt_main(signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            rk.render(bit_scene(), rk.RenderSettings(**LONG), watch)
        assert last[0].fraction < 0.01

    def test_ctrl_c_without_on_progress(self) -> None:
        timer = threading.Timer(0.3, _thread.interrupt_main, (signal.SIGINT,))

        def interrupted() -> None:
            # However late the render begins, the interrupt arrives within this call.
            timer.start()
            rk.render(bit_scene(), rk.RenderSettings(**LONG))

        with pytest.raises(KeyboardInterrupt):
            interrupted()
        timer.join()

    def test_an_error_of_the_caller_comes_through(self) -> None:
        def fail(_: rk.Progress) -> None:
            raise LookupError("mine")

        with pytest.raises(LookupError, match="mine"):
            rk.render(bit_scene(), rk.RenderSettings(**LONG), fail)

    def test_time_budget(self) -> None:
        result = rk.render(bit_scene(), rk.RenderSettings(**LONG, time_budget_s=0.2))
        assert 1 <= result.stats.spp < LONG["spp"] // 10
        assert result.image.min() >= 0

    def test_noise_threshold(self) -> None:
        settings: dict[str, Any] = {"width": 32, "height": 32, "spp": 4096}
        loose = rk.render(bit_scene(), rk.RenderSettings(**settings, noise_threshold=0.2))
        tight = rk.render(bit_scene(), rk.RenderSettings(**settings, noise_threshold=0.1))
        assert loose.complete
        assert 16 <= loose.stats.spp < tight.stats.spp < 4096


@pytest.mark.parametrize("integrator", ["path", "whitted", "direct", "ao"])
def test_every_integrator_renders(integrator: Any) -> None:
    result = rk.render(bit_scene(), rk.RenderSettings(**TINY, integrator=integrator))
    assert result.complete
    assert result.image.mean() > 0
    assert np.isfinite(result.image).all()


def test_every_public_name_exists() -> None:
    for name in rk.__all__:
        assert getattr(rk, name) is not None
