"""Errors of images, and whether two renderers show the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

MEAN_TOLERANCE = 0.01
BLOCKS = 8
# Blocks of an unconverged image scatter: they have to lie within this many standard errors.
BLOCK_SIGMAS = 5.0


@dataclass(frozen=True)
class Reference:
    """Two independent converged images of one scene, by different renderers."""

    first: Image
    second: Image

    @property
    def mean(self) -> Image:
        """Both together."""
        image: Image = (0.5 * (self.first + self.second)).astype(np.float32)
        return image

    def rel_mse(self, image: Image) -> float:
        """mean((x - ref)^2 / (ref^2 + 0.01)), with the references' own noise taken out.

        The product of the differences to two independent references has the square of the
        difference to the truth as its mean, whatever their noise.
        """
        product = (image - self.first).astype(np.float64) * (image - self.second)
        return float(np.mean(product / (self.mean.astype(np.float64) ** 2 + 0.01)))

    def plain_rel_mse(self, image: Image) -> float:
        """The same against the mean of both: the references' noise counts as error."""
        ref = self.mean.astype(np.float64)
        return float(np.mean((image - ref) ** 2 / (ref**2 + 0.01)))

    def noise(self) -> float:
        """relMSE of the mean of the two, from their difference."""
        difference = (self.first - self.second).astype(np.float64)
        return float(np.mean(difference**2 / (self.mean.astype(np.float64) ** 2 + 0.01)) / 4)


def blocks(image: Image) -> NDArray[np.float64]:
    """Means (BLOCKS, BLOCKS) over all colours."""
    side = len(image) // BLOCKS
    cut = image[: side * BLOCKS, : side * BLOCKS].astype(np.float64)
    means: NDArray[np.float64] = cut.reshape(BLOCKS, side, BLOCKS, side, 3).mean((1, 3, 4))
    return means


def agreement(image: Image, reference: Image) -> dict[str, Any]:
    """How an image stands to a reference: ratio of the means, and of blocks of the image.

    A block agrees if it is within 1 % or within what its own noise explains (from the scatter of
    its pixels about the reference).
    """
    ratio = float(image.mean(dtype=np.float64) / reference.mean(dtype=np.float64))
    ours, theirs = blocks(image), blocks(reference)
    difference = (image - reference).astype(np.float64)
    side = len(image) // BLOCKS
    cut = difference[: side * BLOCKS, : side * BLOCKS].mean(axis=2)
    cells = (
        cut.reshape(BLOCKS, side, BLOCKS, side).transpose(0, 2, 1, 3).reshape(BLOCKS, BLOCKS, -1)
    )
    error = cells.std(axis=2) / side
    off = np.abs(ours - theirs)
    floor = MEAN_TOLERANCE * np.maximum(theirs, 0.05 * theirs.mean())
    bad = off > np.maximum(floor, BLOCK_SIGMAS * error)
    scale = np.maximum(theirs, 0.05 * theirs.mean())
    return {
        "mean_ratio": ratio,
        "mean_agrees": abs(ratio - 1) <= MEAN_TOLERANCE,
        "blocks_off": int(bad.sum()),
        "blocks": BLOCKS * BLOCKS,
        "worst_block": float((off / scale).max()),
    }
