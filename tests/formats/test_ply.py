"""PLY meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.formats.ply import ROWS_AT_ONCE, read_mesh
from raykiln.rendering import check
from raykiln.scene import Mesh

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
FORMATS = {"<": "binary_little_endian", ">": "binary_big_endian"}


def ply_bytes(
    vertices: NDArray[Any],
    faces: list[list[int]],
    order: str = "<",
    count_type: str = "uchar",
    index_type: str = "int",
) -> bytes:
    """A binary PLY file of float positions and faces of any number of corners."""
    codes = {"uchar": "u1", "int": "i4", "uint": "u4", "ushort": "u2"}
    header = (
        f"ply\nformat {FORMATS[order]} 1.0\ncomment made by a test\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\n"
        f"property list {count_type} {index_type} vertex_indices\nend_header\n"
    )
    body = vertices.astype(f"{order}f4").tobytes()
    for face in faces:
        body += np.array([len(face)], order + codes[count_type]).tobytes()
        body += np.array(face, order + codes[index_type]).tobytes()
    return header.encode() + body


def test_triangles_in_both_byte_orders(tmp_path: Path) -> None:
    for order in FORMATS:
        path = tmp_path / "a.ply"
        path.write_bytes(ply_bytes(SQUARE, [[0, 1, 2], [0, 2, 3]], order))
        mesh = read_mesh(path)
        assert np.array_equal(mesh.vertices, SQUARE)
        assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
        assert mesh.faces.dtype == np.uint32
        assert mesh.normals is None
        assert mesh.uvs is None


@given(
    st.lists(st.sampled_from([[0, 1, 2], [0, 1, 2, 3], [0, 1], [3, 2, 1]]), max_size=200),
    st.sampled_from(sorted(FORMATS)),
    st.sampled_from(["uchar", "int", "ushort"]),
)
def test_mixed_polygons_come_out_in_order(
    tmp_path_factory: pytest.TempPathFactory, faces: list[list[int]], order: str, count_type: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "mixed.ply"
    path.write_bytes(ply_bytes(SQUARE, faces, order, count_type))
    expected = []
    for face in faces:
        if len(face) >= 3:
            expected += [[face[0], face[i], face[i + 1]] for i in range(1, len(face) - 1)]
    assert read_mesh(path).faces.tolist() == expected


ASCII = """ply
format ascii 1.0
obj_info nothing
element vertex 4
property double nx
property double ny
property double nz
property float x
property float y
property float z
property float s
property float t
property uchar red
element edge 1
property int vertex1
property int vertex2
element face 2
property int flags
property list uchar uint vertex_index
property list uchar float texcoord
end_header
0 0 1  0 0 0  0 0 255
0 0 1  1 0 0  1 0 255
0 0 1  1 1 0  1 1 255
0 0 1  0 1 0  0 1 255
0 1
7 3 0 1 2 2 0.5 0.5
7 3 0 2 3 0
"""


def test_ascii_with_everything(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(ASCII)
    scene = load(path)
    (mesh,) = scene.shapes
    assert isinstance(mesh, Mesh)
    assert mesh.vertices is not None
    assert mesh.faces is not None
    assert np.array_equal(mesh.vertices, SQUARE)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.normals is not None
    assert mesh.normals.tolist() == [[0, 0, 1]] * 4
    assert mesh.uvs is not None
    assert np.array_equal(mesh.uvs, SQUARE[:, :2])
    assert any("vertex colours" in w for w in scene.warnings)
    assert any("edge" in w for w in scene.warnings)


def test_ascii_and_binary_agree(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(ASCII)
    (tmp_path / "b.ply").write_bytes(ply_bytes(SQUARE, [[0, 1, 2], [0, 2, 3]]))
    a, b = read_mesh(tmp_path / "a.ply"), read_mesh(tmp_path / "b.ply")
    assert np.array_equal(a.faces, b.faces)
    assert np.array_equal(a.vertices, b.vertices)


@pytest.mark.parametrize(("vertices", "faces", "is_view"), [(1000, 1, True), (4, 1000, False)])
def test_a_file_of_triangles_is_neither_copied_nor_kept_in_vain(
    tmp_path: Path, vertices: int, faces: int, is_view: bool
) -> None:
    """Positions are a view of what was read, unless that would keep the faces' bytes, too."""
    path = tmp_path / "a.ply"
    points = np.arange(3 * vertices, dtype=np.float32).reshape(-1, 3)
    path.write_bytes(ply_bytes(points, [[0, 1, 2]] * faces))
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, points)
    assert (mesh.vertices.base is not None) == is_view


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("length", range(1, 5))
@pytest.mark.parametrize("others", [0, 3])
def test_many_triangles_are_packed_where_they_were_read(
    tmp_path: Path, order: str, length: int, others: int
) -> None:
    """With quads behind them, which stay as they are."""
    rng = np.random.default_rng(length)
    triangles = np.zeros(2 * ROWS_AT_ONCE + 1000, [("n", "u1"), ("corners", f"{order}i4", 3)])
    triangles["n"], triangles["corners"] = 3, rng.integers(0, 50, (len(triangles), 3))
    quads = np.zeros(others, [("n", "u1"), ("corners", f"{order}i4", 4)])
    quads["n"], quads["corners"] = 4, [0, 1, 2, 3]
    points = np.zeros((50, 3), f"{order}f4")
    points[:4] = SQUARE
    header = (
        f"ply\nformat {FORMATS[order]} 1.0\ncomment {'x' * length}\nelement vertex 50\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles) + len(quads)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    path = tmp_path / "a.ply"
    numbers = points.tobytes() + triangles.tobytes() + quads.tobytes()
    path.write_bytes(header.encode() + numbers)
    mesh = read_mesh(path)
    assert np.array_equal(mesh.vertices, points)
    assert np.array_equal(mesh.faces[: len(triangles)], triangles["corners"])
    assert mesh.faces[len(triangles) :].tolist() == [[0, 1, 2], [0, 2, 3]] * others


def test_a_header_of_any_length_can_be_rendered(tmp_path: Path) -> None:
    """The ray tracer shares positions, and takes them from multiples of four bytes only."""
    path = tmp_path / "a.ply"
    for length in range(1, 5):
        comment = b"comment " + b"x" * length
        path.write_bytes(GOOD.replace(b"comment made by a test", comment))
        assert check(load(path)).triangles == 2


GOOD = ply_bytes(SQUARE, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"plx", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "no end_header"),
        (b"ply\nend_header\n", "names no format"),
        (GOOD.replace(b"vertex 4", b"vertex 1000000000000"), "out of range"),
        (GOOD.replace(b"vertex 4", b"vertex 4000000000"), "ends before"),
        (GOOD.replace(b"face 2", b"face 4000000000"), "ends before"),
        (GOOD.replace(b"vertex 4", b"vertex -4"), "out of range"),
        (GOOD.replace(b"vertex 4", b"vertex four"), "bad line"),
        (GOOD.replace(b"property float z", b"property float w"), "no x, y and z"),
        (GOOD.replace(b"property float z", b"property real z"), "bad line"),
        (GOOD.replace(b"little_endian", b"odd_endian"), "bad line"),
        (GOOD.replace(b"vertex_indices", b"corner_indices"), "no list of vertices"),
        (GOOD[:-4], "ends before"),
        (GOOD[:-4] + b"\x09\0\0\0", "vertex 9 of 4"),
        (GOOD[:-4] + b"\xff\xff\xff\xff", "vertex -1 of 4"),
        (ASCII.replace("1 1 0  1 1", "1 one 0  1 1").encode(), "a word among the numbers"),
        (ASCII.replace("3 0 2 3", "3 0 2.5 3").encode(), "by a fraction"),
        (ASCII.replace("3 0 2 3", "-3 0 2 3").encode(), "a list of -3"),
        (ASCII.replace("3 0 2 3 0", "3 0 nan 3 0").encode(), "vertex nan of 4"),
        (ASCII.replace("1 1 0  1 1", "nan 1 0  1 1").encode(), "row 2 is not finite"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    with pytest.raises(SceneError, match=message) as caught:
        load(path)
    assert caught.value.file == str(path)
