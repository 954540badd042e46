"""Builds small glTF files for tests."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125,
               "float32": 5126}  # fmt: skip
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)


class Gltf:
    """A glTF document that grows."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0}
        self.json["scenes"] = [{"nodes": []}]
        for name in ("nodes", "meshes", "accessors", "bufferViews"):
            self.json[name] = []
        self.binary = b""

    def view(self, data: bytes, **extra: Any) -> int:
        """Add bytes; returns the number of the buffer view."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **extra}
        self.binary += data
        return self._append("bufferViews", view)

    def accessor(self, array: NDArray[Any], **extra: Any) -> int:
        """Add an array (n,) or (n, width); returns the number of the accessor."""
        rows = array.reshape(len(array), -1)
        accessor = {
            "bufferView": self.view(np.ascontiguousarray(array).tobytes()),
            "componentType": _COMPONENTS[str(array.dtype)],
            "count": len(rows),
            "type": _TYPES[rows.shape[1]],
            **extra,
        }
        return self._append("accessors", accessor)

    def mesh(self, positions: NDArray[Any], indices: Any = None, **primitive: Any) -> int:
        """Add a mesh of one primitive; returns its number."""
        attributes = {"POSITION": self.accessor(positions), **primitive.pop("attributes", {})}
        entry: dict[str, Any] = {"attributes": attributes, **primitive}
        if indices is not None:
            entry["indices"] = self.accessor(np.asarray(indices, np.uint16))
        return self._append("meshes", {"primitives": [entry]})

    def node(self, *, root: bool = True, **values: Any) -> int:
        """Add a node, shown by the scene unless it is a child; returns its number."""
        number = self._append("nodes", values)
        if root:
            self.json["scenes"][0]["nodes"].append(number)
        return number

    def append(self, name: str, value: dict[str, Any]) -> int:
        """Add to any list; returns the number."""
        self.json.setdefault(name, [])
        return self._append(name, value)

    def _append(self, name: str, value: dict[str, Any]) -> int:
        self.json[name].append(value)
        return len(self.json[name]) - 1

    def _document(self) -> dict[str, Any]:
        document = {key: value for key, value in self.json.items() if value != []}
        if self.binary:
            document["buffers"] = [{"byteLength": len(self.binary)}]
        return document

    def document(self) -> dict[str, Any]:
        """The JSON with the buffer in a data URI."""
        document = self._document()
        if self.binary:
            coded = base64.b64encode(self.binary).decode()
            document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{coded}"
        return document

    def save_gltf(self, path: Path) -> Path:
        """Write `document`."""
        path.write_text(json.dumps(self.document()))
        return path

    def save_glb(self, path: Path) -> Path:
        """Write a GLB file."""
        path.write_bytes(self.glb())
        return path

    def glb(self) -> bytes:
        """The bytes of a GLB file."""
        text = json.dumps(self._document()).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def one_triangle() -> Gltf:
    """A document with one triangle."""
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(TRIANGLE))
    return gltf
