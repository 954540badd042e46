"""Wavefront OBJ meshes.

The text is taken in pieces of whole lines, and each piece is split and converted by array
operations, since files of millions of lines are common.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import Files, read_bytes
from raykiln.formats.meshes import MAX_COUNT, Array, MeshData, triangulate
from raykiln.formats.mtl import read_materials
from raykiln.scene import Scene

PIECE_BYTES = 1 << 23
MAX_MATERIALS = 1 << 16
_CONTINUED = re.compile(rb"\\[ \t\r]*\n")
_COMMENT = re.compile(rb"#[^\n]*")
_IGNORED = {b"o", b"g", b"s", b"l", b"p", b"mg", b"bevel", b"c_interp", b"d_interp", b"lod"}


@dataclass
class ObjData:
    """The content of an OBJ file, before vertices are made of index triples.

    `corners` (c, 3) are indices into positions, uvs and normals, -1 = not given; `counts` are the
    corners of each polygon and `materials` its material number.
    """

    positions: Array
    uvs: Array
    normals: Array
    corners: Array
    counts: Array
    materials: Array
    names: list[str]
    libraries: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def read(path: Path, files: Files) -> Scene:
    """The scene of an OBJ file and its material libraries: one mesh a material."""
    data = parse(read_bytes(path))
    scene = Scene(name=path.stem)
    for message in data.warnings:
        scene.warn(message)
    emissions = read_materials(scene, files, data.libraries)
    for mesh in split(data, by_material=True):
        name = mesh.material
        if name and name not in scene.materials:
            scene.warn(f"the material '{name}' is in no material library; a grey is used")
            name = None
        scene.add_mesh(
            mesh.vertices, mesh.faces, mesh.normals, mesh.uvs, name,
            name=mesh.material, emission=emissions.get(name or ""),
        )  # fmt: skip
    return scene


def read_mesh(path: Path) -> MeshData:
    """All faces of an OBJ file as one mesh, without its materials."""
    data = parse(read_bytes(path))
    mesh = next(iter(split(data, by_material=False)), None)
    if mesh is None:
        mesh = MeshData(data.positions, np.empty((0, 3), np.uint32))
    mesh.warnings += data.warnings
    return mesh


def parse(data: bytes) -> ObjData:
    """Read the lines of an OBJ file."""
    if b"\0" in data[:4096]:
        raise SceneError("not an OBJ file: it holds binary data")
    if b"\\" in data:
        data = _CONTINUED.sub(b" ", data)
    state = _Parser()
    start = 0
    while start < len(data):
        end = data.find(b"\n", min(start + PIECE_BYTES, len(data)))
        end = len(data) if end < 0 else end + 1
        state.piece(data[start:end])
        start = end
    return state.result()


class _Parser:
    def __init__(self) -> None:
        self.values: dict[bytes, list[Array]] = {b"v": [], b"vt": [], b"vn": []}
        self.totals = {b"v": 0, b"vt": 0, b"vn": 0}
        self.lines = 0
        self.corners: list[Array] = []
        self.counts: list[Array] = []
        self.materials: list[Array] = []
        self.numbers: dict[str, int] = {"": 0}
        self.current = 0
        self.libraries: list[str] = []
        self.warnings: list[str] = []

    def piece(self, text: bytes) -> None:
        """Take whole lines."""
        if b"#" in text:
            text = _COMMENT.sub(b"", text)
        words = _Words(text + b"\n")
        before = {
            key: self.totals[key] + np.cumsum(words.is_kind(key), dtype=np.int64)
            for key in self.totals
        }
        for key, width in ((b"v", 3), (b"vt", 2), (b"vn", 3)):
            values = words.numbers(key, width, self.lines)
            self.values[key].append(values)
            self.totals[key] += len(values)
        events = self._events(words)
        self._faces(words, before, events)
        self.lines += words.line_count

    def _events(self, words: _Words) -> list[tuple[int, int]]:
        """(line, material number) of each change of material in this piece."""
        events = []
        for line in words.other_lines():
            keyword, _, rest = words.line(line).partition(b" ")
            argument = rest.strip().decode("utf-8", "replace")
            if keyword == b"usemtl":
                events.append((line, self._material(argument)))
            elif keyword == b"mtllib":
                self.libraries.append(argument)
            elif keyword not in _IGNORED:
                self._warn(f"'{keyword[:20].decode('latin-1')}' lines of the OBJ file are not used")
            elif keyword in (b"l", b"p"):
                self._warn("lines and points of the OBJ file are not used")
        return events

    def _material(self, name: str) -> int:
        number = self.numbers.setdefault(name[:256], len(self.numbers))
        if number >= MAX_MATERIALS:
            raise SceneError(f"more than {MAX_MATERIALS} materials")
        return number

    def _faces(
        self, words: _Words, before: dict[bytes, Array], events: list[tuple[int, int]]
    ) -> None:
        corners, counts, lines = words.corners(self.lines)
        face_of_corner = np.repeat(np.arange(len(counts)), counts)
        for column, key in enumerate((b"v", b"vt", b"vn")):
            index = corners[:, column]
            relative = index < 0
            if relative.any():
                index[relative] += before[key][lines[face_of_corner[relative]]] + 1
                if (index[relative] <= 0).any():
                    raise SceneError(f"a face counts back before the first '{key.decode()}'")
        corners -= 1
        self.corners.append(corners)
        self.counts.append(counts)
        starts = [line for line, _ in events]
        numbers = np.array([self.current, *(number for _, number in events)])
        self.materials.append(numbers[np.searchsorted(starts, lines, side="right")])
        if events:
            self.current = events[-1][1]

    def _warn(self, message: str) -> None:
        if message not in self.warnings and len(self.warnings) < 20:
            self.warnings.append(message)

    def result(self) -> ObjData:
        """What all pieces held, with the indices checked."""
        corners = np.concatenate([np.empty((0, 3), np.int64), *self.corners])
        for column, key in enumerate((b"v", b"vt", b"vn")):
            high = int(corners[:, column].max(initial=-1))
            if high >= self.totals[key]:
                raise SceneError(
                    f"a face refers to '{key.decode()}' number {high + 1} of {self.totals[key]}"
                )
        if len(corners) and int(corners[:, 0].min()) < 0:
            raise SceneError("a face refers to vertex 0", accepted="numbers from 1, or negative")
        return ObjData(
            np.concatenate([np.empty((0, 3), np.float32), *self.values[b"v"]]),
            np.concatenate([np.empty((0, 2), np.float32), *self.values[b"vt"]]),
            np.concatenate([np.empty((0, 3), np.float32), *self.values[b"vn"]]),
            corners,
            np.concatenate([np.empty(0, np.int64), *self.counts]),
            np.concatenate([np.empty(0, np.int64), *self.materials]),
            list(self.numbers),
            self.libraries,
            self.warnings,
        )


class _Words:
    """The words of a piece of text, and which line each is in."""

    def __init__(self, text: bytes) -> None:
        self.bytes = np.frombuffer(text, np.uint8)
        self.text = text
        blank = self.bytes <= 32
        newline = np.flatnonzero(self.bytes == 10)
        self.line_count = len(newline)
        self.line_ends = newline
        self.line_starts = np.concatenate([[0], newline[:-1] + 1])
        begins = ~blank
        begins[1:] &= blank[:-1]
        self.starts = np.flatnonzero(begins)
        ends = ~blank[:-1] & blank[1:]
        self.ends = np.flatnonzero(ends) + 1
        first = np.searchsorted(self.starts, self.line_starts)
        self.word_counts = np.diff(np.concatenate([first, [len(self.starts)]]))
        self.first_words = first
        self.kinds = self._kinds()

    def _kinds(self) -> Array:
        """A code for each line: its first word if of one or two letters, else 0."""
        kinds = np.zeros(self.line_count, np.int32)
        lines = np.flatnonzero(self.word_counts)
        words = self.first_words[lines]
        length = self.ends[words] - self.starts[words]
        start = self.starts[words]
        code = self.bytes[start].astype(np.int32)
        second = self.bytes[np.minimum(start + 1, len(self.bytes) - 1)].astype(np.int32)
        code += np.where(length == 2, second << 8, 0)
        kinds[lines] = np.where(length <= 2, code, -1)
        return kinds

    def is_kind(self, key: bytes) -> Array:
        """Which lines begin with this word."""
        same: Array = self.kinds == int.from_bytes(key, "little")
        return same

    def other_lines(self) -> Iterator[int]:
        """Numbers of the lines that are neither empty nor v, vt, vn or f."""
        rest = self.kinds != 0
        for key in (b"v", b"vt", b"vn", b"f"):
            rest &= ~self.is_kind(key)
        yield from (int(i) for i in np.flatnonzero(rest))

    def line(self, number: int) -> bytes:
        """The text of a line, blanks as single spaces."""
        text = self.text[self.line_starts[number] : self.line_ends[number]]
        return b" ".join(text.split())

    def _arguments(self, key: bytes) -> tuple[Array, bytes, Array]:
        """The lines that begin with `key`, their text without it, and words on each."""
        lines = self.is_kind(key)
        chosen = np.repeat(lines, self.line_ends - self.line_starts + 1)
        kept = self.bytes[chosen].copy()
        lengths = (self.line_ends - self.line_starts + 1)[lines]
        offsets = np.cumsum(lengths) - lengths
        numbers = np.flatnonzero(lines)
        start = self.starts[self.first_words[numbers]] - self.line_starts[numbers] + offsets
        for i in range(len(key)):
            kept[start + i] = 32
        return numbers, kept.tobytes(), self.word_counts[numbers] - 1

    def numbers(self, key: bytes, width: int, line_offset: int) -> Array:
        """(n, width) float32 of the lines that begin with `key`; further numbers are left out."""
        lines, text, counts = self._arguments(key)
        if not len(lines):
            return np.empty((0, width), np.float32)
        if key == b"vt" and (counts == 1).any():
            raise _bad_line(line_offset + int(lines[np.argmax(counts == 1)]), "vt takes u and v")
        if (counts < width).any():
            line = line_offset + int(lines[np.argmax(counts < width)])
            raise _bad_line(line, f"'{key.decode()}' takes {width} numbers")
        values = _floats(text)
        if len(values) != int(counts.sum()):
            raise SceneError(f"a '{key.decode()}' line holds a word that is not a number")
        with np.errstate(over="ignore"):
            values = values.astype(np.float32)
        if (counts == width).all():
            return values.reshape(-1, width)
        starts = np.cumsum(counts) - counts
        return values[starts[:, None] + np.arange(width)]

    def corners(self, line_offset: int) -> tuple[Array, Array, Array]:
        """Corner indices (c, 3) as written, 0 = not given; corners a face; lines of the faces."""
        lines, text, counts = self._arguments(b"f")
        if not len(lines):
            return np.empty((0, 3), np.int64), counts, lines
        chars = np.frombuffer(text, np.uint8)
        slash = chars == 47
        solid = (chars > 32) & ~slash
        odd = solid & ~((chars >= 48) & (chars <= 57)) & (chars != 45) & (chars != 43)
        if odd.any():
            raise SceneError("a face holds something other than vertex numbers")
        word_begins = chars > 32
        word_begins[1:] &= chars[:-1] <= 32
        number_begins = solid.copy()
        number_begins[1:] &= ~solid[:-1]
        places = np.flatnonzero(number_begins)
        word_places = np.flatnonzero(word_begins)
        word_of = np.searchsorted(word_places, places, side="right") - 1
        slashes = np.cumsum(slash, dtype=np.int32)
        slot = slashes[places] - (slashes[word_places] - slash[word_places])[word_of]
        values = _floats(text.replace(b"/", b" "))
        if len(values) != len(places) or (slot.size and int(slot.max()) > 2):
            raise SceneError("a face holds something other than v, v/vt, v//vn or v/vt/vn")
        if not (np.abs(values) <= MAX_COUNT).all():
            raise SceneError("a face refers to a vertex number out of range")
        corners = np.zeros((len(word_places), 3), np.int64)
        corners[word_of, slot] = values.astype(np.int64)
        if (counts < 3).any():
            line = line_offset + int(lines[np.argmax(counts < 3)])
            raise _bad_line(line, "a face takes at least three vertices")
        return corners, counts, lines


def _bad_line(line: int, message: str) -> SceneError:
    return SceneError(message, pointer=f"line {line + 1}")


def _floats(text: bytes) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise SceneError("a word that is not a number in the OBJ file") from None


def split(data: ObjData, *, by_material: bool) -> Iterator[MeshData]:
    """Meshes with one index a vertex; apart by material, and by whether faces have normals."""
    if not len(data.counts):
        return
    with_normals = (
        np.minimum.reduceat(data.corners[:, 2], np.cumsum(data.counts) - data.counts) >= 0
    )
    key = data.materials * 2 if by_material else np.zeros_like(data.materials)
    if by_material or not with_normals.all():
        key = key + with_normals
    triangles = triangulate(data.counts, data.positions, data.corners[:, 0])
    polygon = np.repeat(np.arange(len(data.counts)), data.counts - 2)
    if not by_material:
        # One mesh: normals only if every face has them.
        yield _indexed(data, data.corners[triangles.reshape(-1)], bool(with_normals.all()), None)
        return
    for value in np.unique(key):
        chosen = triangles[key[polygon] == value].reshape(-1)
        name = data.names[int(value) // 2] or None
        yield _indexed(data, data.corners[chosen], bool(value % 2), name)


def _indexed(data: ObjData, corners: Array, normals: bool, material: str | None) -> MeshData:
    """A mesh whose vertices are the different index triples of `corners` (3 m, 3)."""
    has_uvs = bool((corners[:, 1] >= 0).any())
    code = corners[:, 0]
    if has_uvs:
        code = code * (len(data.uvs) + 1) + corners[:, 1] + 1
    if normals:
        if len(data.positions) * (len(data.uvs) + 1) * (len(data.normals) + 1) >= 1 << 63:
            code = np.unique(code, return_inverse=True)[1]
        code = code * (len(data.normals) + 1) + corners[:, 2] + 1
    _, first, index = np.unique(code, return_index=True, return_inverse=True)
    chosen = corners[first]
    uvs = None
    if has_uvs:
        uvs = data.uvs[np.maximum(chosen[:, 1], 0)]
        uvs[:, 1] = 1 - uvs[:, 1]
        uvs[chosen[:, 1] < 0] = 0
    return MeshData(
        data.positions[chosen[:, 0]],
        index.reshape(-1, 3).astype(np.uint32),
        data.normals[chosen[:, 2]] if normals else None,
        uvs,
        material=material,
    )
