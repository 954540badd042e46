"""PLY meshes: ASCII and binary, of either byte order."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import Files, read_array
from raykiln.formats.meshes import Array, MeshData, check_count, triangulate
from raykiln.scene import Scene

MAX_HEADER_BYTES = 1 << 16
MAX_LIST = 1 << 20
ROWS_AT_ONCE = 1 << 16

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
UV_NAMES = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
FACE_NAMES = ("vertex_indices", "vertex_index")


@dataclass
class Property:
    """A property of an element; `count_type` is given for lists."""

    name: str
    type: str
    count_type: str | None = None


@dataclass
class Element:
    """An element of the header."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def has_lists(self) -> bool:
        """Whether records differ in size."""
        return any(p.count_type for p in self.properties)


def read(path: Path, files: Files) -> Scene:
    """The scene of one PLY mesh."""
    mesh = read_mesh(path)
    scene = Scene(name=path.stem)
    scene.add_mesh(mesh.vertices, mesh.faces, mesh.normals, mesh.uvs, name=path.stem[:256] or None)
    for message in mesh.warnings:
        scene.warn(message)
    return scene


def read_mesh(path: Path) -> MeshData:
    """The triangles of a PLY file; arrays may be views of the file's bytes."""
    data = read_array(path)
    encoding, elements, start = _header(data)
    if encoding == "ascii":
        body = _ascii_body(data, start)
        tables = _tables(body, 0, elements, "<", ascii_numbers=True)
    else:
        tables = _tables(data, start, elements, encoding, ascii_numbers=False)
    mesh = _mesh(elements, tables)
    _release(mesh, data)
    return mesh


def _release(mesh: MeshData, data: Array) -> None:
    """Copy the arrays that are views of the file, if they would keep much more of it in memory."""
    views = [n for n in ("vertices", "faces") if np.may_share_memory(getattr(mesh, n), data)]
    if 2 * sum(getattr(mesh, name).nbytes for name in views) < data.nbytes:
        for name in views:
            setattr(mesh, name, getattr(mesh, name).copy())


def _header(data: Array) -> tuple[str, list[Element], int]:
    head = data[: MAX_HEADER_BYTES + 64].tobytes()
    if not head.startswith(b"ply"):
        raise SceneError(
            "not a PLY file", found=head[:16], accepted="a file that begins with 'ply'"
        )
    end = head.find(b"end_header", 0, MAX_HEADER_BYTES)
    if end < 0:
        raise SceneError("the PLY header has no end_header")
    newline = head.find(b"\n", end)
    start = len(data) if newline < 0 else newline + 1
    encoding = ""
    elements: list[Element] = []
    for number, line in enumerate(head[:end].decode("latin-1").splitlines(), 1):
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        try:
            encoding = _header_line(words, elements) or encoding
        except (ValueError, IndexError, KeyError):
            raise SceneError(
                "a bad line in the PLY header", pointer=f"line {number}", found=line
            ) from None
    if not encoding:
        raise SceneError("the PLY header names no format")
    return encoding, elements, start


def _header_line(words: list[str], elements: list[Element]) -> str | None:
    match words:
        case ["format", name, *_]:
            return {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[name]
        case ["element", name, count]:
            elements.append(Element(name, check_count(f"'{name}' elements", int(count))))
        case ["property", "list", count_type, item_type, name]:
            if TYPES[count_type][0] == "f":
                raise ValueError(count_type)
            elements[-1].properties.append(Property(name, TYPES[item_type], TYPES[count_type]))
        case ["property", item_type, name]:
            elements[-1].properties.append(Property(name, TYPES[item_type]))
        case _:
            raise ValueError(words[0])
    return None


def _ascii_body(data: Array, start: int) -> Array:
    """All numbers after the header, as the bytes of float64."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(data[start:].tobytes(), dtype="<f8", sep=" ").view(np.uint8)
        except (DeprecationWarning, ValueError):
            raise SceneError("a word among the numbers of the ASCII PLY file") from None


def _tables(
    data: Array, start: int, elements: list[Element], order: str, *, ascii_numbers: bool
) -> dict[str, list[Array]]:
    """Runs of records of equal layout, as structured arrays, for each element."""
    tables: dict[str, list[Array]] = {}
    for element in elements:
        reader = _Runs(data, start, element, order, ascii_numbers)
        tables.setdefault(element.name, []).extend(reader.runs())
        start = reader.offset
    return tables


class _Runs:
    """Reads one element: records with lists are read in runs of equal list lengths."""

    def __init__(self, data: Array, start: int, element: Element, order: str, ascii: bool) -> None:
        self.data, self.offset, self.element = data, start, element
        self.order, self.ascii = order, ascii

    def runs(self) -> list[Array]:
        """Structured arrays; the property number i has its values in field `i`, and a list its
        lengths in `#i`."""
        if not self.element.properties:
            return []
        if not self.element.has_lists():
            return [self._records(self._layout([]), self.element.count)]
        spans: list[tuple[np.dtype[Any], int]] = []
        left, window, begin = self.element.count, 64, self.offset
        while left:
            lengths = self._lengths()
            layout = self._layout(lengths)
            records = self._peek(layout, min(left, window))
            same = self._matching(records, lengths)
            if spans and spans[-1][0] == layout:
                spans[-1] = (layout, spans[-1][1] + same)
            else:
                spans.append((layout, same))
            self.offset += same * layout.itemsize
            left -= same
            window = window * 4 if same == len(records) else 64
        self.offset = begin
        return [self._records(layout, count) for layout, count in spans]

    def _number(self, kind: str) -> np.dtype[Any]:
        return np.dtype("<f8" if self.ascii else self.order + kind)

    def _layout(self, lengths: list[int]) -> np.dtype[Any]:
        fields: list[Any] = []
        remaining = iter(lengths)
        for i, p in enumerate(self.element.properties):
            if p.count_type is None:
                fields.append((f"{i}", self._number(p.type)))
            else:
                fields.append((f"#{i}", self._number(p.count_type)))
                fields.append((f"{i}", self._number(p.type), (next(remaining),)))
        return np.dtype(fields)

    def _lengths(self) -> list[int]:
        """The list lengths of the record at the current offset."""
        offset, lengths = self.offset, []
        for p in self.element.properties:
            if p.count_type is None:
                offset += self._number(p.type).itemsize
                continue
            kind = self._number(p.count_type)
            if offset + kind.itemsize > len(self.data):
                raise self._short()
            length = np.frombuffer(self.data, kind, 1, offset)[0]
            if not 0 <= length <= MAX_LIST or length != int(length):
                raise SceneError(f"a list of {length} items in element '{self.element.name}'")
            lengths.append(int(length))
            offset += kind.itemsize + int(length) * self._number(p.type).itemsize
        return lengths

    def _peek(self, layout: np.dtype[Any], count: int) -> Array:
        """The next records, as many of `count` as the file still holds (at least one)."""
        available = (len(self.data) - self.offset) // layout.itemsize
        if available < min(count, 1):
            raise self._short()
        return np.frombuffer(self.data, layout, min(count, available), self.offset)

    def _records(self, layout: np.dtype[Any], count: int) -> Array:
        """The next `count` records, and step over them."""
        records = self._peek(layout, count)
        if len(records) < count:
            raise self._short()
        self.offset += count * layout.itemsize
        return records

    def _matching(self, records: Array, lengths: list[int]) -> int:
        """How many of the first records have these list lengths."""
        lists = [i for i, p in enumerate(self.element.properties) if p.count_type]
        good = np.ones(len(records), bool)
        for i, length in zip(lists, lengths, strict=True):
            good &= records[f"#{i}"] == length
        return len(good) if good.all() else int(np.argmin(good))

    def _short(self) -> SceneError:
        return SceneError(
            f"the PLY file ends before its {self.element.count} '{self.element.name}' elements do"
        )


def _mesh(elements: list[Element], tables: dict[str, list[Array]]) -> MeshData:
    vertex = next((e for e in elements if e.name == "vertex"), None)
    if vertex is None or vertex.has_lists():
        raise SceneError("the PLY file has no plain 'vertex' element")
    if sum(e.name in ("vertex", "face") for e in elements) != len(
        {e.name for e in elements} & {"vertex", "face"}
    ):
        raise SceneError("the PLY file has an element twice")
    records = tables["vertex"][0] if tables["vertex"] else np.empty(0)
    column = {p.name: i for i, p in enumerate(vertex.properties)}
    positions = _columns(records, column, ("x", "y", "z"))
    if positions is None:
        raise SceneError("the PLY file's vertices have no x, y and z")
    uvs = next((a for a in (_columns(records, column, n) for n in UV_NAMES) if a is not None), None)
    face = next((e for e in elements if e.name == "face"), None)
    faces = _faces(face, tables.get("face", []), positions)
    mesh = MeshData(positions, faces, _columns(records, column, ("nx", "ny", "nz")), uvs)
    known = {"x", "y", "z", "nx", "ny", "nz"}.union(*UV_NAMES)
    if {"red", "r", "diffuse_red"} & column.keys():
        mesh.warnings.append("vertex colours of the PLY file are not used")
    elif other := sorted(column.keys() - known):
        mesh.warnings.append(
            f"vertex properties of the PLY file are not used: {', '.join(other)[:200]}"
        )
    if unknown := sorted({e.name for e in elements} - {"vertex", "face"}):
        mesh.warnings.append(f"elements of the PLY file are not used: {', '.join(unknown)[:200]}")
    return mesh


def _columns(records: Array, column: dict[str, int], names: tuple[str, ...]) -> Array | None:
    """(n, len(names)) float32; a view if the numbers are float32 that stand side by side."""
    if not all(name in column for name in names):
        return None
    if records.size == 0:
        return np.empty((0, len(names)), np.float32)
    keys = [f"{column[name]}" for name in names]
    assert records.dtype.fields is not None
    kinds = [records.dtype.fields[key] for key in keys]
    first = kinds[0][1]
    if all(kind[0] == "<f4" and kind[1] == first + 4 * i for i, kind in enumerate(kinds)):
        view = records.view(np.uint8).reshape(len(records), -1)[:, first : first + 4 * len(keys)]
        return np.ascontiguousarray(view).view("<f4")
    with np.errstate(over="ignore"):
        return np.stack([records[key].astype(np.float32) for key in keys], axis=1)


def _faces(face: Element | None, runs: list[Array], positions: Array) -> Array:
    """(m, 3) indices of all faces, polygons cut into triangles."""
    if face is None or not runs:
        return np.empty((0, 3), np.uint32)
    index = next(
        (i for i, p in enumerate(face.properties) if p.name in FACE_NAMES and p.count_type), None
    )
    if index is None:
        raise SceneError(
            "the PLY file's faces have no list of vertices", accepted=" or ".join(FACE_NAMES)
        )
    parts = []
    for run in runs:
        corners = run[f"{index}"]
        if corners.shape[1] < 3:
            continue
        corners = _side_by_side(run, corners)
        _check_indices(corners, len(positions))
        if corners.shape[1] == 3:
            same_bits = corners.view(np.uint32) if corners.dtype == np.int32 else corners
            parts.append(same_bits.astype(np.uint32, copy=False))
        else:
            flat = corners.reshape(-1).astype(np.int64)
            counts = np.full(len(corners), corners.shape[1])
            parts.append(flat[triangulate(counts, positions, flat)].astype(np.uint32))
    if not parts:
        return np.empty((0, 3), np.uint32)
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _side_by_side(records: Array, corners: Array) -> Array:
    """The corners (n, k) without what is between them; of many records, where these were.

    Fresh memory would take longer to get than the corners to move.
    """
    count = len(corners)
    if count < 2 * ROWS_AT_ONCE or not corners.flags.writeable or not records.flags.contiguous:
        return np.ascontiguousarray(corners)
    places = records.view(np.uint8)
    places = places[-places.ctypes.data % corners.itemsize :]
    packed = places[: corners.nbytes].view(corners.dtype).reshape(corners.shape)
    for begin in range(0, count, ROWS_AT_ONCE):
        # No record begins before its packed corners end.
        packed[begin : begin + ROWS_AT_ONCE] = corners[begin : begin + ROWS_AT_ONCE]
    return packed


def _check_indices(corners: Array, count: int) -> None:
    low, high = corners.min(), corners.max()
    if not (low >= 0 and high < count):
        bad = low if not low >= 0 else high
        raise SceneError(f"a face refers to vertex {bad} of {count}")
    if corners.dtype.kind == "f" and not (np.mod(corners, 1) == 0).all():
        raise SceneError("a face refers to a vertex by a fraction")
