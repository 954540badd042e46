"""Damaged files of every format give a scene or a `SceneError`, and nothing else."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import TRIANGLE, Gltf
from hypothesis import given, settings
from hypothesis import strategies as st
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.scene import Conductor, ImageTexture, PointLight, Scene, TextureRef
from test_gltf_materials import PIXELS, UV, png
from test_ply import ASCII as ASCII_PLY
from test_ply import GOOD as BINARY_PLY
from test_serialized import file_of, one_mesh
from test_stl import ASCII as ASCII_STL
from test_stl import binary_stl

# Cuts of a file: (place, length, replacement), places and lengths taken modulo the file's size.
EDITS = st.lists(
    st.tuples(st.integers(0, 1 << 20), st.integers(0, 8), st.binary(max_size=8)),
    min_size=1,
    max_size=6,
)
ODD_VALUES: list[Any] = [
    None, True, -1, 0, 1, 7, 2**31, 2**64, 10**400, 0.5, -0.0, 1e308, 5e-324, "", "x", "0", [], {},
    [[]], [0, 0, 0], [None], {"x": 1}, "data:,", "data:;base64,AAAA", "../up", "\0", [1e308] * 16,
]  # fmt: skip


def gltf_document() -> Gltf:
    gltf = Gltf()
    joints = gltf.accessor(np.zeros((3, 4), np.uint8))
    weights = gltf.accessor(np.eye(3, 4, dtype=np.float32))
    attributes = {"NORMAL": gltf.accessor(np.array([[0, 0, 1]] * 3, np.float32)),
                  "TEXCOORD_0": gltf.accessor(UV), "JOINTS_0": joints, "WEIGHTS_0": weights,
                  "COLOR_0": gltf.accessor(np.ones((3, 4), np.float32))}  # fmt: skip
    target = {"POSITION": gltf.accessor(TRIANGLE)}
    mesh = gltf.mesh(TRIANGLE, [0, 1, 2], attributes=attributes, material=0, targets=[target])
    gltf.json["meshes"][mesh]["weights"] = [0.5]
    sparse = {"count": 1, "indices": {"bufferView": gltf.view(b"\1\0\0\0"), "componentType": 5121},
              "values": {"bufferView": gltf.view(TRIANGLE[:1].tobytes())}}  # fmt: skip
    gltf.json["accessors"][0]["sparse"] = sparse
    gltf.node(mesh=mesh, skin=0, children=[1])
    gltf.node(root=False, camera=0, rotation=[0, 0, 0, 1], scale=[1, 1, 1], translation=[0, 0, 9])
    gltf.node(mesh=mesh, matrix=np.eye(4).ravel().tolist(),
              extensions={"KHR_lights_punctual": {"light": 0}})  # fmt: skip
    matrices = gltf.accessor(np.eye(4, dtype=np.float32).reshape(1, 16))
    gltf.append("skins", {"joints": [1], "inverseBindMatrices": matrices})
    gltf.append("cameras", {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}})
    turn = {"KHR_texture_transform": {"offset": [0, 1], "rotation": 1, "scale": [2, 2]}}
    gltf.append("materials", {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": turn},
                                 "baseColorFactor": [1, 1, 1, 0.5], "metallicFactor": 0.5},
        "normalTexture": {"index": 0, "scale": 0.5}, "alphaMode": "MASK", "alphaCutoff": 0.5,
        "emissiveFactor": [1, 1, 1], "doubleSided": True,
        "extensions": {"KHR_materials_ior": {"ior": 1.4},
                       "KHR_materials_emissive_strength": {"emissiveStrength": 2}},
    })  # fmt: skip
    gltf.append("samplers", {"wrapS": 10497, "magFilter": 9728})
    gltf.append("textures", {"source": 0, "sampler": 0})
    gltf.append("images", {"bufferView": gltf.view(png(PIXELS)), "mimeType": "image/png"})
    spot = {"type": "spot", "color": [1, 1, 1], "intensity": 2, "spot": {"outerConeAngle": 0.5}}
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": [spot]}}
    gltf.json["extensionsUsed"] = ["KHR_lights_punctual"]
    return gltf


def native_scene() -> Scene:
    scene = Scene(name="fuzz", settings={"spp": 4})
    scene.add_texture("t", ImageTexture(pixels=np.ones((2, 2, 3), np.float32)))
    scene.add_material("m", Conductor(metal="Au", alpha=TextureRef(texture="t", channel="r")))
    scene.add_mesh(TRIANGLE, [[0, 1, 2]], None, UV, "m", emission=(1, 2, 3))
    scene.add_sphere((0, 0, 1), 1, group="g")
    scene.add_instances("g", [np.eye(4)])
    scene.add_light(PointLight(position=(0, 0, 0), intensity=1))
    scene.set_camera(origin=(0, 0, 5), target=(0, 0, 0))
    return scene


XML = b"""<scene version="0.6.0"><default name="n" value="8"/>
<integrator type="path"><integer name="maxDepth" value="$n"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="toWorld">
<lookAt origin="0,0,5" target="0,0,0" up="0,1,0"/><rotate y="1" angle="3"/><scale value="2"/>
<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/><translate x="1"/></transform>
<film type="hdrfilm"><integer name="width" value="32"/><rfilter type="box"/></film></sensor>
<bsdf type="roughconductor" id="m"><string name="material" value="Au"/>
<float name="alpha" value="0.1"/></bsdf>
<shape type="serialized"><string name="filename" value="m.serialized"/><ref id="m"/>
<integer name="shapeIndex" value="1"/></shape>
<shape type="sphere"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
<srgb name="color0" value="#123456"/><float name="uscale" value="2"/></texture></bsdf>
<emitter type="area"><spectrum name="radiance" value="400:1, 500:2, 700:3"/></emitter></shape>
<emitter type="constant"><blackbody name="radiance" temperature="5000K" scale="1e-4"/></emitter>
</scene>"""
OBJ = (
    b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n# hello\n"
    b"usemtl a\nf 1/1/1 2/2/1 3/1/1 4/2/1\ng x\nusemtl b\nf -1 -2 \\\n -3\nf 1//1 2//1 3//1\n"
)
MTL = (
    b"newmtl a\nKd 1 0 0\nKs 1 1 1\nNs 5\nd 0.5\nnewmtl b\nPr 0.5\nPm 1\nKe 1 1 1\n"
    b"map_Kd -s 1 2 3 m.mtl\nillum 2\n"
)
FILES = {
    "a.ply": BINARY_PLY, "b.ply": ASCII_PLY.encode(), "a.stl": binary_stl(),
    "b.stl": ASCII_STL.encode(), "a.obj": OBJ, "a.xml": XML, "a.glb": gltf_document().glb(),
    "a.json": native_scene().to_json().encode(),
}  # fmt: skip
SIDE_FILES = {"m.mtl": MTL, "m.serialized": file_of(one_mesh(), one_mesh(flags=0x200B))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all files, whole."""
    folder = tmp_path_factory.mktemp("fuzz")
    for name, data in {**FILES, **SIDE_FILES}.items():
        (folder / name).write_bytes(data)
    return folder


def edited(data: bytes, edits: list[tuple[int, int, bytes]]) -> bytes:
    for place, length, replacement in edits:
        at = place % (len(data) + 1)
        data = data[:at] + replacement + data[at + length :]
    return data


def load_or_refuse(path: Path) -> bool:
    """Whether the file was loaded; anything but a `SceneError` is passed on."""
    try:
        load(path)
    except SceneError as caught:
        error = caught
    else:
        return True
    assert str(error).startswith(str(path.parent)), "the error names the file"
    return False


@pytest.mark.parametrize("name", sorted(FILES))
def test_the_seeds_are_good(folder: Path, name: str) -> None:
    assert load(folder / name).shapes


@pytest.mark.parametrize("name", sorted(FILES))
@settings(max_examples=150)
@given(edits=EDITS)
def test_edited_files(folder: Path, name: str, edits: list[tuple[int, int, bytes]]) -> None:
    path = folder / f"edited_{name}"
    path.write_bytes(edited(FILES[name], edits))
    load_or_refuse(path)


@pytest.mark.parametrize(("name", "user"), [("m.mtl", "a.obj"), ("m.serialized", "a.xml")])
@settings(max_examples=150)
@given(edits=EDITS)
def test_edited_side_files(
    folder: Path, name: str, user: str, edits: list[tuple[int, int, bytes]]
) -> None:
    (folder / name).write_bytes(edited(SIDE_FILES[name], edits))
    try:
        load_or_refuse(folder / user)
    finally:
        (folder / name).write_bytes(SIDE_FILES[name])


@pytest.mark.parametrize("name", sorted(FILES))
def test_every_beginning_of_a_file(folder: Path, name: str) -> None:
    data = FILES[name]
    path = folder / f"cut_{name}"
    loaded = 0
    for size in range(0, len(data), max(1, len(data) // 200)):
        path.write_bytes(data[:size])
        loaded += load_or_refuse(path)
    # Only the text formats without an end can be whole before it.
    assert loaded == 0 or name in ("a.obj", "b.stl", "b.ply", "a.ply")


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths to all parts of a JSON value."""
    found = [path]
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(
        value, list) else ()  # fmt: skip
    for key, part in items:
        found += places(part, (*path, key))
    return found


def replaced(document: Any, path: tuple[Any, ...], value: Any, *, remove: bool) -> Any:
    document = copy.deepcopy(document)
    target = document
    for key in path[:-1]:
        target = target[key]
    if remove:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return document


DOCUMENTS = {
    "a.gltf": gltf_document().document(),
    "a.json": json.loads(native_scene().to_json()),
}


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_every_value_replaced_by_odd_ones(folder: Path, name: str) -> None:
    document = DOCUMENTS[name]
    path = folder / f"odd_{name}"
    random = np.random.default_rng(7)
    refused = 0
    for place in places(document)[1:]:
        for value in [ODD_VALUES[i] for i in random.integers(0, len(ODD_VALUES), 3)]:
            path.write_text(json.dumps(replaced(document, place, value, remove=False)))
            refused += not load_or_refuse(path)
        path.write_text(json.dumps(replaced(document, place, None, remove=True)))
        load_or_refuse(path)
    assert refused > 100
