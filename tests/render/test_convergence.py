"""The error falls as the square root of the samples, or faster: a slope that stalls is bias."""

from __future__ import annotations

import numpy as np
import pytest
import raykiln as rk

from .proof_scenes import SCENES
from .statistics import Floats, slope
from .support import render_runs

COUNTS = (4, 16, 64)
SIZE = {"width": 32, "height": 32}


def root_mean_square(scene: rk.Scene, sampler: str, reference: Floats) -> list[float]:
    """Of the error at each of `COUNTS`; the brightest hundredth of it left out.

    Rare paths of great weight (a lamp seen by reflection through glass) hardly ever come in few
    samples and would hide how the rest converges.
    """
    errors = []
    for spp in COUNTS:
        runs = render_runs(scene, 4, seed=10, spp=spp, sampler=sampler, **SIZE).runs
        squared = np.sort(((runs - reference) ** 2).mean(axis=(0, 3)).ravel())
        errors.append(float(np.sqrt(squared[: int(0.99 * squared.size)].mean())))
    return errors


def assert_converges(scene: rk.Scene, sampler: str, reference_spp: int) -> None:
    reference = render_runs(scene, 1, seed=1000, spp=reference_spp, **SIZE).mean
    errors = root_mean_square(scene, sampler, reference)
    assert slope(COUNTS, errors) < -0.42, errors


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("name", SCENES)
def test_error_falls(name: str, sampler: str) -> None:
    assert_converges(SCENES[name](), sampler, 1024)


@pytest.mark.parametrize("name", sorted(rk.bundled_scenes()))
def test_error_falls_on_bundled_scene(name: str) -> None:
    assert_converges(rk.load_scene(name), "sobol", 1024)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(rk.bundled_scenes()))
def test_error_falls_for_long_on_bundled_scene(name: str) -> None:
    scene = rk.load_scene(name)
    reference = render_runs(scene, 1, seed=1000, spp=16384, **SIZE).mean
    counts = (16, 128, 1024)
    errors = []
    for spp in counts:
        found = render_runs(scene, 2, seed=10, spp=spp, **SIZE).runs
        squared = np.sort(((found - reference) ** 2).mean(axis=(0, 3)).ravel())
        errors.append(float(np.sqrt(squared[: int(0.99 * squared.size)].mean())))
    assert slope(counts, errors) < -0.45, errors
