"""What glTF files bring for raykiln in their extras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import TRIANGLE, Gltf
from raykiln.errors import SceneError
from raykiln.formats import load, side_files
from raykiln.image import write_exr
from raykiln.scene import EnvironmentLight


def write(folder: Path, extras: Any) -> Path:
    """A file of one triangle whose scene has the given extras."""
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(TRIANGLE))
    gltf.json["scenes"][0]["extras"] = extras
    return gltf.save_gltf(folder / "scene.gltf")


def test_settings_and_words(tmp_path: Path) -> None:
    own = {"name": "A triangle", "description": "Only one.", "settings": {"spp": 3}}
    scene = load(write(tmp_path, {"raykiln": own}))
    assert (scene.name, scene.description) == ("A triangle", "Only one.")
    assert scene.settings == {"spp": 3}


def test_an_environment_from_a_file(tmp_path: Path) -> None:
    write_exr(tmp_path / "sky.exr", {"beauty": np.ones((2, 4, 3), np.float32)})
    light = {"type": "environment", "file": "sky.exr", "scale": 2}
    path = write(tmp_path, {"raykiln": {"lights": [light]}})
    scene = load(path)
    assert scene.lights == [EnvironmentLight(file="sky.exr", scale=2.0)]
    assert not any("light" in warning for warning in scene.warnings)
    assert side_files(path) == {tmp_path.resolve() / "sky.exr"}


@pytest.mark.parametrize("extras", [None, 3, "raykiln", ["raykiln"], {"other": {"lights": 1}}])
def test_extras_of_others_are_left_alone(tmp_path: Path, extras: Any) -> None:
    scene = load(write(tmp_path, extras))
    assert scene.settings == {}


@pytest.mark.parametrize(
    ("own", "pointer"),
    [
        (3, ""),
        ({"cameras": []}, ""),
        ({"settings": 3}, "/settings"),
        ({"lights": [{"type": "point", "position": [0, 0], "intensity": 1}]}, "/lights/0/position"),
        ({"lights": [{"type": "environment", "file": "none.exr"}]}, "/lights/0/file"),
        ({"lights": [{"type": "environment", "file": "../sky.exr"}]}, "/lights/0/file"),
    ],
)
def test_faults_are_pointed_at(tmp_path: Path, own: Any, pointer: str) -> None:
    with pytest.raises(SceneError) as caught:
        load(write(tmp_path, {"raykiln": own}))
    assert str(caught.value.pointer).startswith(f"/scenes/0/extras/raykiln{pointer}")
