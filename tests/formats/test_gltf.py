"""glTF geometry: containers, accessors, primitives, nodes, cameras, lights."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import QUAD, TRIANGLE, Gltf, one_triangle
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.formats.gltf import _local
from raykiln.formats.json_text import Item
from raykiln.scene import (
    DirectionalLight,
    Instance,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
)


def meshes(scene: Scene) -> list[Mesh]:
    return [shape for shape in scene.shapes if isinstance(shape, Mesh)]


def world_corners(mesh: Mesh) -> Any:
    """(m, 3, 3) positions of the corners in world space."""
    assert mesh.vertices is not None
    assert mesh.faces is not None
    matrix = np.eye(4) if mesh.transform is None else np.array(mesh.transform)
    return (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])[mesh.faces]


def test_json_and_binary_files_agree(tmp_path: Path) -> None:
    gltf = one_triangle()
    a = load(gltf.save_gltf(tmp_path / "a.gltf"))
    b = load(gltf.save_glb(tmp_path / "b.glb"))
    for scene in (a, b):
        (mesh,) = meshes(scene)
        assert_allclose(world_corners(mesh), [TRIANGLE])
        assert mesh.normals is None
        assert scene.materials[mesh.material or ""].type == "principled"


def test_a_buffer_in_a_file_with_a_percent_encoded_name(tmp_path: Path) -> None:
    gltf = one_triangle()
    document = json.loads(gltf.save_gltf(tmp_path / "a.gltf").read_text())
    document["buffers"][0]["uri"] = "my%20data.bin"
    (tmp_path / "my data.bin").write_bytes(gltf.binary)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert len(meshes(load(tmp_path / "a.gltf"))) == 1


@pytest.mark.parametrize("kind", ["uint8", "uint16", "uint32"])
def test_indices_of_every_type(tmp_path: Path, kind: str) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(QUAD)
    indices = gltf.accessor(np.array([0, 1, 2, 0, 2, 3], kind))
    gltf.json["meshes"][mesh]["primitives"][0]["indices"] = indices
    gltf.node(mesh=mesh)
    (found,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert_allclose(world_corners(found), QUAD[[[0, 1, 2], [0, 2, 3]]])


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, [0, 1, 2, 3], [[0, 1, 2]]),
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (5, [0, 1], []),
    ],
)
def test_modes(tmp_path: Path, mode: int, indices: list[int], faces: list[list[int]]) -> None:
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(QUAD, indices, mode=mode))
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    found = [f for mesh in meshes(scene) for f in np.array(mesh.faces).tolist()]
    assert found == faces
    for mesh in meshes(scene):
        corner = world_corners(mesh)
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (normal[:, 2] > 0).all()


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_points_and_lines_are_left_out_with_a_word(tmp_path: Path, mode: int) -> None:
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(QUAD, mode=mode))
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    assert scene.shapes == []
    assert any("left out" in warning for warning in scene.warnings)


def test_interleaved_normalized_and_sparse_accessors(tmp_path: Path) -> None:
    gltf = Gltf()
    record = np.zeros(3, [("p", "<f4", 3), ("n", "<i1", 4), ("t", "<u2", 2)])
    record["p"] = TRIANGLE
    record["n"][:, 2] = 127
    record["t"] = [[0, 0], [65535, 0], [0, 65535]]
    view = gltf.view(record.tobytes(), byteStride=20)
    common = {"bufferView": view, "count": 3}
    position = gltf.append("accessors", {**common, "componentType": 5126, "type": "VEC3",
        "sparse": {
            "count": 1,
            "indices": {"bufferView": gltf.view(b"\2"), "componentType": 5121},
            "values": {"bufferView": gltf.view(np.array([0, 5, 0], "<f4").tobytes())},
        }})  # fmt: skip
    normal = gltf.append("accessors", {**common, "componentType": 5120, "type": "VEC3",
                                       "byteOffset": 12, "normalized": True})  # fmt: skip
    uv = gltf.append("accessors", {**common, "componentType": 5123, "type": "VEC2",
                                   "byteOffset": 16, "normalized": True})  # fmt: skip
    attributes = {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv}
    gltf.node(mesh=gltf.append("meshes", {"primitives": [{"attributes": attributes}]}))
    (mesh,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert_allclose(world_corners(mesh)[0], [[0, 0, 0], [1, 0, 0], [0, 5, 0]])
    assert_allclose(np.array(mesh.normals), [[0, 0, 1]] * 3)
    assert_allclose(np.array(mesh.uvs), [[0, 0], [1, 0], [0, 1]])


def test_quantized_positions_are_whole_numbers(tmp_path: Path) -> None:
    gltf = Gltf()
    gltf.json["extensionsRequired"] = gltf.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    mesh = gltf.mesh((TRIANGLE * 100).astype(np.int16))
    gltf.node(mesh=mesh, scale=[0.01, 0.01, 0.01])
    (found,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert_allclose(world_corners(found), [TRIANGLE], atol=1e-6)


def test_an_accessor_without_a_view_is_zero(tmp_path: Path) -> None:
    gltf = Gltf()
    accessor = gltf.append("accessors", {"componentType": 5126, "count": 3, "type": "VEC3"})
    gltf.node(mesh=gltf.append("meshes", {"primitives": [{"attributes": {"POSITION": accessor}}]}))
    (mesh,) = meshes(load(gltf.save_gltf(tmp_path / "a.gltf")))
    assert not world_corners(mesh).any()


def test_node_transforms_multiply_down_the_tree(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    half = math.sqrt(0.5)
    child = gltf.node(root=False, mesh=mesh, rotation=[0, 0, half, half], scale=[2, 2, 2])
    column_major = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1]
    gltf.node(children=[child], matrix=column_major)
    (found,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert_allclose(world_corners(found)[0], [[10, 20, 30], [10, 22, 30], [8, 20, 30]], atol=1e-6)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(map(abs, q)) > 0.1))
def test_rotations_are_rotations(q: list[float]) -> None:
    """Against the quaternion product q v q*."""
    gltf = one_triangle()
    gltf.json["nodes"][0]["rotation"] = q
    matrix = _local(Item(gltf.json["nodes"][0], ""))
    assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    v = np.array([0.3, -0.5, 0.8])
    u, w = np.array(q[:3]) / np.linalg.norm(q), q[3] / np.linalg.norm(q)
    turned = v + 2 * np.cross(u, np.cross(u, v) + w * v)
    assert_allclose(matrix[:3, :3] @ v, turned, atol=1e-12)


def test_a_mesh_shown_often_is_instanced_if_it_is_large(tmp_path: Path) -> None:
    gltf = Gltf()
    small = gltf.mesh(TRIANGLE)
    large = gltf.mesh(np.random.default_rng(1).random((300, 3), dtype=np.float32))
    for i in range(4):
        gltf.node(mesh=small, translation=[i, 0, 0])
        gltf.node(mesh=large, translation=[0, i, 0])
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    assert len(meshes(scene)) == 4
    (instance,) = [shape for shape in scene.shapes if isinstance(shape, Instance)]
    assert instance.transforms[:, 1, 3].tolist() == [0, 1, 2, 3]
    assert len(scene.groups[instance.group]) == 1


def test_only_the_default_scene_is_shown(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    first, second = gltf.node(root=False, mesh=mesh), gltf.node(root=False, translation=[5, 0, 0],
                                                                mesh=mesh)  # fmt: skip
    gltf.json["scenes"] = [{"nodes": [first]}, {"nodes": [second]}]
    gltf.json["scene"] = 1
    (found,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert world_corners(found)[0, 0].tolist() == [5, 0, 0]


def test_morph_targets_with_their_weights(tmp_path: Path) -> None:
    gltf = Gltf()
    target = gltf.accessor(np.array([[0, 0, 4]] * 3, np.float32))
    mesh = gltf.mesh(TRIANGLE, targets=[{"POSITION": target}])
    gltf.json["meshes"][mesh]["weights"] = [0.5]
    gltf.node(mesh=mesh)
    gltf.node(mesh=mesh, weights=[1])
    heights = [world_corners(m)[0, 0, 2] for m in meshes(load(gltf.save_glb(tmp_path / "a.glb")))]
    assert sorted(heights) == [2, 4]


def test_a_skin_in_its_rest_pose(tmp_path: Path) -> None:
    """Joints decide where the vertices are; the node of the mesh does not."""
    gltf = Gltf()
    joints = gltf.accessor(np.array([[0, 1, 0, 0]] * 3, np.uint8))
    weights = gltf.accessor(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]], np.float32))
    mesh = gltf.mesh(TRIANGLE, attributes={"JOINTS_0": joints, "WEIGHTS_0": weights})
    lower = gltf.node(translation=[10, 0, 0])
    upper = gltf.node(translation=[0, 20, 0])
    unbind = np.eye(4, dtype=np.float32)
    unbind[0, 3] = -10
    matrices = np.stack([unbind.T.ravel(), np.eye(4).ravel()]).astype(np.float32)
    gltf.append("skins", {"joints": [lower, upper], "inverseBindMatrices": gltf.accessor(matrices)})
    gltf.node(mesh=mesh, skin=0, translation=[99, 99, 99])
    (found,) = meshes(load(gltf.save_glb(tmp_path / "a.glb")))
    assert_allclose(world_corners(found)[0], [[0, 0, 0], [1, 20, 0], [0, 11, 0]])


def test_cameras(tmp_path: Path) -> None:
    gltf = one_triangle()
    lens = {"yfov": math.radians(50), "znear": 0.1, "aspectRatio": 1.5}
    gltf.append("cameras", {"type": "perspective", "perspective": lens, "name": "front"})
    flat = {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 1}
    gltf.append("cameras", {"type": "orthographic", "orthographic": flat})
    gltf.node(camera=0, translation=[0, 0, 7])
    gltf.node(camera=0)
    gltf.node(camera=1)
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    assert [c.name for c in scene.cameras] == ["front", "front_2"]
    assert scene.cameras[0].fov_deg == pytest.approx(50)
    assert scene.cameras[0].fov_axis == "y"
    assert np.array(scene.cameras[0].transform)[:3, 3].tolist() == [0, 0, 7]
    assert any("only perspective" in w for w in scene.warnings)
    assert not any("no camera" in w for w in scene.warnings)


def test_punctual_lights(tmp_path: Path) -> None:
    gltf = one_triangle()
    lights = [
        {"type": "directional", "intensity": 3, "color": [1, 0.5, 0]},
        {"type": "point", "intensity": 40, "range": 9},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
    ]
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    gltf.json["extensionsUsed"] = ["KHR_lights_punctual"]
    half = math.sqrt(0.5)
    for i in range(3):
        gltf.node(extensions={"KHR_lights_punctual": {"light": i}}, translation=[0, 5, 0],
                  rotation=[-half, 0, 0, half])  # fmt: skip
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    sun, bulb, spot = scene.lights
    assert isinstance(sun, DirectionalLight)
    assert_allclose(sun.direction, [0, -1, 0], atol=1e-12)
    assert sun.irradiance == (3, 1.5, 0)
    assert isinstance(bulb, PointLight)
    assert bulb.intensity == (40, 40, 40)
    assert bulb.position == (0, 5, 0)
    assert isinstance(spot, SpotLight)
    assert spot.outer_angle_deg == pytest.approx(math.degrees(0.5))
    assert_allclose(spot.direction, [0, -1, 0], atol=1e-12)
    assert any("range" in warning for warning in scene.warnings)


def _broken(change: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(json.dumps(one_triangle()._document()))
    document["buffers"][0]["uri"] = "data:;base64," + "AAAA" * 12
    where, value = change.split("=", 1)
    *path, last = where.split(".")
    target: Any = document
    for key in path:
        target = target[int(key) if key.isdigit() else key]
    target[int(last) if last.isdigit() else last] = json.loads(value)
    return document


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ('asset={}', "/asset/version"),
        ('asset={"version": "1.0"}', "/asset/version"),
        ('extensionsRequired=["KHR_draco_mesh_compression"]', "/extensionsRequired"),
        ("accessors.0.count=1000000000000", "/accessors/0"),
        ("accessors.0.count=4", "/accessors/0"),
        ("accessors.0.count=0", "/accessors/0"),
        ("accessors.0.count=-3", "/accessors/0/count"),
        ("accessors.0.byteOffset=4", "/accessors/0"),
        ("accessors.0.componentType=5124", "/accessors/0/componentType"),
        ('accessors.0.type="VEC5"', "/accessors/0/type"),
        ('accessors.0.type="VEC2"', "/meshes/0/primitives/0/attributes/POSITION"),
        ("accessors.0.bufferView=9", "/accessors/0/bufferView"),
        ("bufferViews.0.byteLength=37", "/bufferViews/0"),
        ("bufferViews.0.byteStride=2", "/bufferViews/0"),
        ("bufferViews.0.buffer=1", "/bufferViews/0/buffer"),
        ("buffers.0.byteLength=99", "/buffers/0"),
        ('buffers.0.uri="data:;base64,?"', "/buffers/0/uri"),
        ('buffers.0.uri="data:"', "/buffers/0/uri"),
        ('buffers.0.uri="none.bin"', "/buffers/0/uri"),
        ('buffers.0.uri="../secret.bin"', "/buffers/0/uri"),
        ('buffers.0.uri="%2e%2e/secret.bin"', "/buffers/0/uri"),
        ('buffers.0={"byteLength": 36}', "/buffers/0"),
        ("nodes.0.mesh=3", "/nodes/0/mesh"),
        ("nodes.0.children=[0]", "/nodes/0"),
        ("nodes.0.children=[7]", None),
        ("nodes.0.rotation=[0, 0, 0, 0]", "/nodes/0/rotation"),
        ("nodes.0.scale=[1, 2]", "/nodes/0/scale"),
        ('nodes.0.translation=["a", 0, 0]', "/nodes/0/translation"),
        ("scene=4", "/scene"),
        ("meshes.0.primitives=[]", "/meshes/0"),
        ("meshes.0.primitives.0.mode=7", "/meshes/0/primitives/0/mode"),
        ("meshes.0.primitives.0.indices=5", "/meshes/0/primitives/0/indices"),
        ("meshes.0.primitives.0.indices=0", "/meshes/0/primitives/0/indices"),
        ("meshes.0.primitives.0.material=0", "/meshes/0/primitives/0/material"),
        ("meshes=7", "/meshes"),
        ("nodes=[7]", "/nodes/0"),
    ],
)  # fmt: skip
def test_broken_files_say_where(tmp_path: Path, change: str, pointer: str | None) -> None:
    path = tmp_path / "bad.gltf"
    path.write_text(json.dumps(_broken(change)))
    with pytest.raises(SceneError) as caught:
        load(path)
    assert caught.value.file == str(path)
    assert caught.value.pointer == pointer


def test_a_position_that_is_not_a_number_is_an_error(tmp_path: Path) -> None:
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(np.full((3, 3), np.nan, np.float32)))
    with pytest.raises(SceneError, match="vertices row 0 is not finite"):
        load(gltf.save_glb(tmp_path / "a.glb"))


def test_an_index_out_of_range_is_an_error_even_in_a_mesh_that_is_not_shown(tmp_path: Path) -> None:
    for shown in (True, False):
        gltf = one_triangle()
        bad = gltf.mesh(TRIANGLE, [0, 1, 3])
        if shown:
            gltf.node(mesh=bad)
        with pytest.raises(SceneError, match="an index refers to vertex 3 of 3"):
            load(gltf.save_glb(tmp_path / "a.glb"))


def test_the_primitive_restart_value_is_refused(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(np.zeros((256, 3), np.float32))
    indices = gltf.accessor(np.array([0, 1, 255], np.uint8))
    gltf.json["meshes"][mesh]["primitives"][0]["indices"] = indices
    gltf.node(mesh=mesh)
    with pytest.raises(SceneError, match="vertex 255"):
        load(gltf.save_glb(tmp_path / "a.glb"))


def test_loops_of_nodes_are_refused_wherever_they_are(tmp_path: Path) -> None:
    gltf = one_triangle()
    gltf.node(root=False, children=[2])
    gltf.node(root=False, children=[1])
    with pytest.raises(SceneError, match="its own ancestor"):
        load(gltf.save_glb(tmp_path / "a.glb"))
    deep = one_triangle()
    for i in range(2000):
        deep.node(root=False, children=[i + 2])
    deep.node(root=False)
    deep.json["scenes"][0]["nodes"].append(1)
    with pytest.raises(SceneError, match="nested over"):
        load(deep.save_glb(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    "cut", [b"", b"glTF", b"glTF\2\0\0\0\xff\xff\xff\xff", b"glTX\2\0\0\0\x0c\0\0\0"]
)
def test_broken_containers(tmp_path: Path, cut: bytes) -> None:
    (tmp_path / "a.glb").write_bytes(cut)
    with pytest.raises(SceneError, match="GLB"):
        load(tmp_path / "a.glb")


def test_every_cut_of_a_binary_file_is_refused(tmp_path: Path) -> None:
    data = one_triangle().glb()
    for size in range(len(data)):
        (tmp_path / "a.glb").write_bytes(data[:size])
        with pytest.raises(SceneError):
            load(tmp_path / "a.glb")


def test_many_things_of_one_name_and_many_warnings(tmp_path: Path) -> None:
    gltf = Gltf()
    for _ in range(3000):
        gltf.append("materials", {"name": "same"})
    mesh = gltf.mesh(TRIANGLE)
    first = gltf.json["meshes"][mesh]["primitives"][0]
    gltf.json["meshes"][mesh]["primitives"] = [
        {**first, "material": i, "mode": 4 if i % 2 else 1} for i in range(3000)
    ]
    gltf.node(mesh=mesh)
    scene = load(gltf.save_glb(tmp_path / "a.glb"))
    assert len(scene.materials) == len(scene.shapes) == 1500
    assert len(scene.warnings) == 501
    assert scene.warnings[-1] == "there are further warnings"


def test_accessors_without_data_may_not_claim_much(tmp_path: Path) -> None:
    gltf = one_triangle()
    accessor = gltf.append("accessors", {"componentType": 5126, "count": 10**7, "type": "VEC3"})
    for _ in range(100):
        gltf.append("meshes", {"primitives": [{"attributes": {"POSITION": accessor}}]})
    with pytest.raises(SceneError, match="accessors without data are too large"):
        load(gltf.save_glb(tmp_path / "a.glb"))
