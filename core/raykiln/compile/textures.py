"""Textures: each image is read once, and handed over once for each way its codes are read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln.compile.build import Build, Rgb, names_of, rgb_of
from raykiln.errors import SceneError
from raykiln.scene import CheckerTexture, ColorInput, FloatInput, ImageTexture, TextureRef


class Textures:
    """The textures of a scene, added to the core as they are used."""

    def __init__(self, build: Build) -> None:
        self._build = build
        self._indices: dict[tuple[str, bool], int] = {}

    def index(self, name: str, *, color: bool, pointer: str) -> int:
        """The index of a texture by name; `color` decides how 8- and 16-bit codes are read."""
        texture = self._build.scene.textures.get(name)
        if texture is None:
            raise SceneError(
                "no texture of this name",
                pointer=pointer,
                found=name,
                accepted=names_of(self._build.scene.textures),
            )
        if isinstance(texture, CheckerTexture):
            color = False
        if (name, color) not in self._indices:
            self._indices[name, color] = self._add(name, texture, color)
        return self._indices[name, color]

    def _add(self, name: str, texture: ImageTexture | CheckerTexture, color: bool) -> int:
        if isinstance(texture, CheckerTexture):
            return self._build.core.add_checker_texture(
                rgb_of(texture.color0), rgb_of(texture.color1), texture.uv_transform
            )
        pixels = self._build.image(texture, f"/textures/{name}")
        srgb = texture.color_space == "srgb" or (
            texture.color_space == "auto" and color and pixels.dtype != np.float32
        )
        if srgb and pixels.dtype != np.uint8:
            pixels, srgb = linear_of_srgb(pixels), False
        return self._build.core.add_image_texture(
            pixels,
            srgb=srgb,
            filter=texture.filter,
            wrap_u=texture.wrap_u,
            wrap_v=texture.wrap_v,
            uv_transform=texture.uv_transform,
        )

    def color(self, value: ColorInput, pointer: str) -> tuple[Rgb, int, str]:
        """A colour parameter as the core takes it: factor, texture or -1, channel."""
        if isinstance(value, TextureRef):
            index = self.index(value.texture, color=True, pointer=f"{pointer}/texture")
            return rgb_of(value.factor), index, value.channel
        return rgb_of(value), -1, "rgb"

    def number(self, value: FloatInput, pointer: str) -> tuple[float, int, str]:
        """A number parameter as the core takes it."""
        if isinstance(value, TextureRef):
            index = self.index(value.texture, color=False, pointer=f"{pointer}/texture")
            return float(np.mean(value.factor)), index, value.channel
        return float(value), -1, "rgb"


def linear_of_srgb(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Integer or float pixels decoded with the sRGB curve (IEC 61966-2-1); alpha as it is."""
    x = pixels.astype(np.float32)
    if pixels.dtype != np.float32:
        x /= np.iinfo(pixels.dtype).max
    linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)
    if pixels.shape[2] in (2, 4):
        linear[..., -1] = x[..., -1]
    return np.ascontiguousarray(linear)
