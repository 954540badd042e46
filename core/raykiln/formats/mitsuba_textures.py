"""Mitsuba colours and textures as inputs of our materials and lights."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.mitsuba_objects import Blackbody, Document, MitsubaObject, Rgb, Spectrum
from raykiln.formats.names import unique_name
from raykiln.formats.spectra import (
    Color,
    Role,
    rgb_of_blackbody,
    rgb_of_constant,
    rgb_of_samples,
)
from raykiln.scene import CheckerTexture, ImageTexture, TextureRef

TEXTURE_TAGS = ("texture", "spectrum")
# Images of these kinds hold linear values; all others are sRGB unless `raw`.
_LINEAR_FILES = {".exr", ".hdr", ".rgbe", ".pfm"}
_WRAPS = {"repeat": "repeat", "clamp": "clamp", "mirror": "mirror"}
_SPECTRA = ("uniform", "regular", "irregular", "d65", "blackbody", "srgb")


class Context:
    """What the builders of materials, lights, shapes and cameras share."""

    def __init__(self, document: Document) -> None:
        self.document, self.scene = document, document.scene
        self._textures: dict[int, str | None] = {}

    def warn(self, owner: MitsubaObject, message: str) -> None:
        """Note something at a place of the file that is not supported."""
        self.document.warn(f"{owner.pointer}: {message}")

    def warn_unused(self, owner: MitsubaObject) -> None:
        """Name the properties of an object that nothing asked for."""
        for name in owner.unused():
            self.warn(owner, f"'{name}' is not supported and not used")

    def color(self, owner: MitsubaObject, name: str, default: float, role: Role) -> Any:
        """A colour input: a number, a colour, or a texture."""
        nested = owner.child(name)
        if nested is None:
            value = self._color_value(owner, owner.properties.get(name, default), role)
            return self._in_range(owner, name, value, role)
        if nested.type in _SPECTRA:
            return self._in_range(owner, name, self._spectrum_object(nested, role), role)
        return self._texture_ref(nested, role) or default

    def constant_color(self, owner: MitsubaObject, name: str, default: float, role: Role) -> Any:
        """Like `color`, where a texture is not supported."""
        value = self.color(owner, name, default, role)
        if isinstance(value, TextureRef):
            self.warn(owner, f"a texture for '{name}' is not supported; {default} is used")
            return default
        return value

    def value(self, owner: MitsubaObject, name: str, default: float) -> Any:
        """A number input: a number or a texture."""
        value = self.color(owner, name, default, "index")
        return sum(value) / 3 if isinstance(value, tuple) else value

    def texture(self, owner: MitsubaObject) -> str | None:
        """The name of the scene's texture for a texture object; None if it is not supported."""
        key = id(owner)
        if key not in self._textures:
            self._textures[key] = self._add_texture(owner)
        return self._textures[key]

    def _in_range(self, owner: MitsubaObject, name: str, value: Any, role: Role) -> Any:
        values = value if isinstance(value, tuple) else (value,)
        if min(values) < 0:
            raise SceneError(f"'{name}' must not be negative", pointer=owner.pointer, found=value)
        if role == "reflectance" and max(values) > 1:
            self.warn(owner, f"'{name}' is over 1 and was clamped")
            return tuple(min(v, 1.0) for v in values) if isinstance(value, tuple) else 1.0
        return value

    def _color_value(self, owner: MitsubaObject, value: Any, role: Role) -> float | Color:
        if isinstance(value, Rgb):
            return value.values
        if isinstance(value, Spectrum):
            if not value.wavelengths_nm:
                constant = rgb_of_constant(value.values[0], role)
                return constant[0] if role != "emission" else constant
            return self._samples(owner, value.wavelengths_nm, value.values, role)
        if isinstance(value, Blackbody):
            return rgb_of_blackbody(value.temperature_k, value.scale)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        raise SceneError("not a colour", pointer=owner.pointer, found=value)

    def _samples(
        self, owner: MitsubaObject, wavelengths: list[float], values: list[float], role: Role
    ) -> Color:
        try:
            return rgb_of_samples(wavelengths, values, role)
        except SceneError as error:
            error.pointer = owner.pointer
            raise

    def _spectrum_object(self, owner: MitsubaObject, role: Role) -> float | Color:
        if owner.type == "uniform":
            # Unlike <spectrum value>, a uniform spectrum plugin is grey in Mitsuba's RGB modes.
            return owner.float("value", 1.0)
        if owner.type == "d65":
            return owner.float("scale", 1.0)
        if owner.type == "srgb":
            return self._color_value(owner, owner.get("color", Rgb, Rgb((0.5, 0.5, 0.5))), role)
        if owner.type == "blackbody":
            return rgb_of_blackbody(owner.float("temperature", 5000.0), owner.float("scale", 1.0))
        values = _listed(owner, "values")
        if owner.type == "irregular":
            return self._samples(owner, _listed(owner, "wavelengths"), values, role)
        low, high = owner.float("wavelength_min", 360.0), owner.float("wavelength_max", 830.0)
        return self._samples(owner, np.linspace(low, high, len(values)).tolist(), values, role)

    def _texture_ref(self, owner: MitsubaObject, role: Role) -> TextureRef | None:
        if owner.type == "scale":
            inner = owner.tagged(*TEXTURE_TAGS)
            factor = self.constant_color(owner, "scale", 1.0, "index")
            found = self._texture_ref(inner[0], role) if inner else None
            return found.model_copy(update={"factor": factor}) if found else None
        name = self.texture(owner)
        return TextureRef(texture=name) if name else None

    def _add_texture(self, owner: MitsubaObject) -> str | None:
        if owner.type == "bitmap":
            texture: Any = self._bitmap(owner)
        elif owner.type == "checkerboard":
            texture = CheckerTexture(
                color0=self.constant_color(owner, "color0", 0.4, "reflectance"),
                color1=self.constant_color(owner, "color1", 0.2, "reflectance"),
                uv_transform=uv_transform(owner),
            )
        else:
            self.warn(owner, "this texture is not supported; a plain colour is used")
            return None
        name = unique_name(owner.id or f"texture_line_{owner.line}", self.scene.textures)
        self.scene.textures[name] = texture
        return name

    def _bitmap(self, owner: MitsubaObject) -> ImageTexture:
        name = owner.string("filename", "")
        path = self.document.resolve(name, owner, f"{owner.pointer}, filename")
        raw = owner.boolean("raw", False)
        gamma = owner.float("gamma", 0.0)
        linear = raw or gamma == 1 or PurePosixPath(path.name.lower()).suffix in _LINEAR_FILES
        if gamma not in (0.0, 1.0, -1.0, 2.2):
            self.warn(owner, "a gamma other than 1 and sRGB is not supported; sRGB is used")
        wrap = owner.string("wrap_mode", "repeat")
        if wrap not in _WRAPS:
            self.warn(owner, f"the wrap mode '{wrap}' is not supported; repeat is used")
        return ImageTexture.model_validate(
            {
                "file": self.document.files.relative(path),
                "color_space": "linear" if linear else "srgb",
                "filter": "nearest" if owner.string("filter_type", "") == "nearest" else "bilinear",
                "wrap_u": _WRAPS.get(wrap, "repeat"),
                "wrap_v": _WRAPS.get(wrap, "repeat"),
                "uv_transform": uv_transform(owner),
            }
        )


def uv_transform(owner: MitsubaObject) -> Any:
    """The rows of a texture's `to_uv` that act on (u, v, 1), or None."""
    matrix = owner.matrix("to_uv")
    if matrix is None:
        return None
    return tuple(tuple(float(x) for x in matrix[row, [0, 1, 3]]) for row in (0, 1))


def _listed(owner: MitsubaObject, name: str) -> list[float]:
    text = owner.string(name, "")
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        raise SceneError(f"'{name}' takes numbers", pointer=owner.pointer, found=text) from None
