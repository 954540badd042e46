"""Mitsuba objects: plugins with typed properties, made of XML with parameters and references."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import MAX_TEXT_BYTES, Files, scene_errors
from raykiln.formats.mitsuba_transforms import Matrix, number, numbers, transform, vector
from raykiln.formats.mitsuba_upgrade import upgrade, version_of
from raykiln.formats.mitsuba_xml import XmlNode, parse_xml
from raykiln.formats.spectra import read_spd, rgb_of_srgb
from raykiln.scene import Scene

MAX_INCLUDE_DEPTH = 15
MAX_INCLUDES = 1000
MAX_SUBSTITUTED = 1 << 16
OBJECT_TAGS = {
    "scene", "integrator", "sensor", "film", "sampler", "rfilter", "emitter", "shape", "bsdf",
    "texture", "medium", "phase", "volume", "subsurface",
}  # fmt: skip
_PARAMETER = re.compile(r"(\\?)\$(\w+)")


@dataclass
class Rgb:
    """A colour: linear Rec.709."""

    values: tuple[float, float, float]


@dataclass
class Spectrum:
    """A spectrum: one value for all wavelengths (no wavelengths), or samples."""

    wavelengths_nm: list[float]
    values: list[float]


@dataclass
class Blackbody:
    """Planck's radiance."""

    temperature_k: float
    scale: float


Property = bool | int | float | str | list[float] | Matrix | Rgb | Spectrum | Blackbody


@dataclass
class MitsubaObject:
    """A plugin and what it was given."""

    tag: str
    type: str
    id: str | None
    line: int
    folder: Path
    properties: dict[str, Property] = field(default_factory=dict)
    children: list[tuple[str, MitsubaObject]] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    @property
    def pointer(self) -> str:
        """Where it stands and what it is, for errors and warnings."""
        label = f" '{self.id}'" if self.id else ""
        return f"line {self.line}, {self.tag} {self.type}{label}".rstrip()

    def get(self, name: str, kind: Any, default: Any) -> Any:
        """A property of the given type; `default` if it was not given."""
        self.used.add(name)
        value = self.properties.get(name)
        if value is None:
            return default
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise SceneError(
                f"the property '{name}' is of another type than it takes",
                pointer=self.pointer,
                found=value,
            )
        return value

    def float(self, name: str, default: float) -> float:
        """A number."""
        return float(self.get(name, (float, int), default))

    def integer(self, name: str, default: int) -> int:
        """A whole number."""
        value = self.get(name, (int, float), default)
        if value != int(value):
            raise SceneError(f"'{name}' takes a whole number", pointer=self.pointer, found=value)
        return int(value)

    def boolean(self, name: str, default: bool) -> bool:
        """True or false."""
        return bool(self.get(name, bool, default))

    def string(self, name: str, default: str) -> str:
        """A text."""
        return str(self.get(name, str, default))

    def matrix(self, name: str) -> Matrix | None:
        """A transform, or None."""
        value: Matrix | None = self.get(name, np.ndarray, None)
        return value

    def child(self, name: str) -> MitsubaObject | None:
        """The nested object of this property name."""
        self.used.add(name)
        return next((child for key, child in self.children if key == name), None)

    def tagged(self, *tags: str) -> list[MitsubaObject]:
        """The nested objects of these tags."""
        return [child for _, child in self.children if child.tag in tags]

    def unused(self) -> list[str]:
        """Names of properties that nothing asked for."""
        names = {*self.properties, *(key for key, _ in self.children if key)}
        return sorted(names - self.used)


class Document:
    """All objects of a scene file and of the files that it includes."""

    def __init__(self, files: Files) -> None:
        self.files = files
        self.parameters: dict[str, str] = {}
        self.ids: dict[str, MitsubaObject] = {}
        self.references: list[tuple[MitsubaObject, int, str, int]] = []
        self.includes = 0
        self.scene = Scene()
        self.folders: list[Path] = [files.folder]

    def read(self, path: Path, data: bytes) -> MitsubaObject:
        """The scene object of a file."""
        root = self._parsed(data)
        if root.tag != "scene":
            raise SceneError("not a Mitsuba scene", pointer=root.pointer, found=f"<{root.tag}>")
        scene = self._object(root, path.resolve().parent, 0)
        for parent, index, identifier, line in self.references:
            if identifier not in self.ids:
                raise SceneError("a reference to nothing", pointer=f"line {line}", found=identifier)
            parent.children[index] = (parent.children[index][0], self.ids[identifier])
        _refuse_cycles(scene)
        return scene

    def resolve(self, name: str, owner: MitsubaObject, pointer: str) -> Path:
        """A file named by an object: beside its own file, then beside the scene's."""
        failure: SceneError | None = None
        for folder in dict.fromkeys([owner.folder, *self.folders]):
            try:
                return self.files.resolve(name, pointer, folder=folder)
            except SceneError as error:
                failure = failure or error
        assert failure is not None
        raise failure

    def warn(self, message: str) -> None:
        """Note something that is not supported."""
        self.scene.warn(message)

    def _parsed(self, data: bytes) -> XmlNode:
        root = parse_xml(data)
        if version_of(root) < (2,):
            upgrade(root)
        return root

    def _object(self, node: XmlNode, folder: Path, depth: int) -> MitsubaObject:
        made = MitsubaObject(
            node.tag, node.attributes.get("type", ""), node.attributes.get("id"), node.line, folder
        )
        if made.id is not None:
            if made.id in self.ids:
                raise SceneError("an id is given twice", pointer=node.pointer, found=made.id)
            self.ids[made.id] = made
        for child in node.children:
            self._child(made, child, folder, depth)
        return made

    def _child(self, made: MitsubaObject, node: XmlNode, folder: Path, depth: int) -> None:
        self._substitute(node)
        name = node.attributes.get("name", "")
        if node.tag in OBJECT_TAGS or (node.tag == "spectrum" and "type" in node.attributes):
            made.children.append((name, self._object(node, folder, depth)))
        elif node.tag == "ref":
            identifier = node.attributes.get("id", "")
            self.references.append((made, len(made.children), identifier, node.line))
            made.children.append((name, made))
        elif node.tag == "default":
            self.parameters.setdefault(name, node.attributes.get("value", ""))
        elif node.tag == "alias":
            self._alias(node)
        elif node.tag == "include":
            self._include(made, node, folder, depth)
        elif node.tag == "path":
            self._add_folder(node, folder)
        else:
            made.properties[name] = self._property(node, made)

    def _alias(self, node: XmlNode) -> None:
        source, target = node.attributes.get("id", ""), node.attributes.get("as", "")
        if source not in self.ids or target in self.ids or not target:
            raise SceneError("an alias of nothing, or to a taken id", pointer=node.pointer)
        self.ids[target] = self.ids[source]

    def _add_folder(self, node: XmlNode, folder: Path) -> None:
        name = node.attributes.get("value", "")
        path = (folder / name).resolve()
        if not path.is_relative_to(self.files.root) or not path.is_dir():
            raise SceneError(
                "not a folder inside the scene's folder", pointer=node.pointer, found=name
            )
        self.folders.insert(0, path)

    def _include(self, made: MitsubaObject, node: XmlNode, folder: Path, depth: int) -> None:
        self.includes += 1
        if depth >= MAX_INCLUDE_DEPTH or self.includes > MAX_INCLUDES:
            raise SceneError("too many (nested) includes", pointer=node.pointer)
        path = self.resolve(node.attributes.get("filename", ""), made, node.pointer)
        with scene_errors(path):
            root = self._parsed(self.files.read(path, limit=MAX_TEXT_BYTES))
            if root.tag == "scene":
                for child in root.children:
                    self._child(made, child, path.parent, depth + 1)
            else:
                self._child(made, root, path.parent, depth + 1)

    def _substitute(self, node: XmlNode) -> None:
        """Put parameters in place of `$name` in the attributes of an element and a transform's."""
        for key, text in node.attributes.items():
            if "$" in text:
                node.attributes[key] = _PARAMETER.sub(lambda m: self._value(m, node), text)
                if len(node.attributes[key]) > MAX_SUBSTITUTED:
                    raise SceneError("a parameter makes too long a text", pointer=node.pointer)
        if node.tag in ("transform", "animation"):
            for child in node.children:
                self._substitute(child)

    def _value(self, match: re.Match[str], node: XmlNode) -> str:
        escaped, name = match.groups()
        if escaped:
            return "$" + name
        # "$namepx" may mean the parameter "name" followed by letters: the longest one counts.
        for end in range(len(name), 0, -1):
            if name[:end] in self.parameters:
                return self.parameters[name[:end]] + name[end:]
        raise SceneError("a parameter without a default", pointer=node.pointer, found=f"${name}")

    def _property(self, node: XmlNode, owner: MitsubaObject) -> Property:
        maker = _MAKERS.get(node.tag)
        if maker is not None:
            value: Property = maker(node)
            return value
        if node.tag == "spectrum":
            return self._spectrum(node, owner)
        if node.tag == "animation":
            self.warn(f"{node.pointer}: motion is not supported; the first transform is used")
            steps = [child for child in node.children if child.tag == "transform"]
            return transform(steps[0] if steps else node)
        raise SceneError("not a known element", pointer=node.pointer, found=f"<{node.tag}>")

    def _spectrum(self, node: XmlNode, owner: MitsubaObject) -> Property:
        if "filename" in node.attributes:
            path = self.resolve(node.attributes["filename"], owner, node.pointer)
            with scene_errors(path):
                return Spectrum(*read_spd(self.files.read(path, limit=MAX_TEXT_BYTES)))
        text = node.attributes.get("value", "").strip()
        if ":" not in text:
            if text.startswith("#"):
                return _rgb(node)
            values = numbers(text, node.pointer)
            if len(values) == 3:
                return Rgb((values[0], values[1], values[2]))
            return Spectrum([], [number(text, node.pointer)])
        wavelengths, samples = [], []
        for pair in text.replace(",", " ").split():
            wavelength, _, sample = pair.partition(":")
            wavelengths.append(number(wavelength, node.pointer))
            samples.append(number(sample, node.pointer))
        return Spectrum(wavelengths, samples)


def _boolean(node: XmlNode) -> bool:
    text = node.attributes.get("value", "").lower()
    if text not in ("true", "false"):
        raise SceneError(
            "not a truth value", pointer=node.pointer, found=text, accepted="true false"
        )
    return text == "true"


def _integer(node: XmlNode) -> int:
    text = node.attributes.get("value", "")
    try:
        return int(text)
    except ValueError:
        raise SceneError("not a whole number", pointer=node.pointer, found=text) from None


def _float(node: XmlNode) -> float:
    return number(node.attributes.get("value", ""), node.pointer)


def _string(node: XmlNode) -> str:
    return node.attributes.get("value", "")


def _rgb(node: XmlNode) -> Rgb:
    text = node.attributes.get("value", "").strip()
    if text.startswith("#"):
        return _srgb(node)
    values = numbers(text, node.pointer)
    if len(values) not in (1, 3):
        raise SceneError("a colour takes one or three numbers", pointer=node.pointer, found=text)
    r, g, b = values * 3 if len(values) == 1 else values
    return Rgb((r, g, b))


def _srgb(node: XmlNode) -> Rgb:
    text = node.attributes.get("value", "").strip()
    if text.startswith("#"):
        if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
            raise SceneError("not a colour", pointer=node.pointer, found=text, accepted="#rrggbb")
        return Rgb(rgb_of_srgb([int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]))
    values = numbers(text, node.pointer)
    if len(values) not in (1, 3):
        raise SceneError("a colour takes one or three numbers", pointer=node.pointer, found=text)
    return Rgb(rgb_of_srgb(values * 3 if len(values) == 1 else values))


def _blackbody(node: XmlNode) -> Blackbody:
    temperature = node.attributes.get("temperature", "").rstrip("kK ")
    scale = node.attributes.get("scale", "1")
    return Blackbody(number(temperature, node.pointer), number(scale, node.pointer))


_MAKERS: dict[str, Any] = {
    "boolean": _boolean,
    "integer": _integer,
    "float": _float,
    "string": _string,
    "point": vector,
    "vector": vector,
    "rgb": _rgb,
    "srgb": _srgb,
    "blackbody": _blackbody,
    "transform": transform,
}


def _refuse_cycles(root: MitsubaObject) -> None:
    """Raise if an object contains itself by references."""
    done: set[int] = set()
    path: list[tuple[MitsubaObject, Iterator[tuple[str, MitsubaObject]]]] = []
    path.append((root, iter(root.children)))
    active = {id(root)}
    while path:
        current, children = path[-1]
        step = next(children, None)
        if step is None:
            path.pop()
            active.discard(id(current))
            done.add(id(current))
            continue
        child = step[1]
        if id(child) in active:
            raise SceneError("an object refers to itself", pointer=child.pointer)
        if id(child) not in done:
            active.add(id(child))
            path.append((child, iter(child.children)))
