"""glTF containers, buffers and accessors."""

from __future__ import annotations

import base64
import binascii
import struct
from urllib.parse import unquote_to_bytes

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import Files
from raykiln.formats.json_text import Item, parse_json
from raykiln.formats.meshes import Array

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Bytes that all accessors together may claim without a buffer behind them (all zeros).
MAX_UNBACKED_BYTES = 1 << 28
GLB_MAGIC, CHUNK_JSON, CHUNK_BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


def split_glb(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a GLB file."""
    if len(data) < 12:
        raise SceneError(f"a GLB file of only {len(data)} bytes")
    magic, version, length = struct.unpack_from("<III", data)
    if magic != GLB_MAGIC:
        raise SceneError("not a GLB file", found=data[:4])
    if version != 2:
        raise SceneError("a GLB file of another version", found=version, accepted="2")
    if length > len(data):
        raise SceneError(f"the GLB file has {len(data)} bytes and claims {length}")
    chunks: dict[int, bytes] = {}
    offset, first = 12, True
    while offset < length:
        if offset + 8 > length:
            raise SceneError("the GLB file ends within a chunk's header")
        size, kind = struct.unpack_from("<II", data, offset)
        if offset + 8 + size > length:
            raise SceneError("a GLB chunk is larger than its file")
        if first != (kind == CHUNK_JSON) or kind in chunks:
            raise SceneError(
                "the chunks of the GLB file are not one JSON chunk and what follows it"
            )
        if kind in (CHUNK_JSON, CHUNK_BIN):
            chunks[kind] = data[offset + 8 : offset + 8 + size]
        offset += 8 + size
        first = False
    if CHUNK_JSON not in chunks:
        raise SceneError("the GLB file has no JSON chunk")
    return chunks[CHUNK_JSON], chunks.get(CHUNK_BIN)


def data_uri(uri: str, pointer: str) -> bytes:
    """The bytes of a `data:` URI."""
    header, comma, body = uri.partition(",")
    if not comma:
        raise SceneError("a data URI without data", pointer=pointer, found=uri)
    raw = unquote_to_bytes(body)
    if not header.endswith(";base64"):
        return raw
    try:
        return base64.b64decode(raw, validate=True)
    except binascii.Error:
        raise SceneError("a data URI that is not base64", pointer=pointer, found=uri) from None


class GltfData:
    """The JSON of a glTF file with the bytes that it refers to.

    Attributes
    ----------
    root
        The top-level JSON object.
    """

    def __init__(self, files: Files, text: bytes, binary: bytes | None) -> None:
        self.files = files
        self.root = Item(parse_json(text.decode("utf-8-sig")), "")
        self._binary = binary
        self._buffers: dict[int, bytes] = {}
        self._unbacked = 0

    def buffer(self, index: int, pointer: str) -> bytes:
        """The bytes of a buffer."""
        if index not in self._buffers:
            item = self.root.entry("buffers", index, pointer)
            data = self._buffer_bytes(item, index)
            length = item.integer("byteLength")
            if len(data) < length:
                raise SceneError(
                    f"the buffer has {len(data)} bytes and claims {length}", pointer=item.pointer
                )
            self._buffers[index] = data
        return self._buffers[index]

    def _buffer_bytes(self, item: Item, index: int) -> bytes:
        if "uri" in item:
            return self.uri_bytes(item.string("uri"), f"{item.pointer}/uri")
        if index != 0 or self._binary is None:
            raise SceneError("a buffer without data", pointer=item.pointer, accepted="a uri")
        return self._binary

    def uri_bytes(self, uri: str, pointer: str) -> bytes:
        """The bytes that a URI means: a `data:` URI, or a file beside this one."""
        if uri.startswith("data:"):
            return data_uri(uri, pointer)
        return self.files.read(self.files.resolve_uri(uri, pointer))

    def view(self, index: int, pointer: str) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and its stride (0 = tightly packed)."""
        item = self.root.entry("bufferViews", index, pointer)
        data = self.buffer(item.integer("buffer"), f"{item.pointer}/buffer")
        start, length = item.integer("byteOffset", 0), item.integer("byteLength")
        if start + length > len(data):
            raise SceneError(
                f"the view ends at byte {start + length} of a buffer of {len(data)}",
                pointer=item.pointer,
            )
        stride = item.integer("byteStride", 0)
        if stride and not 4 <= stride <= 252:
            raise SceneError("a stride out of range", pointer=item.pointer, found=stride,
                             accepted="4 to 252")  # fmt: skip
        return memoryview(data)[start : start + length], stride

    def accessor(self, index: int, pointer: str) -> Array:
        """The elements (n, width) of an accessor, in the type of its components, sparse applied."""
        item = self.root.entry("accessors", index, pointer)
        kind, width = self._layout(item)
        count = item.integer("count")
        if count == 0:
            raise SceneError("an accessor of no elements", pointer=item.pointer)
        if "bufferView" in item:
            values = self._strided(item, item, kind, width, count, allow_stride=True)
        else:
            self._unbacked += count * width * kind.itemsize
            if self._unbacked > MAX_UNBACKED_BYTES:
                raise SceneError(
                    "accessors without data are too large", pointer=item.pointer, found=count
                )
            values = np.zeros((count, width), kind)
        if "sparse" in item:
            values = self._sparse(item.item("sparse"), values)
        return values

    def floats(self, index: int, pointer: str) -> Array:
        """The elements of an accessor as float32; normalized integers are scaled."""
        values = self.accessor(index, pointer)
        item = self.root.entry("accessors", index, pointer)
        if values.dtype.kind == "f":
            return values
        if not item.boolean("normalized", False):
            return values.astype(np.float32)
        scaled: Array = values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
        return np.maximum(scaled, np.float32(-1.0), out=scaled)

    def _layout(self, item: Item) -> tuple[np.dtype[np.generic], int]:
        component, name = item.integer("componentType"), item.string("type")
        if component not in COMPONENTS:
            raise SceneError(
                "an unknown component type",
                pointer=f"{item.pointer}/componentType",
                found=component,
                accepted=" ".join(map(str, COMPONENTS)),
            )
        if name not in WIDTHS:
            raise SceneError(
                "an unknown accessor type",
                pointer=f"{item.pointer}/type",
                found=name,
                accepted=" ".join(WIDTHS),
            )
        return np.dtype(COMPONENTS[component]), WIDTHS[name]

    def _strided(
        self,
        item: Item,
        owner: Item,
        kind: np.dtype[np.generic],
        width: int,
        count: int,
        *,
        allow_stride: bool,
    ) -> Array:
        view, stride = self.view(item.integer("bufferView"), f"{item.pointer}/bufferView")
        start, size = item.integer("byteOffset", 0), width * kind.itemsize
        step = stride if stride and allow_stride else size
        if step < size:
            raise SceneError(f"elements of {size} bytes overlap in a view with a stride of {step}",
                             pointer=owner.pointer)  # fmt: skip
        if start + (count - 1) * step + size > len(view):
            raise SceneError(
                f"{count} elements do not fit into the view of {len(view)} bytes",
                pointer=owner.pointer,
            )
        return np.ndarray((count, width), kind, view, start, (step, kind.itemsize))

    def _sparse(self, sparse: Item, values: Array) -> Array:
        """`values` with some elements replaced."""
        count = sparse.integer("count")
        if not 1 <= count <= len(values):
            raise SceneError("a sparse count out of range", pointer=sparse.pointer, found=count)
        places, substitutes = sparse.item("indices"), sparse.item("values")
        component = places.integer("componentType")
        if component not in (5121, 5123, 5125):
            raise SceneError("sparse indices of another type", pointer=places.pointer,
                             found=component, accepted="5121 5123 5125")  # fmt: skip
        kind = np.dtype(COMPONENTS[component])
        index = self._strided(places, places, kind, 1, count, allow_stride=False)[:, 0]
        if int(index.max()) >= len(values):
            raise SceneError("a sparse index out of range", pointer=places.pointer)
        replaced = values.copy()
        replaced[index] = self._strided(
            substitutes, substitutes, values.dtype, values.shape[1], count, allow_stride=False
        )
        return replaced
