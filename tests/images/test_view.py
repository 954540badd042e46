"""View transforms at values known from their definitions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from raykiln.errors import ImageError
from raykiln.image import VIEWS, apply_view, to_png_pixels

ANY_IMAGE = hnp.arrays(np.float32, (3, 4, 3), elements=hnp.from_dtype(np.dtype(np.float32)))


def grey(value: float, view: str, exposure: float = 0.0) -> float:
    return float(apply_view([[[value] * 3]], view, exposure)[0, 0, 1])


@pytest.mark.parametrize(
    ("linear", "encoded"),
    [(0.0, 0.0), (0.001, 0.01292), (0.0031308, 0.0404499), (0.18, 0.461356), (0.5, 0.735357),
     (1.0, 1.0), (7.0, 1.0), (-1.0, 0.0)],
)  # fmt: skip
def test_srgb(linear: float, encoded: float) -> None:
    assert grey(linear, "srgb") == pytest.approx(encoded, abs=2e-6)


def test_raw_only_clips() -> None:
    assert [grey(v, "raw") for v in (-1.0, 0.25, 3.0)] == [0.0, 0.25, 1.0]


def test_aces_matches_the_fit_in_double_precision() -> None:
    # The matrices' rows sum to 1 within 1e-5, so a grey stays grey and the fit is scalar.
    for linear in (0.05, 0.18, 1.0, 4.0):
        fit = (linear * (linear + 0.0245786) - 0.000090537) / (
            linear * (0.983729 * linear + 0.4329510) + 0.238081
        )
        expected = 1.055 * min(fit, 1.0) ** (1 / 2.4) - 0.055
        assert grey(linear, "aces") == pytest.approx(expected, abs=2e-4)


def test_agx_ends_and_middle() -> None:
    assert grey(0.18 * 2.0**-10, "agx") == pytest.approx(0.0, abs=3e-3)
    assert grey(0.18 * 2.0**6.5, "agx") == pytest.approx(1.0, abs=3e-3)
    # The sigmoid's pivot: mid grey goes to 0.18^(1/2.4), as the AgX of 2022 sets it.
    assert grey(0.18, "agx") == pytest.approx(0.18 ** (1 / 2.4), abs=0.01)


def test_agx_pales_what_is_bright() -> None:
    dim, bright = (apply_view([[[v, 0.0, 0.0]]], "agx")[0, 0] for v in (0.2, 40.0))
    assert bright[1] - dim[1] > 0.3
    assert dim[0] > 3 * dim[1]


@pytest.mark.parametrize("view", VIEWS)
def test_exposure_is_a_gain_in_stops(view: str) -> None:
    assert grey(0.1, view, 2.0) == pytest.approx(grey(0.4, view), abs=1e-6)


@pytest.mark.parametrize("view", VIEWS)
def test_greys_rise(view: str) -> None:
    shown = [grey(0.001 * 1.5**i, view) for i in range(30)]
    assert all(a <= b + 1e-6 for a, b in pairwise(shown))


@pytest.mark.parametrize("view", VIEWS)
@given(image=ANY_IMAGE, exposure=st.floats(-2000, 2000))
def test_any_image_stays_within_the_display(view: str, image: object, exposure: float) -> None:
    shown = apply_view(image, view, exposure)  # type: ignore[arg-type]
    assert shown.dtype == np.float32
    assert np.isfinite(shown).all()
    assert shown.min() >= 0.0
    assert shown.max() <= 1.0


def test_not_a_number_is_black_and_infinity_is_white() -> None:
    for view in VIEWS:
        assert grey(float("nan"), view) == pytest.approx(0.0, abs=3e-3)
        assert grey(float("-inf"), view) == pytest.approx(0.0, abs=3e-3)
        assert grey(float("inf"), view) == pytest.approx(1.0, abs=3e-3)


def test_png_pixels() -> None:
    ramp = np.array([[[0.0] * 3, [0.18] * 3, [1.0] * 3]])
    assert to_png_pixels(ramp)[0, :, 0].tolist() == [0, 118, 255]
    sixteen = to_png_pixels(ramp, bits=16)
    assert sixteen.dtype == np.uint16
    assert sixteen[0, :, 0].tolist() == [0, 30235, 65535]


def test_bad_arguments() -> None:
    with pytest.raises(ImageError, match="unknown view 'filmic'; accepted: srgb, agx, aces, raw"):
        apply_view(np.zeros((1, 1, 3)), "filmic")
    with pytest.raises(ImageError, match="finite number of stops"):
        apply_view(np.zeros((1, 1, 3)), "srgb", float("nan"))
    with pytest.raises(ImageError, match="needs RGB"):
        apply_view(np.zeros((2, 2, 1)), "agx")
