"""Comparison metrics: closed forms, and FLIP against its authors' implementation."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from crafted_images import gradient
from raykiln.errors import ImageError
from raykiln.image import (
    compare,
    compare_files,
    error_heatmap,
    flip_map,
    write_exr,
    write_png,
)
from raykiln.image.compare import heat_colours

Floats = npt.NDArray[np.float32]


def scene(seed: int, height: int = 48, width: int = 64) -> Floats:
    """Smooth shading with an edge, a bright spot and some noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / np.array([height, width]).reshape(2, 1, 1)
    image = np.stack([x, y, 0.5 * (x + y)], axis=-1)
    image[:, width // 2 :] *= 0.3
    image[10:13, 12:15] = 1.0
    noisy = image + rng.normal(0.0, 0.03, image.shape)
    return np.clip(noisy, 0.0, 1.0).astype(np.float32)


def test_known_values() -> None:
    reference = np.full((4, 4, 3), 0.5)
    metrics = compare(np.full((4, 4, 3), 0.6), reference)
    assert metrics.mean_ratio == pytest.approx(1.2)
    assert metrics.mse == pytest.approx(0.01)
    assert metrics.rel_mse == pytest.approx(0.01 / 0.26)
    shown = [1.055 * v ** (1 / 2.4) - 0.055 for v in (0.6, 0.5)]
    assert metrics.psnr == pytest.approx(-20 * math.log10(shown[0] - shown[1]), rel=1e-5)
    assert metrics.nonfinite_pixels == 0


def test_the_second_image_is_the_reference() -> None:
    dark, bright = np.full((2, 2, 3), 0.1), np.full((2, 2, 3), 1.0)
    assert compare(bright, dark).rel_mse == pytest.approx(0.81 / 0.02)
    assert compare(dark, bright).rel_mse == pytest.approx(0.81 / 1.01)


def test_equal_images() -> None:
    metrics = compare(scene(1), scene(1))
    assert (metrics.mean_ratio, metrics.mse, metrics.rel_mse) == (1.0, 0.0, 0.0)
    assert (metrics.psnr, metrics.flip) == (None, 0.0)


def test_values_that_are_no_numbers_are_counted_and_left_out() -> None:
    image, reference = np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.5)
    image[0, 0, 1], reference[3, 3, 0] = np.nan, np.inf
    metrics = compare(image, reference)
    assert metrics.nonfinite_pixels == 2
    assert (metrics.mse, metrics.mean_ratio) == (0.0, 1.0)
    assert metrics.psnr is not None
    json.dumps(metrics.as_dict(), allow_nan=False)


def test_black_images_have_no_ratio() -> None:
    metrics = compare(np.ones((2, 2, 3)), np.zeros((2, 2, 3)))
    assert metrics.mean_ratio is None
    json.dumps(metrics.as_dict(), allow_nan=False)


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("pixels_per_degree", [67.0, 32.0])
def test_flip_agrees_with_its_authors(seed: int, pixels_per_degree: float) -> None:
    evaluator = pytest.importorskip("flip_evaluator")
    reference, test = scene(seed, height=150), scene(seed + 10, height=150) ** 1.1
    expected, mean, _ = evaluator.evaluate(
        reference,
        test,
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        parameters={"ppd": pixels_per_degree},
    )
    errors = flip_map(reference, test, pixels_per_degree)
    assert float(errors.mean()) == pytest.approx(mean, abs=1e-3)
    np.testing.assert_allclose(errors, expected[..., 0], atol=2e-3)


def test_flip_of_black_and_white_is_the_largest() -> None:
    black, white = np.zeros((8, 8, 3)), np.ones((8, 8, 3))
    assert flip_map(black, black).max() == 0.0
    # No feature differs, so the colour error stands alone; HyAB is 100 for black and white.
    assert flip_map(black, white).min() > 0.9
    assert flip_map(black, white).max() <= 1.0


def test_encoded_images_are_decoded_first() -> None:
    encoded = gradient()
    linear = np.where(
        encoded / 255 <= 0.04045, encoded / 255 / 12.92, ((encoded / 255 + 0.055) / 1.055) ** 2.4
    )
    assert compare(encoded, linear).mse == pytest.approx(0.0, abs=1e-12)
    sixteen = (encoded.astype(np.uint16)) * 257
    assert compare(sixteen, encoded).mse == pytest.approx(0.0, abs=1e-12)


def test_grey_and_alpha() -> None:
    grey = np.full((3, 3), 0.25)
    rgba = np.concatenate([np.full((3, 3, 3), 0.25), np.zeros((3, 3, 1))], axis=-1)
    assert compare(grey, rgba).mse == 0.0
    assert compare(grey[..., np.newaxis], rgba).mse == 0.0


def test_heatmap_shows_where() -> None:
    reference = np.full((32, 32, 3), 0.2)
    image = reference.copy()
    image[:8, :8] = 0.9
    heat = error_heatmap(image, reference)
    assert heat.shape == (32, 32, 3)
    assert heat.dtype == np.uint8
    lightness = heat.sum(axis=-1, dtype=int)
    assert lightness[2, 2] > 300 > 10 > lightness[30, 30]


def test_heat_colours_rise_in_lightness() -> None:
    ramp = heat_colours(np.linspace(0, 1, 256)[np.newaxis])[0]
    luminance = ramp @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(luminance) > -0.75)
    assert luminance[-1] - luminance[0] > 200
    assert heat_colours(np.array([[np.nan, np.inf, -1.0]])).shape == (1, 3, 3)


def test_files(tmp_path: Path) -> None:
    a, b = tmp_path / "a.exr", tmp_path / "b.exr"
    write_exr(a, {"beauty": scene(1), "depth": np.ones((48, 64))})
    write_exr(b, {"beauty": scene(2)})
    assert compare_files(a, b) == compare(scene(1), scene(2))


def test_files_that_cannot_be_compared(tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.exr", tmp_path / "b.png", tmp_path / "c.txt"
    write_exr(a, {"beauty": scene(1)})
    write_png(b, scene(1)[:10])
    c.write_text("no image")
    with pytest.raises(
        ImageError, match=r"a\.exr and .*b\.png differ in size: 64 x 48 and 64 x 10"
    ):
        compare_files(a, b)
    with pytest.raises(ImageError, match=r"c\.txt: not an image of an accepted kind"):
        compare_files(a, c)
    with pytest.raises(ImageError, match=r"d\.exr: no such file"):
        compare_files(tmp_path / "d.exr", a)
