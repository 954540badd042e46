"""A writer of binary glTF files, as small as the product shot needs it."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT, UINT16 = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class GlbWriter:
    """Collects the parts of a glTF document; `document` may be added to freely."""

    def __init__(self) -> None:
        self.binary = bytearray()
        self.document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "raykiln"}}

    def add(self, kind: str, **values: Any) -> int:
        """Append an entry to one of the document's lists; returns its index."""
        entries = self.document.setdefault(kind, [])
        entries.append(values)
        return len(entries) - 1

    def mesh(
        self, name: str, vertices: Any, normals: Any, uvs: Any, faces: Any, material: int
    ) -> int:
        """A mesh of one primitive, as a node; returns the node."""
        attributes = {
            "POSITION": self._accessor(np.asarray(vertices, np.float32), bounds=True),
            "NORMAL": self._accessor(np.asarray(normals, np.float32)),
            "TEXCOORD_0": self._accessor(np.asarray(uvs, np.float32)),
        }
        indices = self._accessor(np.asarray(faces, np.uint16).reshape(-1, 1))
        primitive = {"attributes": attributes, "indices": indices, "material": material}
        mesh = self.add("meshes", name=name, primitives=[primitive])
        return self.add("nodes", name=name, mesh=mesh)

    def image(self, name: str, png: bytes) -> dict[str, int]:
        """A textureInfo of an embedded PNG."""
        view = self._view(png, None)
        image = self.add("images", name=name, mimeType="image/png", bufferView=view)
        return {"index": self.add("textures", source=image)}

    def content(self) -> bytes:
        """The file."""
        self.document["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _view(self, data: bytes, target: int | None) -> int:
        offset = len(self.binary)
        self.binary += data + bytes(-len(data) % 4)
        values = {"buffer": 0, "byteOffset": offset, "byteLength": len(data)}
        return self.add("bufferViews", **values, **({"target": target} if target else {}))

    def _accessor(self, array: NDArray[Any], bounds: bool = False) -> int:
        is_index = array.dtype == np.uint16
        view = self._view(array.tobytes(), ELEMENT_ARRAY_BUFFER if is_index else ARRAY_BUFFER)
        values: dict[str, Any] = {
            "bufferView": view,
            "componentType": UINT16 if is_index else FLOAT,
            "count": len(array),
            "type": _KINDS[array.shape[1]],
        }
        if bounds:
            values["min"], values["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
        return self.add("accessors", **values)
