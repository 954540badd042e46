"""Public glTF files: all good ones load, and no broken one does harm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.scene import Mesh

# What Khronos' validator finds in files whose geometry cannot be used.
UNUSABLE = {
    "ACCESSOR_INDEX_OOB",
    "ACCESSOR_INDEX_PRIMITIVE_RESTART",
    "GLB_CHUNK_TOO_BIG",
    "GLB_DUPLICATE_CHUNK",
    "GLB_INVALID_MAGIC",
    "GLB_INVALID_VERSION",
    "GLB_LENGTH_TOO_SMALL",
    "GLB_UNEXPECTED_END_OF_CHUNK_DATA",
    "GLB_UNEXPECTED_END_OF_CHUNK_HEADER",
    "GLB_UNEXPECTED_END_OF_HEADER",
    "GLB_UNEXPECTED_FIRST_CHUNK",
    "MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT",
    "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT",
    "NODE_LOOP",
    "NODE_PARENT_OVERRIDE",
    "UNKNOWN_ASSET_MAJOR_VERSION",
}


def gltf_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.suffix in (".gltf", ".glb"))


def test_every_positive_asset_loads(shared_assets: Path) -> None:
    files = gltf_files(shared_assets / "gltf" / "asset-generator" / "Positive")
    assert len(files) > 50
    for path in files:
        load(path)


def test_negative_assets_load_or_are_refused(shared_assets: Path) -> None:
    for path in gltf_files(shared_assets / "gltf" / "asset-generator" / "Negative"):
        try:
            scene = load(path)
        except SceneError:
            continue
        assert scene.warnings


def test_the_validators_files_load_or_are_refused(shared_assets: Path) -> None:
    refused = set()
    files = gltf_files(shared_assets / "gltf" / "validator-negative")
    assert len(files) > 300
    for path in files:
        try:
            load(path)
        except SceneError:
            refused.add(path)
    accepted_wrongly = []
    for path in files:
        report = path.with_name(path.name + ".report.json")
        if report.exists() and path not in refused:
            messages = json.loads(report.read_text())["issues"]["messages"]
            if UNUSABLE & {m["code"] for m in messages if m["severity"] == 0}:
                accepted_wrongly.append(path.name)
    assert accepted_wrongly == []


def test_sample_models(shared_assets: Path) -> None:
    root = shared_assets / "gltf"
    path = root / "bevy" / "FlightHelmet" / "FlightHelmet.gltf"
    helmet = load(path)
    assert len(helmet.textures) == 15
    triangles = sum(
        len(s.faces) for s in helmet.shapes if isinstance(s, Mesh) and s.faces is not None
    )
    document = json.loads(path.read_text())
    used = [p["indices"] for m in document["meshes"] for p in m["primitives"]]
    assert triangles == sum(document["accessors"][i]["count"] for i in used) // 3
    duck = root / "draco" / "KhronosSampleModels" / "Duck"
    json_duck, glb_duck = load(duck / "glTF" / "Duck.gltf"), load(duck / "glTF_Binary" / "Duck.glb")
    a, b = json_duck.shapes[0], glb_duck.shapes[0]
    assert isinstance(a, Mesh)
    assert isinstance(b, Mesh)
    assert np.array_equal(np.array(a.vertices), np.array(b.vertices))
    assert a.transform == b.transform
    assert json_duck.cameras[0].fov_deg == pytest.approx(37.849, abs=1e-3)


def test_draco_is_named_as_not_supported(shared_assets: Path) -> None:
    path = shared_assets / "gltf" / "draco" / "Box" / "glTF_Binary" / "Box_Draco.glb"
    with pytest.raises(SceneError, match="KHR_draco_mesh_compression"):
        load(path)


def test_plain_boxes_agree_in_both_containers(shared_assets: Path) -> None:
    box = shared_assets / "gltf" / "draco" / "Box"
    for path in (box / "glTF" / "Box.gltf", box / "glTF_Binary" / "Box.glb"):
        (mesh,) = load(path).shapes
        assert isinstance(mesh, Mesh)
        assert mesh.faces is not None
        assert len(mesh.faces) == 12
