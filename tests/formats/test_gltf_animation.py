"""Animated glTF files: every node where it is at a moment."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import TRIANGLE, Gltf
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.scene import Mesh, Scene


def animated(
    path: str,
    times: list[float],
    values: Any,
    *,
    interpolation: str | None = None,
    node: dict[str, Any] | None = None,
) -> Gltf:
    """A triangle with one property of its node animated."""
    gltf = Gltf()
    number = gltf.node(mesh=gltf.mesh(TRIANGLE), **(node or {}))
    add_channel(gltf, number, path, times, values, interpolation)
    return gltf


def add_channel(
    gltf: Gltf, node: int, path: str, times: list[float], values: Any, interpolation: str | None
) -> None:
    sampler: dict[str, Any] = {
        "input": gltf.accessor(np.array(times, np.float32)),
        "output": gltf.accessor(np.array(values, np.float32)),
    }
    if interpolation is not None:
        sampler["interpolation"] = interpolation
    channel = {"sampler": 0, "target": {"node": node, "path": path}}
    gltf.append("animations", {"samplers": [sampler], "channels": [channel]})


def mesh_of(scene: Scene) -> Mesh:
    mesh = scene.shapes[0]
    assert isinstance(mesh, Mesh)
    return mesh


def vertices_of(scene: Scene) -> Any:
    return np.asarray(mesh_of(scene).vertices)


def matrix_at(gltf: Gltf, folder: Path, time_s: float | None) -> Any:
    scene = load(gltf.save_gltf(folder / "animated.gltf"), time_s=time_s)
    transform = mesh_of(scene).transform
    return np.eye(4) if transform is None else np.array(transform)


@pytest.mark.parametrize(
    ("time_s", "x"), [(-1, 2.0), (1, 2.0), (1.5, 3.0), (2, 4.0), (3, 2.0), (4, 0.0), (9, 0.0)]
)
def test_linear_translation_stands_still_outside_its_keys(
    tmp_path: Path, time_s: float, x: float
) -> None:
    gltf = animated("translation", [1, 2, 4], [[2, 0, 0], [4, 0, 0], [0, 0, 0]])
    assert matrix_at(gltf, tmp_path, time_s)[:3, 3] == pytest.approx([x, 0, 0])


@pytest.mark.parametrize(("time_s", "x"), [(0, 1.0), (0.99, 1.0), (1, 5.0), (1.5, 5.0)])
def test_steps_jump_at_their_keys(tmp_path: Path, time_s: float, x: float) -> None:
    gltf = animated("translation", [0, 1], [[1, 0, 0], [5, 0, 0]], interpolation="STEP")
    assert matrix_at(gltf, tmp_path, time_s)[0, 3] == x


def test_rotation_takes_the_shorter_way_at_an_even_pace(tmp_path: Path) -> None:
    half = math.radians(60)
    # -q is the rotation of q: the naive way between would go the long way round.
    values = [[0, 0, 0, 1], [0, -math.sin(half), 0, -math.cos(half)]]
    gltf = animated("rotation", [0, 1], values)
    for share in (0.25, 0.5, 0.75):
        angle = math.radians(120 * share)
        turned = matrix_at(gltf, tmp_path, share)
        assert turned[:3, :3] @ [0, 0, 1] == pytest.approx(
            [math.sin(angle), 0, math.cos(angle)], abs=1e-6
        )


def test_cubic_splines_follow_their_tangents(tmp_path: Path) -> None:
    keys = [[[0, 0, 0], [1, 0, 0], [3, 0, 0]], [[0, 0, 0], [5, 0, 0], [0, 0, 0]]]
    values = np.array(keys).reshape(6, 3)
    gltf = animated("translation", [0, 2], values, interpolation="CUBICSPLINE")
    # p0 + the tangent's part, worked out by hand for t = 1/2 and a span of 2 s.
    expected = 0.5 * 1 + 2 * 0.125 * 3 + 0.5 * 5
    assert matrix_at(gltf, tmp_path, 1.0)[0, 3] == pytest.approx(expected)
    assert matrix_at(gltf, tmp_path, 0.0)[0, 3] == 1
    assert matrix_at(gltf, tmp_path, 2.0)[0, 3] == 5


def test_scale_and_what_hangs_below(tmp_path: Path) -> None:
    gltf = Gltf()
    child = gltf.node(root=False, mesh=gltf.mesh(TRIANGLE), translation=[1, 0, 0])
    parent = gltf.node(children=[child])
    add_channel(gltf, parent, "scale", [0, 1], [[1, 1, 1], [3, 3, 3]], None)
    assert matrix_at(gltf, tmp_path, 0.5) == pytest.approx(
        np.array([[2, 0, 0, 2], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])
    )


def test_cameras_move_too(tmp_path: Path) -> None:
    gltf = animated("translation", [0, 1], [[0, 0, 0], [0, 0, 0]])
    lens = {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}
    number = gltf.node(camera=gltf.append("cameras", lens))
    add_channel(gltf, number, "translation", [0, 1], [[0, 0, 5], [0, 0, 7]], None)
    scene = load(gltf.save_glb(tmp_path / "camera.glb"), time_s=0.5)
    assert np.array(scene.cameras[0].transform)[2, 3] == pytest.approx(6)


def test_morph_weights(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    target = gltf.accessor(np.array([[0, 0, 8]] * 3, np.float32))
    gltf.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": target}]
    add_channel(gltf, gltf.node(mesh=mesh), "weights", [0, 1], [0.0, 1.0], None)
    scene = load(gltf.save_gltf(tmp_path / "morph.gltf"), time_s=0.25)
    assert vertices_of(scene)[:, 2] == pytest.approx(2)


def test_at_rest_nothing_is_played_but_the_range_is_known(tmp_path: Path) -> None:
    gltf = animated("translation", [0.5, 2], [[1, 0, 0], [5, 0, 0]])
    scene: Scene = load(gltf.save_gltf(tmp_path / "rest.gltf"))
    assert mesh_of(scene).transform is None
    assert scene.time_range_s == (0.5, 2.0)
    assert any("at rest" in text for text in scene.warnings)
    assert not load(tmp_path / "rest.gltf", time_s=1).warnings[0].startswith("animations")


def test_the_first_animation_of_a_property_counts(tmp_path: Path) -> None:
    gltf = animated("translation", [0, 1], [[1, 0, 0], [1, 0, 0]])
    add_channel(gltf, 0, "translation", [0, 1], [[9, 0, 0], [9, 0, 0]], None)
    add_channel(gltf, 0, "scale", [0, 1], [[2, 2, 2], [2, 2, 2]], None)
    matrix = matrix_at(gltf, tmp_path, 0.5)
    assert (matrix[0, 3], matrix[0, 0]) == (1, 2)
    scene = load(tmp_path / "animated.gltf", time_s=0.5)
    assert any("several animations" in text for text in scene.warnings)


@pytest.mark.parametrize(
    ("path", "times", "values", "options", "what"),
    [
        ("translation", [1, 1], [[0, 0, 0]] * 2, {}, "must rise"),
        ("translation", [0, 1], [[0, 0, 0]] * 3, {}, "do not match"),
        ("rotation", [0, 1], [[0, 0, 0]] * 2, {}, "do not match"),
        ("translation", [0, 1], [[0, 0, 0]] * 2, {"interpolation": "CUBICSPLINE"}, "do not match"),
        ("translation", [0, 1], [[0, 0, 0]] * 2, {"interpolation": "WOBBLY"}, "interpolation"),
        ("translation", [0, math.nan], [[0, 0, 0]] * 2, {}, "must rise"),
        (
            "translation",
            [0, 1],
            [[0, 0, 0]] * 2,
            {"node": {"matrix": np.eye(4).ravel().tolist()}},
            "must not have a matrix",
        ),
    ],
)
def test_broken_animations_are_refused(
    tmp_path: Path, path: str, times: list[float], values: Any, options: Any, what: str
) -> None:
    file = animated(path, times, values, **options).save_gltf(tmp_path / "broken.gltf")
    for time_s in (None, 0.5):
        with pytest.raises(SceneError, match=what) as caught:
            load(file, time_s=time_s)
        assert str(caught.value.pointer).startswith("/animations/0/")


@pytest.mark.parametrize("time_s", [0.0, math.nan])
def test_a_scene_without_animation_is_at_no_time(tmp_path: Path, time_s: float) -> None:
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(TRIANGLE))
    with pytest.raises(SceneError, match=r"no animation|not a time"):
        load(gltf.save_gltf(tmp_path / "still.gltf"), time_s=time_s)


def test_khronos_animated_morph_cube(shared_assets: Path) -> None:
    folder = shared_assets / "gltf" / "draco" / "KhronosSampleModels" / "AnimatedMorphCube"
    file = folder / "glTF" / "AnimatedMorphCube.gltf"
    if not file.is_file():
        pytest.skip("the shared assets have no AnimatedMorphCube")
    still = load(file)
    assert still.time_range_s is not None
    begin, end = still.time_range_s
    moved = load(file, time_s=(begin + end) / 2)
    assert not np.allclose(vertices_of(still), vertices_of(moved))
