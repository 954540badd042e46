"""A contact sheet: all frames small, side by side, each with its number below it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
"""Display-encoded (height, width, 3)."""
Radiance = NDArray[np.float32]
"""Linear (height, width, 3)."""

SHEET_PIXELS = 2048
THUMB_PIXELS = 256
_GAP = 8
_LABEL = 14
_BACKGROUND, _INK = 28, 200
# Digits of 3 x 5 dots: each octal digit is a row.
_DIGITS = (
    0o75557, 0o26227, 0o71747, 0o71717, 0o55711, 0o74717, 0o74757, 0o71111, 0o75757, 0o75717,
)  # fmt: skip


def contact_sheet(
    frames: Iterable[tuple[int, Picture]], count: int, size: tuple[int, int]
) -> Picture:
    """The sheet of `count` frames.

    Parameters
    ----------
    frames
        Number and picture of each, in any order; every picture is as `thumb_size` says.
    size
        Width and height of a picture in pixels.
    """
    width, height = size
    columns = math.ceil(math.sqrt(count * (height + _LABEL) / width))
    columns = min(max(columns, 1), count)
    rows = math.ceil(count / columns)
    step_x, step_y = width + _GAP, height + _LABEL + _GAP
    shape = (rows * step_y + _GAP, columns * step_x + _GAP, 3)
    sheet = np.full(shape, _BACKGROUND, np.uint8)
    for place, (number, picture) in enumerate(frames):
        x = _GAP + place % columns * step_x
        y = _GAP + place // columns * step_y
        sheet[y : y + picture.shape[0], x : x + picture.shape[1]] = picture
        _write_number(sheet, number, x, y + height + 3)
    return sheet


def thumb_size(count: int, width: int, height: int) -> tuple[int, int]:
    """Width and height of a picture on the sheet of `count` frames of the given size."""
    columns = math.ceil(math.sqrt(count))
    largest = min(THUMB_PIXELS, max(24, SHEET_PIXELS // columns - _GAP))
    return fitted(width, height, largest)


def fitted(width: int, height: int, largest: int) -> tuple[int, int]:
    """A size of the same shape whose longer side has at most `largest` pixels."""
    scale = min(1.0, largest / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def shrunk(image: Radiance, width: int, height: int) -> Radiance:
    """The image with each new pixel the mean of the area that it covers."""
    rows = _areas(image.shape[0], height)
    columns = _areas(image.shape[1], width)
    finite = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)
    low = np.tensordot(rows, finite, axes=(1, 0))
    return np.ascontiguousarray(np.tensordot(low, columns, axes=(1, 1)).transpose(0, 2, 1))


def _areas(old: int, new: int) -> NDArray[np.float32]:
    """(new, old): the share of each old pixel in each new one."""
    edges = np.arange(new + 1) * (old / new)
    starts = np.arange(old)
    overlap = np.minimum(edges[1:, None], starts + 1) - np.maximum(edges[:-1, None], starts)
    shares: NDArray[np.float32] = (np.maximum(overlap, 0.0) * (new / old)).astype(np.float32)
    return shares


def _write_number(sheet: Picture, number: int, x: int, y: int) -> None:
    for digit in str(number):
        bits = np.array([_DIGITS[int(digit)] >> (14 - i) & 1 for i in range(15)], bool)
        dots = np.kron(bits.reshape(5, 3), np.ones((2, 2), bool))
        cell = sheet[y : y + 10, x : x + 6]
        cell[dots[: cell.shape[0], : cell.shape[1]]] = _INK
        x += 8
