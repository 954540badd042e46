"""The error falls as the square root of the samples, or faster: a slope that stalls is bias."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .proof_scenes import SCENES
from .statistics import slope
from .support import render_runs


def errors_of(
    scene: rk.Scene, counts: tuple[int, ...], reference_spp: int, size: int, **settings: Any
) -> list[float]:
    """Root mean square error of log(1 + radiance) after each number of samples.

    The logarithm is about what an eye sees, and keeps a few rare paths of great weight from
    deciding alone; so does the box filter, whose tail does not reach for lamps far outside a pixel.
    """
    settings = {"width": size, "height": size, "filter": "box", **settings}
    reference = render_runs(scene, 1, seed=1000, **{**settings, "spp": reference_spp}).mean
    errors = []
    for spp in counts:
        runs = render_runs(scene, 3, seed=10, **{**settings, "spp": spp}).runs
        squared = (np.log1p(runs) - np.log1p(reference)) ** 2
        errors.append(float(np.sqrt(squared.mean())))
    return errors


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("name", SCENES)
def test_error_falls(name: str, sampler: str) -> None:
    counts = (4, 16, 64)
    errors = errors_of(SCENES[name](), counts, 1024, 24, sampler=sampler)
    assert slope(counts, errors) < -0.42, errors


@pytest.mark.parametrize(
    ("counts", "reference_spp", "size"),
    [
        pytest.param((16, 64, 256), 2048, 24, id="quick"),
        pytest.param((64, 256, 1024), 8192, 24, id="long", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("name", sorted(rk.bundled_scenes()))
def test_error_falls_on_bundled_scene(
    name: str, counts: tuple[int, ...], reference_spp: int, size: int
) -> None:
    errors = errors_of(rk.load_scene(name), counts, reference_spp, size)
    assert slope(counts, errors) < -0.42, errors
