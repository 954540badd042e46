"""`raykiln.formats.load`: which reader, which folder, which errors."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from raykiln.errors import SceneError
from raykiln.formats import PLANNED, READERS, load, reader_of, side_files
from raykiln.formats.files import Files, read_bytes

TRIANGLE_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_every_extension_has_a_reader_whatever_its_case() -> None:
    for extension in READERS:
        assert reader_of(Path(f"scene{extension.upper()}")) is reader_of(Path(f"scene{extension}"))


@pytest.mark.parametrize("extension", PLANNED)
def test_planned_formats_say_that_they_come_later(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"scene{extension}"
    path.touch()
    with pytest.raises(SceneError, match="not yet supported") as caught:
        load(path)
    assert caught.value.accepted is not None
    assert ".glb" in caught.value.accepted


@pytest.mark.parametrize("name", ["scene.blend", "scene", "scene.obj.gz"])
def test_unknown_formats_list_the_known_ones(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(SceneError, match="not a known scene format"):
        load(tmp_path / name)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="does not exist") as caught:
        load(tmp_path / "nothing.obj")
    assert caught.value.file == str(tmp_path / "nothing.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(SceneError, match="a folder"):
        load(tmp_path / "folder.obj")


@pytest.mark.parametrize("extension", sorted(READERS))
@pytest.mark.parametrize("content", [b"", b"\0" * 64, b"\xff\xfe hello", b"[" * 100_000, b"{}"])
def test_wrong_content_is_a_scene_error_or_a_scene(
    tmp_path: Path, extension: str, content: bytes
) -> None:
    path = tmp_path / f"scene{extension}"
    path.write_bytes(content)
    try:
        scene = load(path)
    except SceneError as caught:
        error: SceneError | None = caught
    else:
        error = None
        assert scene.shapes == []
    assert error is None or error.file == str(path)


@pytest.mark.parametrize(
    "name",
    ["../out.mtl", "/etc/hostname", "sub/../../out.mtl", "file:///etc/hostname", "C:\\out.mtl",
     "http://127.0.0.1/x.mtl", "..\\out.mtl"],
)  # fmt: skip
def test_a_path_out_of_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "out.mtl").write_text("newmtl a\n")
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "scene.obj").write_text(f"mtllib {name}\n" + TRIANGLE_OBJ)
    with pytest.raises(SceneError) as caught:
        load(inner / "scene.obj")
    assert caught.value.accepted == "a relative path inside the scene's folder"
    assert caught.value.found == name


def test_a_symlink_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "secret.mtl").write_text("newmtl a\n")
    inner = tmp_path / "inner"
    inner.mkdir()
    os.symlink(tmp_path / "secret.mtl", inner / "link.mtl")
    (inner / "scene.obj").write_text("mtllib link.mtl\n" + TRIANGLE_OBJ)
    with pytest.raises(SceneError, match="leads out"):
        load(inner / "scene.obj")


def test_a_wider_base_folder_lets_a_scene_read_beside_its_own(tmp_path: Path) -> None:
    (tmp_path / "out.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "inner").mkdir()
    path = tmp_path / "inner" / "scene.obj"
    path.write_text("mtllib ../out.mtl\nusemtl red\n" + TRIANGLE_OBJ)
    scene = load(path, base_dir=tmp_path)
    assert scene.materials["red"].model_dump()["reflectance"] == (1, 0, 0)
    assert scene.base_dir == tmp_path.resolve()
    assert side_files(path, base_dir=tmp_path) == {(tmp_path / "out.mtl").resolve()}
    with pytest.raises(SceneError, match="outside the base folder"):
        load(path, base_dir=tmp_path / "elsewhere")


def test_files_over_a_limit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(b"x" * 11)
    assert read_bytes(path, limit=11) == b"x" * 11
    with pytest.raises(SceneError, match="the limit is 10"):
        read_bytes(path, limit=10)


def test_a_folder_or_a_device_is_no_file_of_a_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.obj").touch()
    (tmp_path / "sub").mkdir()
    os.mkfifo(tmp_path / "pipe")
    files = Files(tmp_path / "scene.obj")
    for name in ("sub", "pipe", ".", ""):
        with pytest.raises(SceneError):
            files.resolve(name)
    assert files.used == set()
