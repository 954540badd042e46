"""STL meshes: ASCII and binary."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import Files, read_bytes
from raykiln.formats.meshes import Array, MeshData
from raykiln.scene import Scene

HEADER_BYTES = 84
RECORD = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")


def read(path: Path, files: Files) -> Scene:
    """The scene of one STL mesh."""
    mesh = read_mesh(path)
    scene = Scene(name=path.stem)
    scene.add_mesh(mesh.vertices, mesh.faces, name=path.stem[:256] or None)
    return scene


def read_mesh(path: Path) -> MeshData:
    """The triangles of an STL file; the normals in it are those of the faces and not kept."""
    data = read_bytes(path)
    vertices = _binary(data) if _is_binary(data) else _ascii(data)
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    return MeshData(vertices, faces)


def _is_binary(data: bytes) -> bool:
    # A binary file may begin with "solid" too; its length tells.
    if len(data) >= HEADER_BYTES:
        count = int.from_bytes(data[80:84], "little")
        if len(data) == HEADER_BYTES + count * RECORD.itemsize:
            return True
    return data.lstrip()[:5].lower() != b"solid"


def _binary(data: bytes) -> Array:
    if len(data) < HEADER_BYTES:
        raise SceneError(f"a binary STL file of only {len(data)} bytes")
    count = int.from_bytes(data[80:84], "little")
    if (len(data) - HEADER_BYTES) // RECORD.itemsize < count:
        raise SceneError(f"the STL file ends before its {count} triangles do")
    records = np.frombuffer(data, RECORD, count, HEADER_BYTES)
    return np.ascontiguousarray(records["vertices"]).reshape(-1, 3)


def _ascii(data: bytes) -> Array:
    found = _VERTEX.findall(data)
    if not found or len(found) % 3:
        raise SceneError(f"an ASCII STL file with {len(found)} vertices", accepted="three a facet")
    try:
        return np.array(found).astype(np.float32)
    except ValueError:
        raise SceneError("a vertex of the STL file is not three numbers") from None
