"""Reference images of the bundled scenes: `python tests/images/scene_references.py [NAME...]`.

A reference is made of many renders with the settings of the test but other seeds: their mean, and
the standard deviation of one of them.  So it holds what the test must know of the noise, the
sampler's stratification included.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import raykiln as rk
from numpy.typing import NDArray
from raykiln.image import read_exr_layers, write_exr
from scipy import stats

FOLDER = Path(__file__).parent / "references"
RUNS = 64
WIDTH, SPP = 64, 64
# Blocks of this many pixels a side, and the whole image, show what single pixels hide.
BLOCK = 8
# Half floats keep 11 bits, and processors differ in the last bits of a sum.
ROUNDING = 2e-3
SIGNIFICANCE = 0.01

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """Mean and standard deviation of a test render: (height, width, 3) each."""

    mean: Floats
    deviation: Floats

    @classmethod
    def read(cls, name: str) -> Reference:
        """The stored reference of a scene."""
        layers = read_exr_layers(FOLDER / f"{name}.exr")
        variance = layers["deviation"].astype(np.float64) ** 2
        # Some pixels were lucky in all runs; their neighbours know better.
        variance = np.maximum(variance, smoothed(variance))
        return cls(layers["beauty"].astype(np.float64), np.sqrt(variance))

    def blocks(self, height: int, width: int) -> Reference:
        """The same for means over blocks of pixels, whose noise is independent."""
        variance = blocks(self.deviation**2, height, width) / (height * width)
        return Reference(blocks(self.mean, height, width), np.sqrt(variance))

    def p_values(self, image: Floats) -> Floats:
        """Of a t-test that `image` is a render of the same mean: (height, width, 3)."""
        spread = self.deviation * np.sqrt(1 + 1 / RUNS) + ROUNDING * self.mean + 1e-5
        p: Floats = 2 * stats.t.sf(np.abs(image - self.mean) / spread, RUNS - 1)
        return p


def blocks(image: Floats, height: int, width: int) -> Floats:
    """Means over blocks of `height` x `width` pixels."""
    h, w, channels = image.shape
    return np.asarray(image.reshape(h // height, height, w // width, width, channels).mean((1, 3)))


def smoothed(image: Floats) -> Floats:
    """Means over 3 x 3 pixels."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
    return np.asarray(windows.mean(axis=(-2, -1)))


def share_that_passes(p: Floats) -> float:
    """Share of p-values over the level that Šidák's correction gives for so many tests."""
    return float(np.mean(p > 1 - (1 - SIGNIFICANCE) ** (1 / p.size)))


def passes(reference: Reference, image: Floats) -> dict[str, float]:
    """The share that passes, by pixels, by blocks and for the whole image."""
    found = {"pixels": share_that_passes(reference.p_values(image))}
    for name, size in (("blocks", (BLOCK, BLOCK)), ("image", image.shape[:2])):
        found[name] = share_that_passes(reference.blocks(*size).p_values(blocks(image, *size)))
    return found


def settings_of(scene: rk.Scene, seed: int) -> rk.RenderSettings:
    """The scene's own settings at the size and sample count of the test."""
    aspect = scene.settings["height"] / scene.settings["width"]
    height = BLOCK * math.ceil(WIDTH * aspect / BLOCK)
    return rk.RenderSettings(width=WIDTH, height=height, spp=SPP, seed=seed)


def render(scene: rk.Scene, seed: int = 0) -> Floats:
    """A test render; seed 0 is the test's own."""
    return rk.render(scene, settings_of(scene, seed)).image.astype(np.float64)


def make(name: str) -> Path:
    """Render the reference of a scene anew."""
    scene = rk.load_scene(name)
    runs = np.stack([render(scene, seed) for seed in range(1, RUNS + 1)])
    layers = {"beauty": runs.mean(axis=0), "deviation": runs.std(axis=0, ddof=1)}
    path = FOLDER / f"{name}.exr"
    write_exr(path, layers, half=True, metadata={"raykiln:runs": RUNS, "raykiln:spp": SPP})
    return path


def main() -> None:
    """Make the references of the named scenes, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    for name in parser.parse_args().names or sorted(rk.bundled_scenes()):
        path = make(name)
        print(f"{path.name}: {path.stat().st_size:,} bytes", flush=True)


if __name__ == "__main__":
    main()
