"""Image files in and out; the compiled core does the coding."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from raykiln.errors import ImageError, shorten
from raykiln.image.atomic import write_atomically
from raykiln.image.plain_exr import laid_out

Source = str | os.PathLike[str] | bytes | bytearray | memoryview
Metadata = Mapping[str, str | int | float]
Window = tuple[int, int, int, int]

# Layer -> (prefix of its channels, suffixes); other names keep theirs.
_PREFIXES = {"beauty": "", "normal": "N"}
_SUFFIXES = {
    "beauty": {1: ["Y"], 2: ["Y", "A"]},
    "normal": {3: ["X", "Y", "Z"]},
    "position": {3: ["X", "Y", "Z"]},
    "depth": {1: ["Z"]},
    "uv": {2: ["U", "V"]},
}
_COLOUR = {1: [""], 2: ["R", "G"], 3: ["R", "G", "B"], 4: ["R", "G", "B", "A"]}
_ORDER = {name: i for i, name in enumerate(["", "R", "G", "B", "X", "Y", "Z", "U", "V", "A"])}
# 16 bits would lose what these layers are for.
_ALWAYS_FLOAT = {"depth", "position", "uv", "variance"}
_LAYER_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,99}")
_METADATA_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_:.-]{0,78}")
# Names that say how the file is coded, which the caller does not decide.
_CODING_NAMES = {
    *("compression", "datetime", "channels", "chromaticities", "software", "version"),
    *("type", "tiles", "lineorder", "chunkcount", "datawindow", "displaywindow"),
}
# What the reader tells about the file in general rather than what a writer put there.
_READER_NAMES = re.compile(
    r"oiio:.*|openexr:.*|compression|PixelAspectRatio|screenWindow.*|chromaticities|type|name"
)


def read_image(source: Source) -> npt.NDArray[Any]:
    """Read an image file, recognised by its content: EXR, PNG, JPEG, HDR, TIFF, WebP, TGA, BMP.

    Parameters
    ----------
    source
        A path, or the bytes of a file.

    Returns
    -------
    ndarray
        Shape (height, width, channels) with 1 to 4 channels (Y, YA, RGB, RGBA).  uint8 and
        uint16 stay as stored (display-encoded, straight alpha); all else is float32.

    Raises
    ------
    ImageError
        If the file is missing, damaged, too large (65536 a side, 2^28 pixels, 4 GiB) or of
        another kind.
    """
    pixels: npt.NDArray[Any] = _named(source, "read_image")
    return pixels


def read_exr_layers(source: Source) -> dict[str, npt.NDArray[np.float32]]:
    """The layers of an image file by name: what `write_exr` was given.

    Returns
    -------
    dict
        Layer name -> float32 array, (height, width) for one channel, else
        (height, width, channels).  ``beauty`` is the layer of R, G, B.
    """
    channels = _named(source, "read_channels")
    pixels, names = channels["pixels"], channels["names"]
    groups: dict[str, list[tuple[str, int]]] = {}
    for index, name in enumerate(names):
        layer, suffix = _layer_of(name)
        groups.setdefault(layer, []).append((suffix, index))
    return {layer: _take(pixels, members) for layer, members in groups.items()}


def read_exr_metadata(source: Source) -> dict[str, str | int | float]:
    """The metadata that the writer of an image file put into it."""
    metadata = _named(source, "read_channels")["metadata"]
    return {name: v for name, v in metadata.items() if not _READER_NAMES.fullmatch(name)}


def encode_exr(
    layers: Mapping[str, npt.ArrayLike],
    *,
    half: bool = False,
    metadata: Metadata | None = None,
    window: Window | None = None,
    compress: bool = True,
) -> memoryview:
    """The bytes of an OpenEXR file; see `write_exr`."""
    channels: list[tuple[str, npt.NDArray[np.float32], bool]] = []
    for layer, values in layers.items():
        stored_half = half and layer not in _ALWAYS_FLOAT
        channels += [(n, plane, stored_half) for n, plane in _channels_of(layer, values)]
    names = [name for name, _, _ in channels]
    for name in names:
        if names.count(name) > 1:
            raise ImageError(f"two layers want the channel {name!r}")
    box = (0, 0, 0, 0) if window is None else window
    checked = _checked_metadata(metadata)
    if compress or not channels or any(p.shape != channels[0][1].shape for _, p, _ in channels):
        data: memoryview = _native().encode_exr(channels, box, checked).data
        return data
    height, width = channels[0][1].shape
    whole = (*box[:2], box[2] or width, box[3] or height)
    corner = [(name, plane[:1, :1], stored_half) for name, plane, stored_half in channels]
    return laid_out(_native().encode_exr(corner, whole, checked).data, channels)


def write_exr(
    path: str | os.PathLike[str],
    layers: Mapping[str, npt.ArrayLike],
    *,
    half: bool = False,
    metadata: Metadata | None = None,
    window: Window | None = None,
    compress: bool = True,
) -> None:
    """Write an OpenEXR file of named layers: linear Rec.709, ZIP, the same bytes every time.

    Parameters
    ----------
    path
        Where to; an old file is replaced only by a whole new one.
    layers
        Name -> array of shape (h, w) or (h, w, 1 to 4), all of one size.  ``beauty`` becomes
        the channels R G B, ``normal`` N.X N.Y N.Z, ``depth`` depth.Z; any other name keeps
        its name (``albedo.R``, ``variance``).
    half
        Store 16 bit floats, but for depth, position, uv and variance.
    metadata
        Name -> str, int or float.  Integers beyond 32 bits are stored as text.
    window
        (x, y, full width, full height): where the pixels of a crop lie in the whole frame.
    compress
        False leaves the pixels as they are: a larger file, written at several times the speed.

    Raises
    ------
    ImageError
        For a bad layer or a file that cannot be written.
    """
    data = encode_exr(layers, half=half, metadata=metadata, window=window, compress=compress)
    _write(path, data)


def encode_png(
    pixels: npt.ArrayLike, *, bits: int = 8, metadata: Metadata | None = None
) -> memoryview:
    """The bytes of a PNG file; see `write_png`."""
    if bits not in (8, 16):
        raise ImageError(f"PNG has 8 or 16 bits (found {bits!r})")
    array = np.asarray(pixels)
    if array.ndim == 2:
        array = array[..., np.newaxis]
    if array.ndim != 3 or 0 in array.shape or array.shape[2] > 4:
        raise ImageError(f"PNG needs the shape (h, w, 1 to 4) (found {array.shape})")
    wanted: type[np.uint8] | type[np.uint16] = np.uint8 if bits == 8 else np.uint16
    if array.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            scaled = np.clip(np.nan_to_num(array), 0.0, 1.0) * np.iinfo(wanted).max
        array = np.rint(scaled).astype(wanted)
    elif array.dtype != wanted:
        raise ImageError(f"PNG of {bits} bits needs floats or {wanted.__name__}, not {array.dtype}")
    text: list[tuple[str, str | int | float]] = [
        (name, str(value)) for name, value in _checked_metadata(metadata)
    ]
    data: memoryview = _native().encode_png(np.ascontiguousarray(array), text).data
    return data


def write_png(
    path: str | os.PathLike[str],
    pixels: npt.ArrayLike,
    *,
    bits: int = 8,
    metadata: Metadata | None = None,
) -> None:
    """Write a PNG file of display-encoded sRGB pixels; the same input gives the same bytes.

    Parameters
    ----------
    path
        Where to; an old file is replaced only by a whole new one.
    pixels
        Shape (h, w) or (h, w, 1 to 4): floats in 0..1, or uint8 / uint16 as `bits` says.
    metadata
        Name -> value, stored as text chunks.
    """
    _write(path, encode_png(pixels, bits=bits, metadata=metadata))


def _native() -> Any:
    """The compiled module, loaded when first used: its libraries take their time."""
    from raykiln import _image

    return _image


def _named(source: Source, reader: str) -> Any:
    """Call a reader of the compiled module; its errors get the name of the file."""
    read = getattr(_native(), reader)
    if isinstance(source, bytes | bytearray | memoryview):
        return read(source)
    path = os.fsdecode(source)
    try:
        if "\0" in path:
            raise ImageError("a file name cannot hold a null character")
        return read(Path(path))
    except ImageError as error:
        raise ImageError(f"{shorten(printable(path), 400)}: {error}") from None


def _write(path: str | os.PathLike[str], data: memoryview) -> None:
    try:
        write_atomically(path, data)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        name = shorten(printable(os.fsdecode(path)), 400)
        raise ImageError(f"{name}: the image cannot be written: {reason}") from None


def printable(path: str) -> str:
    """A file name with what a terminal or a UTF-8 stream cannot take escaped."""
    return path if path.isprintable() else ascii(path)[1:-1]


def _channels_of(layer: str, values: npt.ArrayLike) -> list[tuple[str, npt.NDArray[np.float32]]]:
    array = np.asarray(values, dtype=np.float32)
    if array.ndim == 2:
        array = array[..., np.newaxis]
    if array.ndim != 3 or 0 in array.shape or array.shape[2] > 4:
        raise ImageError(f"layer {layer!r} needs the shape (h, w, 1 to 4) (found {array.shape})")
    if not _LAYER_NAME.fullmatch(layer) or layer in ("R", "G", "B", "A", "Y", "N"):
        raise ImageError(
            f"{shorten(layer)!r} cannot name a layer; accepted: letters, digits and _, but not "
            "R, G, B, A, Y or N"
        )
    count = array.shape[2]
    suffixes = _SUFFIXES.get(layer, {}).get(count, _COLOUR[count])
    prefix = _PREFIXES.get(layer, layer)
    return [(f"{prefix}.{s}".strip("."), array[..., i]) for i, s in enumerate(suffixes)]


def _layer_of(channel: str) -> tuple[str, str]:
    """The layer and the suffix of a channel's name."""
    prefix, _, suffix = channel.rpartition(".")
    if not prefix:
        plain = suffix in ("R", "G", "B", "A", "Y")
        return ("beauty", suffix) if plain else (suffix, "")
    return ("normal" if prefix == "N" else prefix), suffix


def _take(pixels: npt.NDArray[Any], members: list[tuple[str, int]]) -> npt.NDArray[np.float32]:
    members = sorted(members, key=lambda m: (_ORDER.get(m[0], len(_ORDER)), m[0]))
    indices = [index for _, index in members]
    chosen = pixels[..., indices[0] if len(indices) == 1 else indices]
    return np.ascontiguousarray(chosen, dtype=np.float32)


def _checked_metadata(metadata: Metadata | None) -> list[tuple[str, str | int | float]]:
    checked: list[tuple[str, str | int | float]] = []
    for name, value in (metadata or {}).items():
        if not _METADATA_NAME.fullmatch(name) or name.lower() in _CODING_NAMES:
            raise ImageError(f"{shorten(name)!r} cannot name metadata of an image")
        checked.append((name, _metadata_value(name, value)))
    return checked


def _metadata_value(name: str, value: object) -> str | int | float:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool | int):
        return int(value) if -(1 << 31) <= value < 1 << 31 else str(value)
    if isinstance(value, float):
        return value
    if isinstance(value, str):
        return value.replace("\0", "")
    raise ImageError(f"metadata {name!r} is {type(value).__name__}; accepted: str, int, float")
