"""How far one image is from another, in numbers and as a picture."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from raykiln.errors import ImageError
from raykiln.image.codec import read_image
from raykiln.image.flip import flip_map
from raykiln.image.view import srgb_oetf

Floats = npt.NDArray[np.float32]
_RELATIVE_FLOOR = 0.01


@dataclass(frozen=True)
class Comparison:
    """Metrics of an image `a` against a reference `b`, both linear Rec.709.

    Pixels with a NaN or an infinity in either image are counted and left out of the first
    three; in PSNR and FLIP they show as black (NaN) or white (infinity).
    """

    mean_ratio: float | None
    """mean(a) / mean(b); None where the reference's mean is 0."""
    mse: float
    """mean((a - b)^2)."""
    rel_mse: float
    """mean((a - b)^2 / (b^2 + 0.01))."""
    psnr: float | None
    """Peak signal-to-noise ratio in dB of the sRGB-encoded images, peak 1; None = equal."""
    flip: float
    """Mean LDR-FLIP error at 67 pixels per degree, 0 (equal) to 1."""
    nonfinite_pixels: int
    """Pixels left out, see above."""

    def as_dict(self) -> dict[str, float | int | None]:
        """The metrics by name, all of them values that JSON has."""
        return asdict(self)


def compare(a: npt.ArrayLike, b: npt.ArrayLike) -> Comparison:
    """Compare an image with a reference.

    Parameters
    ----------
    a, b
        Image and reference: linear float images of shape (h, w), (h, w, 1), (h, w, 3) or
        (h, w, 4), alpha ignored; or uint8 / uint16 images, which are taken to be sRGB-encoded.

    Raises
    ------
    ImageError
        If the sizes differ.
    """
    image, reference = _pair(a, b)
    finite = np.isfinite(image).all(axis=-1) & np.isfinite(reference).all(axis=-1)
    x, y = (v[finite].astype(np.float64) for v in (image, reference))
    squared = (x - y) ** 2
    shown_a, shown_b = _shown(image), _shown(reference)
    return Comparison(
        mean_ratio=_ratio(x, y),
        mse=_mean(squared),
        rel_mse=_mean(squared / (y**2 + _RELATIVE_FLOOR)),
        psnr=_psnr(shown_a, shown_b),
        flip=float(flip_map(shown_b, shown_a).mean(dtype=np.float64)),
        nonfinite_pixels=int(finite.size - np.count_nonzero(finite)),
    )


def compare_files(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> Comparison:
    """`compare` of two image files; `ImageError` if one is missing or is no image."""
    image, reference = read_image(a), read_image(b)
    if image.shape[:2] != reference.shape[:2]:
        raise ImageError(
            f"{os.fspath(a)} and {os.fspath(b)} differ in size: "
            f"{_size(image)} and {_size(reference)} pixels"
        )
    return compare(image, reference)


def error_heatmap(a: npt.ArrayLike, b: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """The FLIP error of every pixel as colours, black (equal) over red to pale yellow (1).

    Returns
    -------
    ndarray
        uint8 of shape (h, w, 3), ready for `write_png`.
    """
    image, reference = _pair(a, b)
    return heat_colours(flip_map(_shown(reference), _shown(image)))


# Heat stops of rising lightness, so that the map also reads in grey: position and sRGB.
_HEAT_AT = (0.0, 0.15, 0.35, 0.55, 0.75, 0.9, 1.0)
_HEAT = np.array(
    [
        (0, 0, 4),
        (30, 16, 76),
        (98, 26, 128),
        (176, 48, 118),
        (238, 88, 88),
        (252, 168, 108),
        (252, 250, 200),
    ],
    dtype=np.float64,
)


def heat_colours(error: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Errors in 0..1 of shape (h, w) as uint8 colours of shape (h, w, 3)."""
    level = np.clip(np.nan_to_num(np.asarray(error, dtype=np.float64), nan=1.0), 0.0, 1.0)
    colours = [np.interp(level, _HEAT_AT, _HEAT[:, c]) for c in range(3)]
    return np.rint(np.stack(colours, axis=-1)).astype(np.uint8)


def _pair(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[Floats, Floats]:
    image, reference = _linear_rgb(np.asarray(a)), _linear_rgb(np.asarray(b))
    if image.shape != reference.shape:
        raise ImageError(f"the images differ in size: {_size(image)} and {_size(reference)} pixels")
    return image, reference


def _size(image: npt.NDArray[np.generic]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def _linear_rgb(image: npt.NDArray[np.generic]) -> Floats:
    if image.ndim == 2:
        image = image[..., np.newaxis]
    if image.ndim != 3 or 0 in image.shape or image.shape[2] > 4:
        raise ImageError(f"an image has the shape (h, w, 1 to 4) (found {image.shape})")
    image = image[..., :1] if image.shape[2] <= 2 else image[..., :3]
    values = np.broadcast_to(image, (*image.shape[:2], 3))
    if values.dtype.kind == "u":
        return _srgb_eotf(values / np.float64(np.iinfo(values.dtype).max))
    return values.astype(np.float32)


def _srgb_eotf(encoded: npt.NDArray[np.float64]) -> Floats:
    """The inverse of the sRGB curve (IEC 61966-2-1)."""
    curve = ((encoded + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, curve).astype(np.float32)


def _shown(image: Floats) -> Floats:
    return srgb_oetf(np.nan_to_num(image, nan=0.0, posinf=1.0, neginf=0.0))


def _mean(values: npt.NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else 0.0


def _ratio(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> float | None:
    below = _mean(y)
    return _mean(x) / below if below != 0.0 else None


def _psnr(a: Floats, b: Floats) -> float | None:
    mse = _mean((a.astype(np.float64) - b) ** 2)
    return -10.0 * math.log10(mse) if mse > 0.0 else None
