"""View transforms: from linear scene-referred radiance to what a display shows.

Sources: IEC 61966-2-1 (sRGB); Stephen Hill's fit of the ACES reference rendering and output
transforms (MIT-licensed shader of "Baking Lab", 2016); Troy Sobotka's AgX (2022) with Benjamin
Wrensch's polynomial fit of its sigmoid ("Minimal AgX Implementation", 2023).
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from raykiln.errors import ImageError

View = Literal["srgb", "agx", "aces", "raw"]
VIEWS: tuple[str, ...] = get_args(View)
Floats = npt.NDArray[np.float32]

# Twenty stops above white: far on every curve's plateau, and its square is finite.
_BRIGHTEST = 1e6

# Linear Rec.709 to the working space of Hill's fit, and back (row vectors' matrices).
_ACES_FROM_REC709 = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]],
    dtype=np.float32,
)
_REC709_FROM_ACES = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]],
    dtype=np.float32,
)
_AGX_INSET = np.array(
    [
        [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
        [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
        [0.0423756549057051, 0.0784336, 0.879142973793104],
    ]
)
_AGX_OUTSET = np.linalg.inv(_AGX_INSET)
# log2 of the radiances that AgX maps to 0 and 1: 10 stops below and 6.5 above mid grey (0.18).
_AGX_MIN_EV, _AGX_MAX_EV = -12.47393, 4.026069
_AGX_SIGMOID = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)


def apply_view(image: npt.ArrayLike, view: str = "srgb", exposure: float = 0.0) -> Floats:
    """Display-encode an image of linear Rec.709 radiance.

    Parameters
    ----------
    image
        Shape (..., 3).  NaN and negative values become 0, infinity the brightest value.
    view
        ``srgb``: clip, then the sRGB curve.  ``agx``, ``aces``: filmic tone mapping.
        ``raw``: clip only, the values as they are.
    exposure
        In stops (EV): the radiance is multiplied by 2^exposure first.

    Returns
    -------
    ndarray
        float32 of the same shape, in 0..1, encoded for an sRGB display (but for ``raw``).
    """
    if view not in VIEWS:
        raise ImageError(f"unknown view {view!r}; accepted: {', '.join(VIEWS)}")
    if not np.isfinite(exposure):
        raise ImageError(f"the exposure must be a finite number of stops (found {exposure!r})")
    linear = _exposed(image, exposure)
    if view == "raw":
        return np.minimum(linear, 1.0, dtype=np.float32)
    if linear.shape[-1:] != (3,) and view != "srgb":
        raise ImageError(f"the view {view!r} needs RGB (found the shape {linear.shape})")
    return {"srgb": srgb_oetf, "agx": _agx, "aces": _aces}[view](linear)


def to_png_pixels(
    image: npt.ArrayLike, view: str = "srgb", exposure: float = 0.0, *, bits: int = 8
) -> npt.NDArray[Any]:
    """The view of an image as integers, ready for `write_png`: uint8, or uint16 for 16 bits."""
    if bits not in (8, 16):
        raise ImageError(f"PNG has 8 or 16 bits (found {bits!r})")
    encoded = apply_view(image, view, exposure)
    largest = (1 << bits) - 1
    return np.rint(encoded * largest).astype(np.uint8 if bits == 8 else np.uint16)


def srgb_oetf(linear: npt.ArrayLike) -> Floats:
    """The sRGB curve of IEC 61966-2-1: linear light (clipped to 0..1) to display values."""
    x = np.clip(np.asarray(linear, dtype=np.float32), 0.0, 1.0)
    curve = 1.055 * np.power(x, 1.0 / 2.4, dtype=np.float32) - 0.055
    return np.where(x <= 0.0031308, 12.92 * x, curve).astype(np.float32)


def _exposed(image: npt.ArrayLike, exposure: float) -> Floats:
    values = np.asarray(image, dtype=np.float32)
    gain = np.float32(2.0 ** min(max(exposure, -120.0), 120.0))
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.nan_to_num(values * gain, nan=0.0, posinf=_BRIGHTEST, neginf=0.0)
    return np.asarray(np.clip(scaled, 0.0, _BRIGHTEST), dtype=np.float32)


def _aces(linear: Floats) -> Floats:
    v = linear @ _ACES_FROM_REC709.T
    fitted = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
    return srgb_oetf(fitted @ _REC709_FROM_ACES.T)


def _agx(linear: Floats) -> Floats:
    inset = linear @ _AGX_INSET.T
    stops = np.log2(np.maximum(inset, 2.0**_AGX_MIN_EV))
    x = np.clip((stops - _AGX_MIN_EV) / (_AGX_MAX_EV - _AGX_MIN_EV), 0.0, 1.0)
    # The sigmoid's values are already meant for the display: no further curve.
    shown = np.clip(np.polyval(_AGX_SIGMOID, x) @ _AGX_OUTSET.T, 0.0, 1.0)
    return np.asarray(shown, dtype=np.float32)
