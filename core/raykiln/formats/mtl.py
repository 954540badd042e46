"""Wavefront MTL material libraries."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from raykiln.errors import SceneError
from raykiln.formats.files import MAX_TEXT_BYTES, Files
from raykiln.scene import (
    Dielectric,
    Diffuse,
    Emission,
    ImageTexture,
    Material,
    NormalMap,
    Principled,
    Rgb,
    Scene,
    TextureRef,
)

# Options of map statements and how many words follow each at most.
_MAP_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-texres": 1, "-bm": 1, "-imfchan": 1,
    "-type": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3,
}  # fmt: skip
_UNUSED = {"ka", "map_ka", "sharpness", "tf", "map_ks", "map_ns", "refl", "disp", "decal", "aniso",
           "anisor", "pc", "pcr", "ps", "map_ps"}  # fmt: skip
_SILENT = {"ka", "map_ka", "sharpness", "refl"}


@dataclass
class Entry:
    """The statements of one material, by lower-case keyword."""

    name: str
    values: dict[str, list[str]] = field(default_factory=dict)
    folder: Path | None = None


def read_materials(scene: Scene, files: Files, libraries: list[str]) -> dict[str, Emission]:
    """Add the materials of MTL files to a scene; returns the emission of those that glow."""
    emissions: dict[str, Emission] = {}
    for library in dict.fromkeys(libraries):
        try:
            path = files.resolve(library, "mtllib")
        except SceneError as error:
            if error.accepted:
                raise
            scene.warn(f"the material library '{library}' does not exist; greys are used")
            continue
        text = files.read(path, limit=MAX_TEXT_BYTES).decode("utf-8", "replace")
        for entry in parse(text, path.parent):
            builder = _Builder(scene, files, entry)
            scene.materials[entry.name] = builder.material()
            emission = builder.emission()
            if emission is not None:
                emissions[entry.name] = emission
    return emissions


def parse(text: str, folder: Path) -> list[Entry]:
    """The materials of an MTL file, in order."""
    entries: list[Entry] = []
    for line in text.replace("\\\n", " ").splitlines():
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].lower() == "newmtl":
            entries.append(Entry((" ".join(words[1:]) or "unnamed")[:256], folder=folder))
        elif entries:
            entries[-1].values[words[0].lower()] = words[1:]
    return entries


class _Builder:
    """Makes one of our materials from the statements of one of theirs."""

    def __init__(self, scene: Scene, files: Files, entry: Entry) -> None:
        self.scene, self.files, self.entry = scene, files, entry

    def material(self) -> Material:
        """A clear dielectric, a diffuse, or a principled material."""
        self._warn_unused()
        illum = int(self._number("illum", 2))
        opacity = self._opacity()
        ior = self._number("ni", 1.5)
        pbr = any(key in self.entry.values for key in ("pr", "pm", "map_pr", "map_pm"))
        if illum in (4, 6, 7, 9) and not pbr:
            tint = self._color("tf", (1.0, 1.0, 1.0))
            return Dielectric(int_ior=max(ior, 1.0), specular_transmittance=tint)
        base = self._color_or_map("kd", "map_kd", (0.8, 0.8, 0.8))
        specular = self._color("ks", (0.0, 0.0, 0.0))
        if not pbr and (illum < 2 or max(specular) == 0):
            return Diffuse(reflectance=base, opacity=opacity, normal_map=self._normal_map())
        roughness, metallic = self._roughness(pbr), self._value_or_map("pm", "map_pm", 0.0)
        if illum == 3 and not pbr:
            # Blinn-Phong with a mirror reflection: a metal of the specular colour.
            base, metallic = specular, 1.0
        return Principled(
            base_color=base,
            metallic=metallic,
            roughness=roughness,
            ior=min(max(ior, 1.0), 10.0),
            opacity=opacity,
            normal_map=self._normal_map(),
        )

    def emission(self) -> Emission | None:
        """The radiance that Ke gives, or None for none."""
        color = self._color("ke", (0.0, 0.0, 0.0))
        image = self._texture("map_ke", "srgb")
        if image is not None:
            return Emission(radiance=TextureRef(texture=image, factor=color if any(color) else 1.0))
        return Emission(radiance=color) if any(color) else None

    def _roughness(self, pbr: bool) -> float | TextureRef:
        if pbr:
            return self._value_or_map("pr", "map_pr", 0.5)
        # A Phong lobe of exponent n is about as wide as a microfacet alpha of sqrt(2 / (n + 2)).
        exponent = max(self._number("ns", 10.0), 0.0)
        return math.sqrt(math.sqrt(2 / (exponent + 2)))

    def _opacity(self) -> float | TextureRef:
        dissolve = 1 - self._number("tr", 0.0) if "tr" in self.entry.values else 1.0
        dissolve = self._number("d", dissolve)
        factor = min(max(dissolve, 0.0), 1.0)
        image = self._texture("map_d", "linear")
        if image is None:
            return factor
        return TextureRef(texture=image, channel="r", factor=factor if factor else 1.0)

    def _normal_map(self) -> NormalMap | None:
        for key in ("norm", "map_kn"):
            image = self._texture(key, "linear")
            if image is not None:
                return NormalMap(texture=image)
        if {"map_bump", "bump"} & self.entry.values.keys():
            self._warn("the bump map is not supported and not used")
        return None

    def _color_or_map(self, key: str, map_key: str, default: Rgb) -> Rgb | TextureRef:
        color = self._color(key, default)
        image = self._texture(map_key, "srgb")
        if image is None:
            return color
        # Exporters write a black or grey Kd beside a map that is meant as it is.
        return TextureRef(texture=image, factor=color if any(color) else 1.0)

    def _value_or_map(self, key: str, map_key: str, default: float) -> float | TextureRef:
        image = self._texture(map_key, "linear")
        if image is not None:
            return TextureRef(texture=image, channel="r")
        return min(max(self._number(key, default), 0.0), 1.0)

    def _texture(self, key: str, color_space: str) -> str | None:
        words = self.entry.values.get(key)
        if not words:
            return None
        name = self._map_file(words)
        if name is None:
            return None
        pointer = f"material '{self.entry.name}', {key}"
        path = self.files.resolve(name, pointer, folder=self.entry.folder)
        relative = self.files.relative(path)
        label = f"{relative}:{color_space}"[-256:]
        if label not in self.scene.textures:
            self.scene.textures[label] = ImageTexture.model_validate(
                {"file": relative, "color_space": color_space}
            )
        return label

    def _map_file(self, words: list[str]) -> str | None:
        """The file name that follows the options of a map statement."""
        i = 0
        while i < len(words) and words[i].lower() in _MAP_OPTIONS:
            option = words[i].lower()
            if option in ("-o", "-s", "-t", "-mm", "-clamp"):
                self._warn(f"the texture option '{option}' is not supported and not used")
            i += 1
            most = i + _MAP_OPTIONS[option]
            numeric = most - i > 1
            while i < min(most, len(words) - 1) and (not numeric or _is_number(words[i])):
                i += 1
        return " ".join(words[i:]) or None

    def _color(self, key: str, default: Rgb) -> Rgb:
        words = self.entry.values.get(key)
        if not words:
            return default
        if words[0].lower() in ("spectral", "xyz"):
            self._warn(f"'{key} {words[0]}' is not supported; a default is used")
            return default
        numbers = [max(self._float(w, key), 0.0) for w in words[:3]]
        if len(numbers) < 3:
            numbers = [numbers[0]] * 3
        return numbers[0], numbers[1], numbers[2]

    def _number(self, key: str, default: float) -> float:
        words = [w for w in self.entry.values.get(key, []) if w.lower() != "-halo"]
        return self._float(words[0], key) if words else default

    def _float(self, word: str, key: str) -> float:
        if not _is_number(word):
            raise SceneError(
                "not a number", pointer=f"material '{self.entry.name}', {key}", found=word
            )
        return float(word)

    def _warn_unused(self) -> None:
        for key in sorted(self.entry.values.keys() & _UNUSED - _SILENT):
            if key != "tf" or int(self._number("illum", 2)) not in (4, 6, 7, 9):
                self._warn(f"'{key}' is not supported and not used")

    def _warn(self, message: str) -> None:
        self.scene.warn(f"material '{self.entry.name}': {message}")


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
