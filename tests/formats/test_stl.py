"""STL meshes."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.formats.stl import read_mesh

TRIANGLES = np.arange(18, dtype=np.float32).reshape(2, 3, 3)


def binary_stl(title: bytes = b"made by a test") -> bytes:
    data = title.ljust(80, b" ") + struct.pack("<I", len(TRIANGLES))
    for triangle in TRIANGLES:
        data += struct.pack("<3f", 0, 0, 1) + triangle.tobytes() + b"\0\0"
    return data


ASCII = """solid thing
 facet normal 0 0 1
  outer loop
   vertex 0 1 2
   vertex 3 4 5
   vertex 6 7 8
  endloop
 endfacet
 facet normal 0 0 1
  outer loop
   vertex 9.0 1e1 11
   vertex 12 13 14
   vertex 15 16 17
  endloop
 endfacet
endsolid thing
"""


@pytest.mark.parametrize("content", [binary_stl(), binary_stl(b"solid but binary"), ASCII.encode()])
def test_both_kinds_give_the_same_triangles(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(content)
    mesh = read_mesh(path)
    assert np.array_equal(mesh.vertices[mesh.faces], TRIANGLES)
    assert len(load(path).shapes) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (binary_stl()[:-1], "ends before its 2 triangles"),
        (binary_stl()[:80] + b"\xff\xff\xff\xff", "ends before its 4294967295"),
        (b"short", "only 5 bytes"),
        (ASCII.replace("vertex 0 1 2\n", "\n").encode(), "with 5 vertices"),
        (ASCII.replace("vertex 0 1 2", "vertex 0 x 2").encode(), "not three numbers"),
        (ASCII.replace("vertex 0 1 2", "vertex 0 nan 2").encode(), "not finite"),
        (b"solid nothing\nendsolid\n", "with 0 vertices"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "bad.stl"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message):
        load(path)
