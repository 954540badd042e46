"""What is uploaded for a scene."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from raykiln.errors import SceneError
from raykiln.image import write_png
from raykiln_service.client import package

from .support import write_scene

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def write_bundle(folder: Path) -> Path:
    """A scene with a mesh and a texture beside it, and a file that it does not use."""
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes/tri.obj").write_text(OBJ)
    write_png(folder / "wood.png", np.full((2, 2, 3), 99, dtype=np.uint8))
    (folder / "secret.txt").write_text("not for upload")
    material = {"type": "diffuse", "reflectance": {"texture": "wood"}}
    return write_scene(
        folder / "scene.json",
        textures={"wood": {"type": "image", "file": "wood.png"}},
        materials={"wood": material},
        shapes=[{"type": "mesh", "file": "meshes/tri.obj", "material": "wood"}],
    )


def test_a_scene_without_side_files_goes_as_it_is(scene: Path) -> None:
    with package(scene) as packed:
        assert (packed.path, packed.entry) == (scene, "ball.json")


def test_a_bundle_holds_what_the_scene_reads_and_no_more(tmp_path: Path) -> None:
    scene = write_bundle(tmp_path / "a")
    with package(scene) as packed:
        assert packed.entry == "scene.json"
        with zipfile.ZipFile(packed.path) as bundle:
            assert bundle.namelist() == ["meshes/tri.obj", "scene.json", "wood.png"]
            assert bundle.read("wood.png") == (tmp_path / "a/wood.png").read_bytes()
        archive = packed.path
    assert not archive.exists()


def test_the_same_files_give_the_same_archive(tmp_path: Path) -> None:
    archives = []
    for name in ("a", "b"):
        with package(write_bundle(tmp_path / name)) as packed:
            archives.append(packed.path.read_bytes())
    assert archives[0] == archives[1]


def test_a_wider_folder_is_named_from_its_root(tmp_path: Path) -> None:
    scene = write_bundle(tmp_path / "a")
    with package(scene, tmp_path) as packed:
        assert packed.entry == "a/scene.json"


def test_a_missing_file_is_found_before_anything_is_sent(tmp_path: Path) -> None:
    scene = write_bundle(tmp_path / "a")
    (tmp_path / "a/wood.png").unlink()
    with pytest.raises(SceneError, match=r"wood\.png"), package(scene):
        pass
