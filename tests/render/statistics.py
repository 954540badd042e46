"""Estimates with error bars, and the tests that compare two of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Floats = NDArray[np.float64]
LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
# Rounding in single precision, far below what any test looks for.
ROUNDING = 1e-3


@dataclass(frozen=True)
class Estimate:
    """Independent renders of one image: (runs, height, width, 3)."""

    runs: Floats

    @property
    def mean(self) -> Floats:
        """The image: (height, width, 3)."""
        return np.asarray(self.runs.mean(axis=0))

    @property
    def standard_error(self) -> Floats:
        """Of `mean`, from the spread of the runs."""
        return np.asarray(self.runs.std(axis=0, ddof=1) / np.sqrt(len(self.runs)))

    def blocks(self, across: int = 8) -> Estimate:
        """The same with means over a grid of `across` x `across` blocks for pixels."""
        count, height, width, channels = self.runs.shape
        shape = (count, across, height // across, across, width // across, channels)
        return Estimate(self.runs.reshape(shape).mean(axis=(2, 4)))

    def whole(self) -> Estimate:
        """The same with the mean of the image for its only pixel."""
        return self.blocks(1)

    def luminance(self) -> Floats:
        """(runs, height, width)."""
        return np.asarray(self.runs @ LUMINANCE)


def excess(a: Estimate, b: Estimate, *, relative: float = 0.01, sigmas: float = 3.0) -> Floats:
    """|a - b| in units of what is allowed: a share of b, plus the error bars; > 1 fails."""
    sigma = np.hypot(a.standard_error, b.standard_error)
    allowed = relative * np.abs(b.mean) + sigmas * sigma
    return np.asarray(np.abs(a.mean - b.mean) / np.maximum(allowed, 1e-6))


def p_values(a: Estimate, b: Estimate) -> Floats:
    """Welch's t-test of equal mean luminance, pixel by pixel: (height, width)."""
    x, y = a.luminance(), b.luminance()
    n, m = len(x), len(y)
    floor = (ROUNDING * np.abs(y.mean(axis=0)) + 1e-9) ** 2
    vx, vy = x.var(axis=0, ddof=1) / n, y.var(axis=0, ddof=1) / m
    variance = vx + vy
    freedom = variance**2 / np.maximum(vx**2 / (n - 1) + vy**2 / (m - 1), 1e-300)
    t = np.abs(x.mean(axis=0) - y.mean(axis=0)) / np.sqrt(variance + floor)
    return np.asarray(2 * stats.t.sf(t, np.maximum(freedom, min(n, m) - 1)))


def share_that_passes(p: Floats, significance: float = 0.01) -> float:
    """Share of p-values over the level that Sidak's correction gives for so many tests."""
    level = 1 - (1 - significance) ** (1 / p.size)
    return float(np.mean(p > level))


def slope(x: Any, y: Any) -> float:
    """Of the line through log y over log x, by least squares."""
    return float(np.polyfit(np.log(np.asarray(x, float)), np.log(np.asarray(y, float)), 1)[0])
