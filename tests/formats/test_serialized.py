"""Mitsuba's serialized meshes."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from raykiln.errors import SceneError
from raykiln.formats.serialized import read_mesh, smooth

POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
NORMALS = np.tile([0.0, 0, 1], (4, 1))
UVS = POSITIONS[:, :2]
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.uint32)


def one_mesh(version: int = 4, flags: int = 0x1003, scale: float = 1.0, vertices: int = 4) -> bytes:
    kind = "<f8" if flags & 0x2000 else "<f4"
    data = struct.pack("<I", flags) + (b"a mesh\0" if version == 4 else b"")
    data += struct.pack("<QQ", vertices, len(FACES)) + (POSITIONS * scale).astype(kind).tobytes()
    if flags & 1:
        data += NORMALS.astype(kind).tobytes()
    if flags & 2:
        data += UVS.astype(kind).tobytes()
    if flags & 8:
        data += NORMALS.astype(kind).tobytes()
    return struct.pack("<HH", 0x041C, version) + zlib.compress(data + FACES.tobytes())


def file_of(*meshes: bytes, version: int = 4) -> bytes:
    offsets = np.cumsum([0, *(len(m) for m in meshes)])[:-1]
    code = "<u8" if version == 4 else "<u4"
    return b"".join(meshes) + offsets.astype(code).tobytes() + struct.pack("<I", len(meshes))


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("precision", [0x1000, 0x2000])
@pytest.mark.parametrize("parts", [0, 1, 2, 3, 0xB])
def test_all_parts_in_both_precisions(
    tmp_path: Path, version: int, precision: int, parts: int
) -> None:
    path = tmp_path / "a.serialized"
    meshes = [one_mesh(version, precision | parts, scale) for scale in (1.0, 2.0, 3.0)]
    path.write_bytes(file_of(*meshes, version=version))
    for i in range(3):
        mesh = read_mesh(path, i)
        assert_allclose(mesh.vertices, POSITIONS * (i + 1))
        assert mesh.vertices.dtype == np.float32
        assert np.array_equal(mesh.faces, FACES)
        assert (mesh.normals is not None) == bool(parts & 1)
        assert (mesh.uvs is not None) == bool(parts & 2)
        assert bool(mesh.warnings) == bool(parts & 8)
        assert mesh.name == ("a mesh" if version == 4 else None)


def test_face_normals_drop_the_given_ones(tmp_path: Path) -> None:
    path = tmp_path / "a.serialized"
    path.write_bytes(file_of(one_mesh(flags=0x1011), one_mesh(flags=0x1000)))
    assert read_mesh(path, 0).normals is None
    assert not smooth(path, 0)
    assert smooth(path, 1)


def test_the_meshes_of_a_public_scene_agree_with_mitsuba(mitsuba: Any, shared_assets: Path) -> None:
    path = shared_assets / "lajolla" / "scenes" / "matpreview" / "matpreview.serialized"
    for i in range(3):
        made = mitsuba.load_dict({"type": "serialized", "filename": str(path), "shape_index": i})
        made = mitsuba.traverse(made)
        mesh = read_mesh(path, i)
        assert_allclose(mesh.vertices.ravel(), np.array(made["vertex_positions"]), atol=1e-6)
        assert np.array_equal(mesh.faces.ravel(), np.array(made["faces"]))
        if mesh.uvs is not None:
            assert_allclose(mesh.uvs.ravel(), np.array(made["vertex_texcoords"]), atol=1e-6)


@pytest.mark.parametrize(
    ("data", "index", "message"),
    [
        (b"", 0, "too short"),
        (b"PK\3\4", 0, "not a serialized mesh"),
        (struct.pack("<HH", 0x041C, 9), 0, "of version 3 or 4"),
        (one_mesh()[:40], 0, "ends too early"),
        (struct.pack("<HH", 0x041C, 4) + b"nothing deflated", 0, "cannot be inflated"),
        (one_mesh(vertices=1 << 31), 0, "claims too much|ends too early"),
        (one_mesh(vertices=1 << 60), 0, "out of range"),
        (file_of(one_mesh()), 1, "no such shape index"),
        (one_mesh() + b"\0\0\0\0\xff\xff\xff\xff\2\0\0\0", 1, "directory is damaged"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, data: bytes, index: int, message: str) -> None:
    path = tmp_path / "bad.serialized"
    path.write_bytes(data)
    with pytest.raises(SceneError, match=message):
        read_mesh(path, index)
