"""OBJ meshes and MTL materials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from format_support import LoadText
from hypothesis import given
from hypothesis import strategies as st
from raykiln.errors import SceneError
from raykiln.formats import obj
from raykiln.scene import (
    Dielectric,
    Diffuse,
    ImageTexture,
    Mesh,
    Principled,
    Scene,
    TextureRef,
)

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"


def meshes(scene: Scene) -> list[Mesh]:
    return [shape for shape in scene.shapes if isinstance(shape, Mesh)]


def corners(mesh: Mesh) -> list[list[list[float]]]:
    assert mesh.vertices is not None
    assert mesh.faces is not None
    result: list[list[list[float]]] = mesh.vertices[mesh.faces].tolist()
    return result


@pytest.mark.parametrize(
    "face",
    ["f 1 2 3", "f 1/1 2/2 3/3", "f 1//1 2//1 3//1", "f 1/1/1 2/2/1 3/3/1", "f -4 -3 -2",
     "f -4/-4/-1 -3/-3/-1 -2/-2/-1", "  f  1/1  2/2\t3/3  # a comment", "f 1 2 \\\n 3",
     "f 1/ 2/ 3/", "f +1 +2 +3"],
)  # fmt: skip
def test_all_ways_to_write_a_face(load_text: LoadText, face: str) -> None:
    (mesh,) = meshes(load_text("a.obj", SQUARE + face + "\n"))
    assert corners(mesh) == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]
    assert (mesh.uvs is not None) == (
        face.count("/") >= 3 and "//" not in face and "/ " not in face
    )
    assert (mesh.normals is not None) == ("//" in face or face.count("/") == 6)


def test_v_is_turned_over(load_text: LoadText) -> None:
    (mesh,) = meshes(load_text("a.obj", SQUARE + "f 1/1 2/2 3/3\n"))
    assert mesh.uvs is not None
    assert mesh.uvs.tolist() == [[0, 1], [1, 1], [1, 0]]


def test_vertices_are_shared_where_all_of_them_is_equal(load_text: LoadText) -> None:
    text = SQUARE + "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\nf 1/2/1 3/3/1 4/4/1\n"
    (mesh,) = meshes(load_text("a.obj", text))
    assert mesh.vertices is not None
    assert len(mesh.vertices) == 5


def test_polygons_numbers_and_negative_indices_through_the_file(load_text: LoadText) -> None:
    text = "v 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\nv 5 5 5\nf -1 -2 -3\n"
    (mesh,) = meshes(load_text("a.obj", text))
    assert corners(mesh) == [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0]],
        [[0, 0, 0], [1, 1, 0], [0, 1, 0]],
        [[5, 5, 5], [0, 1, 0], [1, 1, 0]],
    ]


def test_windows_line_ends_and_a_last_line_without_one(load_text: LoadText) -> None:
    text = (SQUARE + "f 1 2 3\nf 1 3 4").replace("\n", "\r\n")
    (mesh,) = meshes(load_text("a.obj", text))
    assert len(corners(mesh)) == 2


def test_faces_with_and_without_normals_are_apart(load_text: LoadText) -> None:
    both = meshes(load_text("a.obj", SQUARE + "f 1//1 2//1 3//1\nf 1 3 4\n"))
    assert [mesh.normals is not None for mesh in both] == [False, True]


@given(st.integers(1, 200), st.integers(1, 7))
def test_pieces_do_not_change_the_mesh(faces: int, lines_a_piece: int) -> None:
    """The parser takes the text in pieces; where they end makes no difference."""
    random = np.random.default_rng(faces)
    lines = [f"v {x} {y} {z}" for x, y, z in random.integers(-9, 9, (6, 3))]
    for i in range(faces):
        if i % 5 == 0:
            lines.append(f"usemtl m{random.integers(3)}")
        if i % 3 == 0:
            lines.append("v 1 2 3")
        lines.append("f " + " ".join(str(-n) for n in random.integers(1, 6, random.integers(3, 6))))
    text = "\n".join(lines).encode() + b"\n"
    whole = obj.parse(text)
    size, obj.PIECE_BYTES = obj.PIECE_BYTES, 20 * lines_a_piece
    try:
        pieces = obj.parse(text)
    finally:
        obj.PIECE_BYTES = size
    for name in ("positions", "corners", "counts", "materials"):
        assert np.array_equal(getattr(whole, name), getattr(pieces, name))
    assert whole.names == pieces.names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SQUARE + "f 1 2 9\n", "'v' number 9 of 4"),
        (SQUARE + "f 1/9 2/1 3/1\n", "'vt' number 9 of 4"),
        (SQUARE + "f 1 2 0\n", "vertex 0"),
        (SQUARE + "f 1 2 -9\n", "counts back"),
        (SQUARE + "f 1 2\n", "line 10: a face takes at least three"),
        (SQUARE + "f 1 2 x\n", "something other"),
        (SQUARE + "f 1/1/1/1 2 3\n", "something other"),
        (SQUARE + "f 1 2 99999999999999999999\n", "out of range"),
        ("v 0 0\nf 1 1 1\n", "line 1: 'v' takes 3"),
        ("v 0 0 z\nf 1 1 1\n", "not a number"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 1e99\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ],
)
def test_bad_files_say_what_is_wrong(load_text: LoadText, text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_text("a.obj", text)


def test_groups_by_material(load_text: LoadText) -> None:
    text = SQUARE + "mtllib a.mtl\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\nusemtl red\nf 2 3 4\n"
    scene = load_text("a.obj", text, a__mtl="newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    found = {mesh.material: len(corners(mesh)) for mesh in meshes(scene)}
    assert found == {"red": 2, "blue": 1}
    red = scene.materials["red"]
    assert isinstance(red, Diffuse)
    assert red.reflectance == (1, 0, 0)


def test_unknown_lines_and_missing_materials_are_said(load_text: LoadText) -> None:
    text = SQUARE + "mtllib none.mtl\nusemtl lost\nf 1 2 3\nl 1 2\ncurv 0 1 2\no name\ns off\n"
    scene = load_text("a.obj", text)
    assert meshes(scene)[0].material is None
    for words in ("'none.mtl' does not exist", "'lost' is in no", "lines and points", "'curv'"):
        assert any(words in warning for warning in scene.warnings), words
    assert len([w for w in scene.warnings if "camera" not in w and "light" not in w]) == 4


MTL = """
newmtl glass
illum 7
Ni 1.7
newmtl shiny
Kd 0.5 0.5 0.5
Ks 1 1 1
Ns 198
newmtl pbr
Kd 0.1 0.2 0.3
Pr 0.25
Pm 1
map_Kd -s 2 2 2 images/base color.png
norm -bm 1.0 images/n.png
map_d images/mask.png
newmtl lamp
Ke 5 4 3
Tr 0.25
"""


def test_materials(tmp_path: Path, load_text: LoadText) -> None:
    (tmp_path / "images").mkdir()
    for name in ("base color.png", "n.png", "mask.png"):
        (tmp_path / "images" / name).touch()
    names = ("glass", "shiny", "pbr", "lamp")
    faces = "".join(f"usemtl {name}\nf 1 2 3\n" for name in names)
    scene = load_text("a.obj", "mtllib a.mtl\n" + SQUARE + faces, a__mtl=MTL)
    glass, shiny, pbr, lamp = (scene.materials[name] for name in names)
    assert isinstance(glass, Dielectric)
    assert glass.int_ior == 1.7
    assert isinstance(shiny, Principled)
    assert np.isclose(float(shiny.roughness), (2 / 200) ** 0.25)  # type: ignore[arg-type]
    assert isinstance(pbr, Principled)
    assert (pbr.roughness, pbr.metallic) == (0.25, 1.0)
    assert isinstance(pbr.base_color, TextureRef)
    assert pbr.base_color.factor == (0.1, 0.2, 0.3)
    image = scene.textures[pbr.base_color.texture]
    assert isinstance(image, ImageTexture)
    assert (image.file, image.color_space) == ("images/base color.png", "srgb")
    assert pbr.normal_map is not None
    normal = scene.textures[pbr.normal_map.texture]
    assert isinstance(normal, ImageTexture)
    assert normal.color_space == "linear"
    assert isinstance(pbr.opacity, TextureRef)
    assert lamp.opacity == 0.75
    (light,) = [mesh for mesh in meshes(scene) if mesh.material == "lamp"]
    assert light.emission is not None
    assert light.emission.radiance == (5, 4, 3)
    assert any("'-s' is not supported" in warning for warning in scene.warnings)


def test_a_missing_image_is_an_error_that_names_the_material(load_text: LoadText) -> None:
    with pytest.raises(SceneError, match="material 'm', map_kd: the file does not exist"):
        load_text("a.obj", "mtllib a.mtl\n" + SQUARE, a__mtl="newmtl m\nmap_Kd none.png\n")


def test_a_number_that_is_none_is_an_error_that_names_the_material(load_text: LoadText) -> None:
    with pytest.raises(SceneError, match="material 'm', ns: not a number"):
        load_text("a.obj", "mtllib a.mtl\n" + SQUARE, a__mtl="newmtl m\nKs 1 1 1\nNs hard\n")
