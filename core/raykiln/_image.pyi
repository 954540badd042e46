"""The compiled reader and writer of image files; use it through `raykiln.image`."""

import os
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer

_Source: TypeAlias = Buffer | os.PathLike[str] | str
_Metadata: TypeAlias = Sequence[tuple[str, int | float | str]]

def read_image(source: _Source) -> NDArray[Any]:
    """The colours of a file: (height, width, 1..4), uint8, uint16 or float32."""

def read_channels(source: _Source) -> dict[str, Any]:
    """All channels of a file: `pixels`, `names`, `window` and `metadata`."""

def encode_exr(
    channels: Sequence[tuple[str, NDArray[np.float32], bool]],
    window: tuple[int, int, int, int],
    metadata: _Metadata,
) -> NDArray[np.uint8]:
    """The bytes of an EXR: (name, float32 plane of (height, width), stored as half) each."""

def encode_png(
    pixels: NDArray[np.uint8] | NDArray[np.uint16], metadata: _Metadata
) -> NDArray[np.uint8]:
    """The bytes of a PNG of C-contiguous (height, width, channels) pixels."""
