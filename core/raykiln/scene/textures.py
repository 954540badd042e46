"""Textures, and parameters that may be textures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from raykiln.arrays import FloatImage
from raykiln.scene.base import Affine2, Name, Node, NonNegative, Rgb


class TextureRef(Node):
    """A texture used for a parameter: value = factor x texture(uv)[channel]."""

    texture: Name
    """Name of an entry of `Scene.textures`."""
    channel: Literal["rgb", "r", "g", "b", "a"] = "rgb"
    """Which channel; `rgb` for a number means the mean of the three."""
    factor: NonNegative | Rgb = 1.0


ColorInput = NonNegative | Rgb | TextureRef
FloatInput = NonNegative | TextureRef


class ImageTexture(Node):
    """An image: a file beside the scene, or pixels in memory (exactly one of the two)."""

    type: Literal["image"] = "image"
    file: Name | None = None
    """Path relative to the scene file."""
    pixels: FloatImage | None = None
    """(height, width, 1..4), uint8, uint16 or float32; row 0 is the top."""
    color_space: Literal["auto", "srgb", "linear"] = "auto"
    """auto: 8- and 16-bit images used as colours are sRGB, all else is linear."""
    filter: Literal["bilinear", "nearest"] = "bilinear"
    wrap_u: Literal["repeat", "clamp", "mirror"] = "repeat"
    wrap_v: Literal["repeat", "clamp", "mirror"] = "repeat"
    uv_transform: Affine2 | None = None
    """(u, v) -> A (u, v, 1), applied before the look-up."""

    @model_validator(mode="after")
    def _one_source(self) -> ImageTexture:
        if (self.file is None) == (self.pixels is None):
            raise ValueError("an image texture takes exactly one of 'file' and 'pixels'")
        return self


class CheckerTexture(Node):
    """Checkerboard of 2 x 2 squares a unit of uv; `color0` lies at (0.25, 0.25)."""

    type: Literal["checker"] = "checker"
    color0: NonNegative | Rgb = 0.4
    color1: NonNegative | Rgb = 0.2
    uv_transform: Affine2 | None = None


Texture = Annotated[ImageTexture | CheckerTexture, Field(discriminator="type")]
