"""LDR-FLIP, the perceived difference of two images that are shown in alternation.

P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. Fairchild: "FLIP: A
Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020.
Section numbers below are the paper's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Kernel = npt.NDArray[np.float64]

# Rows worked on at a time, so that a band's planes stay in the processor's cache.
_BAND = 64

# Linear sRGB to CIE XYZ (D65), as exact fractions of the chromaticities.
_XYZ_FROM_RGB = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_WHITE_XYZ = _XYZ_FROM_RGB.sum(axis=1)
# To and from XYZ relative to white, as right-hand factors of rows of pixels.
_TO_XYZ = (_XYZ_FROM_RGB.T / _WHITE_XYZ).astype(np.float32)
_TO_RGB = np.linalg.inv(_XYZ_FROM_RGB.T / _WHITE_XYZ).astype(np.float32)

# Table 1: contrast sensitivity as sums of Gaussians (amplitude, width), a channel each.
_SENSITIVITY = (
    ((1.0, 0.0047), (0.0, 1e-5)),
    ((1.0, 0.0053), (0.0, 1e-5)),
    ((34.1, 0.04), (13.5, 0.025)),
)
_COLOUR_EXPONENT = 0.7
_COLOUR_KNEE_IN, _COLOUR_KNEE_OUT = 0.4, 0.95
_FEATURE_EXPONENT = 0.5
_FEATURE_WIDTH_DEGREES = 0.082
PIXELS_PER_DEGREE = 67.0


def flip_map(
    reference: npt.ArrayLike, test: npt.ArrayLike, pixels_per_degree: float = PIXELS_PER_DEGREE
) -> npt.NDArray[np.float32]:
    """The FLIP error of every pixel.

    Parameters
    ----------
    reference, test
        Display-encoded sRGB images in 0..1, shape (h, w, 3) both.
    pixels_per_degree
        Pixels within one degree of the viewer's field; 67 is a 0.7 m wide 4K display seen
        from 0.7 m.

    Returns
    -------
    ndarray
        float32 of shape (h, w), 0 (equal) to 1.
    """
    halo = _halo(pixels_per_degree)
    a, b = (
        np.pad(np.asarray(image, np.float32), ((halo, halo), (halo, halo), (0, 0)), mode="edge")
        for image in (reference, test)
    )
    bands = [slice(y, y + _BAND + 2 * halo) for y in range(0, len(a) - 2 * halo, _BAND)]
    return np.concatenate([_flip_of_band(a[s], b[s], pixels_per_degree) for s in bands])


def _flip_of_band(reference: Floats, test: Floats, ppd: float) -> Floats:
    """The error of a band that is given with a halo as wide as the widest filter."""
    a, b = _opponent(reference), _opponent(test)
    feature = _feature_error(a[..., 0], b[..., 0], ppd)
    return np.asarray(_colour_error(a, b, ppd) ** (1.0 - feature))


def _opponent(srgb: Floats) -> Floats:
    """Display values to the linear opponent space YCxCz."""
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    x, y, z = np.moveaxis(linear @ _TO_XYZ, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _colour_error(a: Floats, b: Floats, ppd: float) -> Floats:
    """Section 4.1: filter as the eye does, then compare in a perceptually even space."""
    lab_a, lab_b = (_hunt_adjusted_lab(_seen(image, ppd)) for image in (a, b))
    green, blue = (
        _hunt_adjusted_lab(np.array(c, np.float32)) for c in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    )
    largest = float(_hyab(green, blue)) ** _COLOUR_EXPONENT
    error = _hyab(lab_a, lab_b) ** _COLOUR_EXPONENT
    knee = _COLOUR_KNEE_IN * largest
    below = _COLOUR_KNEE_OUT / knee * error
    above = _COLOUR_KNEE_OUT + (error - knee) / (largest - knee) * (1.0 - _COLOUR_KNEE_OUT)
    return np.asarray(np.where(error < knee, below, above))


def _seen(image: Floats, ppd: float) -> Floats:
    """Contrast-sensitivity filtered YCxCz, as linear RGB within 0..1."""
    radius = _colour_radius(ppd)
    degrees = np.arange(-radius, radius + 1) / ppd
    halo = _halo(ppd)
    height, columns = image.shape[0] - 2 * halo, image.shape[1] - 2 * halo
    filtered = np.empty((height, columns, 3), np.float32)
    for channel, terms in enumerate(_SENSITIVITY):
        total, weight = np.zeros((height, columns), np.float32), 0.0
        for amplitude, width in terms:
            if amplitude == 0.0:
                continue
            bell = np.exp(-(math.pi**2) * degrees**2 / width)
            gain = amplitude * math.sqrt(math.pi / width)
            total += gain * _convolve(image[..., channel], bell, bell, halo)
            weight += gain * float(bell.sum()) ** 2
        filtered[..., channel] = total / weight
    y = (filtered[..., 0] + 16.0) / 116.0
    xyz = np.stack([y + filtered[..., 1] / 500.0, y, y - filtered[..., 2] / 200.0], axis=-1)
    return np.asarray(np.clip(xyz @ _TO_RGB, 0.0, 1.0))


def _hunt_adjusted_lab(linear: Floats) -> Floats:
    """CIE L*a*b* with chroma scaled by lightness (the Hunt effect)."""
    t = linear @ _TO_XYZ
    delta = 6.0 / 29.0
    f = np.where(t > delta**3, np.cbrt(t), t / (3.0 * delta**2) + 4.0 / 29.0)
    x, y, z = np.moveaxis(f, -1, 0)
    lightness = 116.0 * y - 16.0
    scale = 0.01 * lightness
    return np.stack([lightness, 500.0 * (x - y) * scale, 200.0 * (y - z) * scale], axis=-1)


def _hyab(a: Floats, b: Floats) -> Floats:
    difference = a - b
    return np.asarray(np.abs(difference[..., 0]) + np.hypot(difference[..., 1], difference[..., 2]))


def _feature_error(a: Floats, b: Floats, ppd: float) -> Floats:
    """Section 4.2: how much edges and points differ, on luminance in 0..1."""
    deviation = 0.5 * _FEATURE_WIDTH_DEGREES * ppd
    radius = _feature_radius(ppd)
    halo = _halo(ppd)
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    bell = np.exp(-(x**2) / (2.0 * deviation**2))
    kernels = (-x * bell, (x**2 / deviation**2 - 1.0) * bell)
    differences = [
        np.abs(_magnitude(a, kernel, bell, halo) - _magnitude(b, kernel, bell, halo))
        for kernel in kernels
    ]
    strongest = np.maximum(*differences)
    return np.asarray((strongest / math.sqrt(2.0)) ** _FEATURE_EXPONENT)


def _colour_radius(ppd: float) -> int:
    widest = max(width for terms in _SENSITIVITY for _, width in terms)
    return math.ceil(3.0 * math.sqrt(widest / (2.0 * math.pi**2)) * ppd)


def _feature_radius(ppd: float) -> int:
    return math.ceil(3.0 * 0.5 * _FEATURE_WIDTH_DEGREES * ppd)


def _halo(ppd: float) -> int:
    """Pixels around the one in question that matter to it."""
    return max(_colour_radius(ppd), _feature_radius(ppd))


def _magnitude(opponent_y: Floats, kernel: Kernel, bell: Kernel, halo: int) -> Floats:
    """Length of the (derivative along x, derivative along y) of a filtered luminance."""
    luminance = (opponent_y + 16.0) / 116.0
    # Positive weights sum to 1 and negative ones to -1, over the whole two-dimensional kernel.
    positive, negative = kernel[kernel > 0].sum(), -kernel[kernel < 0].sum()
    even = np.where(kernel > 0, kernel / positive, kernel / negative)
    smooth = bell / bell.sum()
    along_x = _convolve(luminance, even, smooth, halo)
    return np.hypot(along_x, _convolve(luminance, smooth, even, halo))


def _convolve(image: Floats, along_x: Kernel, along_y: Kernel, halo: int) -> Floats:
    """Correlate with a separable kernel of odd size; the result has no halo any more."""
    spare = halo - len(along_x) // 2
    height, width = image.shape[0] - 2 * halo, image.shape[1] - 2 * halo
    tall = image[spare : image.shape[0] - spare]
    rows = _weighted_sum(along_x, lambda i: tall[:, spare + i : spare + i + width])
    return _weighted_sum(along_y, lambda i: rows[i : i + height])


def _weighted_sum(weights: Kernel, part: Callable[[int], Floats]) -> Floats:
    total: Floats = part(0) * np.float32(weights[0])
    term = np.empty_like(total)
    for i in range(1, len(weights)):
        total += np.multiply(part(i), np.float32(weights[i]), out=term)
    return total
