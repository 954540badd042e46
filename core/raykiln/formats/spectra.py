"""Spectra as linear Rec.709 colours, as the RGB modes of Mitsuba 3 see them.

Reflectances and indices of refraction are seen under D65, so that a constant one is grey.
Emission is weighted with the observer alone, so that a constant one has the colour of the
equal-energy illuminant.  Negative components are clamped, and reflectances also above 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import SceneError
from raykiln.formats import cie

Role = Literal["reflectance", "emission", "index"]
Color = tuple[float, float, float]

# IEC 61966-2-1: linear Rec.709 from CIE XYZ.
_RGB_FROM_XYZ = np.array(
    [
        [3.240479, -1.537150, -0.498535],
        [-0.969256, 1.875991, 0.041556],
        [0.055648, -0.204043, 1.057311],
    ]
)
_GRID_NM = np.arange(cie.WAVELENGTHS_NM[0], cie.WAVELENGTHS_NM[-1] + 1)
_OBSERVER = np.stack(
    [np.interp(_GRID_NM, cie.WAVELENGTHS_NM, bar) for bar in (cie.X_BAR, cie.Y_BAR, cie.Z_BAR)]
)
_D65 = np.interp(_GRID_NM, cie.WAVELENGTHS_NM, cie.D65)

# Planck's law: 2 h c^2 in W m^2 / sr and h c / k in m K (CODATA 2018, exact).
_C1 = 1.191042972e-16
_C2 = 1.438776877e-2


def rgb_of_samples(wavelengths_nm: Sequence[float], values: Sequence[float], role: Role) -> Color:
    """The colour of a spectrum that is linear between samples and zero outside them."""
    order = np.asarray(wavelengths_nm, np.float64)
    if len(order) < 2 or len(order) != len(values) or not (np.diff(order) > 0).all():
        raise SceneError("a spectrum takes at least two samples of increasing wavelength")
    sampled = np.interp(_GRID_NM, order, np.asarray(values, np.float64), left=0.0, right=0.0)
    return _rgb(sampled, role)


def rgb_of_constant(value: float, role: Role) -> Color:
    """The colour of a spectrum that has one value everywhere."""
    if role != "emission":
        return (value, value, value)
    return _rgb(np.full_like(_GRID_NM, value), role)


def rgb_of_blackbody(temperature_k: float, scale: float = 1.0) -> Color:
    """The colour of Planck's radiance in W / (sr m^2 nm)."""
    if not 0 < temperature_k < 1e7:
        raise SceneError("a blackbody takes a temperature in kelvin", found=temperature_k)
    metres = _GRID_NM * 1e-9
    with np.errstate(over="ignore"):
        radiance = _C1 / metres**5 / np.expm1(_C2 / (metres * temperature_k))
    return _rgb(scale * 1e-9 * radiance, "emission")


def rgb_of_srgb(encoded: Sequence[float]) -> Color:
    """Linear colour of sRGB-encoded values in 0..1."""
    v = np.asarray(encoded, np.float64)
    curve = ((np.maximum(v, 0.0) + 0.055) / 1.055) ** 2.4
    linear = np.where(v <= 0.04045, v / 12.92, curve)
    return _color(linear)


def read_spd(data: bytes) -> tuple[list[float], list[float]]:
    """Wavelengths in nm and values of a text file with one pair a line; # begins a comment."""
    wavelengths, values = [], []
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            wavelength, value = (float(word) for word in words)
        except ValueError:
            raise SceneError("not a wavelength and a value", pointer=f"line {number}") from None
        wavelengths.append(wavelength)
        values.append(value)
    return wavelengths, values


def _rgb(sampled: NDArray[Any], role: Role) -> Color:
    weight = np.ones_like(_D65) if role == "emission" else _D65
    xyz = _OBSERVER @ (sampled * weight) / (_OBSERVER[1] @ weight)
    rgb = np.maximum(_RGB_FROM_XYZ @ xyz, 0.0)
    return _color(np.minimum(rgb, 1.0) if role == "reflectance" else rgb)


def _color(values: NDArray[Any]) -> Color:
    return float(values[0]), float(values[1]), float(values[2])
