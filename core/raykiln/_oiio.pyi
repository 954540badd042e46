"""The compiled reader of what is left to OpenImageIO; `raykiln._image` imports it when needed."""

import os
from typing import Any, TypeAlias

from numpy.typing import NDArray
from typing_extensions import Buffer

_Source: TypeAlias = Buffer | os.PathLike[str] | str

def read_image(source: _Source) -> NDArray[Any]:
    """The colours of a JPEG, TIFF or WebP file; as `raykiln._image.read_image`."""

def read_channels(source: _Source) -> dict[str, Any]:
    """All channels of such a file; as `raykiln._image.read_channels`."""
