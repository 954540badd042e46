"""Mitsuba's `.serialized` meshes, versions 3 and 4."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import read_bytes
from raykiln.formats.meshes import Array, MeshData, check_count

MAGIC = 0x041C
VERSIONS = (3, 4)
# A deflated array may not claim more than this.
MAX_ARRAY_BYTES = 1 << 31
HAS_NORMALS, HAS_UVS, HAS_COLORS, FACE_NORMALS, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x2000


def read_mesh(path: Path, index: int) -> MeshData:
    """Mesh number `index` (from 0) of a file; with face normals, `normals` is None."""
    data = read_bytes(path)
    start, version = _locate(data, index)
    return _Stream(data, start + 4).mesh(version)


def smooth(path: Path, index: int) -> bool:
    """Whether the mesh asks for smooth normals where it has none."""
    data = read_bytes(path)
    start, _ = _locate(data, index)
    return not struct.unpack("<I", _Stream(data, start + 4).take(4))[0] & FACE_NORMALS


def _locate(data: bytes, index: int) -> tuple[int, int]:
    """Offset of a mesh's header, and the version of the file."""
    if len(data) < 4:
        raise SceneError("not a serialized mesh: too short")
    magic, version = struct.unpack_from("<HH", data)
    if magic != MAGIC or version not in VERSIONS:
        raise SceneError("not a serialized mesh of version 3 or 4", found=f"{magic:#x} {version}")
    if index == 0:
        return 0, version
    count = struct.unpack_from("<I", data, len(data) - 4)[0]
    if not 0 <= index < count:
        raise SceneError("no such shape index", found=index, accepted=f"0 to {count - 1}")
    size = 8 if version == 4 else 4
    place = len(data) - 4 - size * (count - index)
    if place < 0:
        raise SceneError("the serialized file's directory is damaged")
    start = struct.unpack_from("<Q" if size == 8 else "<I", data, place)[0]
    if start + 4 > len(data) or struct.unpack_from("<H", data, start)[0] != MAGIC:
        raise SceneError("the serialized file's directory is damaged")
    return start, version


class _Stream:
    """Reads the deflated part of a mesh piece by piece, so that a false size costs no memory."""

    def __init__(self, data: bytes, start: int) -> None:
        self.data, self.position = data, start
        self.inflater = zlib.decompressobj()
        self.pending = b""

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        if size > MAX_ARRAY_BYTES:
            raise SceneError("the serialized mesh claims too much data", found=size)
        parts, got = [], 0
        while got < size:
            try:
                part = self._inflate(size - got)
            except zlib.error as error:
                raise SceneError(f"the serialized mesh cannot be inflated: {error}") from None
            if not part:
                raise SceneError("the serialized mesh ends too early")
            parts.append(part)
            got += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _inflate(self, size: int) -> bytes:
        limit = min(size, 1 << 24)
        while True:
            source = self.pending or self.data[self.position : self.position + (1 << 20)]
            if not self.pending:
                self.position += len(source)
            part = self.inflater.decompress(source, limit)
            self.pending = self.inflater.unconsumed_tail
            if part or self.inflater.eof or not source:
                return part

    def mesh(self, version: int) -> MeshData:
        """The mesh that the stream holds."""
        flags = struct.unpack("<I", self.take(4))[0]
        name = self._name() if version == 4 else ""
        counts = struct.unpack("<QQ", self.take(16))
        vertices, faces = check_count("vertices", counts[0]), check_count("triangles", counts[1])
        number = np.dtype("<f8" if flags & DOUBLE else "<f4")
        mesh = MeshData(self._rows(vertices, 3, number), np.empty((0, 3)), name=name or None)
        if flags & HAS_NORMALS:
            normals = self._rows(vertices, 3, number)
            mesh.normals = None if flags & FACE_NORMALS else normals
        if flags & HAS_UVS:
            mesh.uvs = self._rows(vertices, 2, number)
        if flags & HAS_COLORS:
            self._rows(vertices, 3, number)
            mesh.warnings.append("vertex colours of the serialized mesh are not used")
        mesh.faces = self._rows(faces, 3, np.dtype("<u4"))
        return mesh

    def _name(self) -> str:
        name = b""
        while (letter := self.take(1)) != b"\0":
            name += letter
            if len(name) > 4096:
                raise SceneError("the serialized mesh's name does not end")
        return name.decode("utf-8", "replace")

    def _rows(self, count: int, width: int, number: np.dtype[np.generic]) -> Array:
        data = self.take(count * width * number.itemsize)
        rows = np.frombuffer(data, number).reshape(count, width)
        with np.errstate(over="ignore"):
            return rows if number.kind == "u" else rows.astype(np.float32, copy=False)
