"""Spectra as colours, against closed forms and against Mitsuba."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from raykiln.errors import SceneError
from raykiln.formats.spectra import (
    Role,
    read_spd,
    rgb_of_blackbody,
    rgb_of_constant,
    rgb_of_samples,
    rgb_of_srgb,
)
from raykiln.metals import METALS, optical_constants

SPECTRA = [
    ([400.0, 700.0], [0.5, 0.5]),
    ([400.0, 500.0, 600.0, 700.0], [0.1, 0.3, 0.6, 0.7]),
    ([360.0, 780.0], [1.0, 0.2]),
    ([400.0, 500.0, 550.0, 560.0, 700.0], [0.2, 0.25, 0.8, 0.3, 0.4]),
]


def test_a_constant_reflectance_is_grey() -> None:
    assert_allclose(rgb_of_samples([300, 900], [0.25, 0.25], "reflectance"), [0.25] * 3, atol=2e-4)
    assert rgb_of_constant(0.25, "reflectance") == (0.25, 0.25, 0.25)
    assert rgb_of_constant(3.0, "index") == (3.0, 3.0, 3.0)


def test_a_constant_emission_has_the_colour_of_equal_energy() -> None:
    white = np.linalg.inv([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722],
                           [0.0193, 0.1192, 0.9505]]) @ np.ones(3)  # fmt: skip
    assert_allclose(rgb_of_constant(2.0, "emission"), 2 * white, rtol=2e-3)


@given(st.floats(0.01, 2.0), st.floats(0.01, 2.0))
def test_colours_are_linear_in_the_values(a: float, b: float) -> None:
    wavelengths = [380.0, 500.0, 600.0, 750.0]
    x, y = np.array([1.0, 1.2, 1.1, 1.0]), np.array([1.0, 0.9, 1.0, 1.3])
    mixed = rgb_of_samples(wavelengths, (a * x + b * y).tolist(), "emission")
    parts = [np.array(rgb_of_samples(wavelengths, v.tolist(), "emission")) for v in (x, y)]
    assert_allclose(mixed, a * parts[0] + b * parts[1], rtol=1e-9)


@pytest.mark.parametrize("spectrum", SPECTRA)
@pytest.mark.parametrize("role", ["reflectance", "emission", "index"])
def test_samples_agree_with_mitsuba(mitsuba: Any, spectrum: Any, role: Role) -> None:
    pairs = ", ".join(f"{w}:{v}" for w, v in zip(*spectrum, strict=True))
    tag, plugin, name = {
        "reflectance": ("bsdf", "diffuse", "reflectance"),
        "emission": ("emitter", "constant", "radiance"),
        "index": ("bsdf", "conductor", "eta"),
    }[role]
    other = '<spectrum name="k" value="1"/>' if role == "index" else ""
    text = f'<{tag} type="{plugin}" version="3.0.0"><spectrum name="{name}" value="{pairs}"/>'
    made = mitsuba.traverse(mitsuba.load_string(f"{text}{other}</{tag}>"))
    expected = np.array(made[f"{name}.value"])
    wavelengths, values = spectrum
    mine = np.array(rgb_of_samples(wavelengths, values, role))
    assert_allclose(mine, expected, rtol=5e-3, atol=1e-3)


@pytest.mark.parametrize("name", sorted(METALS))
def test_metals_agree_with_mitsuba(mitsuba: Any, name: str) -> None:
    data = f"{name}_palik" if name in ("Na", "Ni", "V") else name
    made = mitsuba.traverse(mitsuba.load_dict({"type": "conductor", "material": data}))
    constants = optical_constants(name)
    assert constants is not None
    for mine, key in zip(constants, ("eta", "k"), strict=True):
        expected = np.broadcast_to(np.array(made[f"{key}.value"]), 3)
        assert_allclose(mine, expected, rtol=1e-2, atol=1e-5)


def test_metals_by_their_other_names() -> None:
    assert optical_constants("Au_palik") == optical_constants("Au")
    assert optical_constants("Unobtainium") is None
    assert optical_constants("none") == ((0, 0, 0), (1, 1, 1))


def test_a_blackbody_at_the_temperature_of_daylight_is_nearly_white() -> None:
    r, g, b = rgb_of_blackbody(6504.0)
    assert_allclose([r / g, b / g], 1, atol=0.08)
    # Planck's radiance at 555 nm, where the eye is most sensitive, in W / (sr m^2 nm).
    assert 0.2126 * r + 0.7152 * g + 0.0722 * b == pytest.approx(4.28e4, rel=0.02)
    warm = rgb_of_blackbody(2700.0, 2.0)
    assert warm[0] > warm[1] > warm[2]
    assert_allclose(warm, 2 * np.array(rgb_of_blackbody(2700.0)))


def test_srgb_values_are_decoded() -> None:
    assert_allclose(rgb_of_srgb([0, 0.5, 1]), [0, 0.21404114, 1])
    assert rgb_of_srgb([0.04045, 0.04045, 0.04045])[0] == pytest.approx(0.0031308, rel=1e-3)


@pytest.mark.parametrize(
    ("wavelengths", "values"),
    [([500], [1]), ([], []), ([500, 400], [1, 1]), ([500, 500], [1, 1]), ([400, 500], [1])],
)
def test_samples_out_of_order_are_refused(wavelengths: Any, values: Any) -> None:
    with pytest.raises(SceneError, match="increasing wavelength"):
        rgb_of_samples(wavelengths, values, "index")


@pytest.mark.parametrize("temperature", [0, -5, 1e9, float("nan")])
def test_impossible_temperatures_are_refused(temperature: float) -> None:
    with pytest.raises(SceneError, match="kelvin"):
        rgb_of_blackbody(temperature)


def test_spd_files() -> None:
    assert read_spd(b"# comment\n400 1\n\n500.5 2.5 # more\n") == ([400, 500.5], [1, 2.5])
    with pytest.raises(SceneError, match="line 2"):
        read_spd(b"400 1\n500\n")
