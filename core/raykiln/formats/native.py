"""The native JSON format: the scene description itself."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from raykiln.errors import SceneError
from raykiln.formats import obj, ply, stl
from raykiln.formats.files import MAX_FILE_BYTES, Files, scene_errors
from raykiln.formats.json_text import parse_json
from raykiln.formats.meshes import MeshData
from raykiln.scene import EnvironmentLight, ImageTexture, Mesh, Scene

MESH_READERS: dict[str, Callable[[Path], MeshData]] = {
    ".obj": obj.read_mesh,
    ".ply": ply.read_mesh,
    ".stl": stl.read_mesh,
}
SCHEMA_ID = "https://json-schema.org/draft/2020-12/schema"


def read(path: Path, files: Files) -> Scene:
    """The scene of a native JSON file, with its mesh files read and its images found."""
    text = files.read(path, limit=MAX_FILE_BYTES).decode("utf-8-sig")
    return from_data(parse_json(text), files)


def from_data(data: Any, files: Files) -> Scene:
    """The scene of parsed native JSON."""
    if not isinstance(data, dict):
        raise SceneError("a scene is a JSON object", found=data, accepted='{"shapes": [...], ...}')
    # Editors use it to offer completion.
    data.pop("$schema", None)
    scene = Scene.create(data)
    for name, texture in scene.textures.items():
        if isinstance(texture, ImageTexture) and texture.file is not None:
            texture.file = _located(files, texture.file, f"/textures/{name}/file")
    for i, light in enumerate(scene.lights):
        if isinstance(light, EnvironmentLight) and light.file is not None:
            light.file = _located(files, light.file, f"/lights/{i}/file")
    _read_meshes(scene, scene.shapes, files, "/shapes")
    for name, shapes in scene.groups.items():
        _read_meshes(scene, shapes, files, f"/groups/{name}")
    return scene


def _located(files: Files, name: str, pointer: str) -> str:
    return files.relative(files.resolve(name, pointer))


def _read_meshes(scene: Scene, shapes: list[Any], files: Files, pointer: str) -> None:
    for i, shape in enumerate(shapes):
        if isinstance(shape, Mesh) and shape.file is not None:
            shapes[i] = _with_arrays(scene, shape, files, f"{pointer}/{i}/file")


def _with_arrays(scene: Scene, shape: Mesh, files: Files, pointer: str) -> Mesh:
    """The mesh with the arrays of the file that it names."""
    path = files.resolve(shape.file or "", pointer)
    reader = MESH_READERS.get(path.suffix.lower())
    if reader is None:
        raise SceneError(
            "not a mesh file", pointer=pointer, found=path.name, accepted=" ".join(MESH_READERS)
        )
    with scene_errors(path):
        mesh = reader(path)
    for message in mesh.warnings:
        scene.warn(f"{path.name}: {message}")
    values = {name: getattr(shape, name) for name in shape.model_fields_set - {"file"}}
    arrays = {
        "vertices": mesh.vertices, "faces": mesh.faces, "normals": mesh.normals, "uvs": mesh.uvs
    }  # fmt: skip
    with scene_errors(path):
        return Mesh.model_validate({**values, **arrays})


def schema() -> dict[str, Any]:
    """The JSON Schema of the native format, made from the scene description."""
    made = Scene.model_json_schema(mode="validation")
    made["properties"]["$schema"] = {"type": "string"}
    return {"$schema": SCHEMA_ID, "title": "raykiln scene", **made}


if __name__ == "__main__":
    json.dump(schema(), sys.stdout, indent=1, sort_keys=True)
    sys.stdout.write("\n")
