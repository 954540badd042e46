"""Render options: what they become, and what is said about bad ones."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from raykiln.settings import RenderSettings
from raykiln_service.commands.console import CommandError
from raykiln_service.commands.options import (
    RenderOptions,
    accepted_values,
    option_of,
    parse_crop,
    parse_size,
    settings_of,
)


def test_only_given_options_are_set() -> None:
    settings = RenderOptions(spp=3, size="20x10", aov=["normal,depth", "albedo"]).settings()
    assert settings.model_fields_set == {"spp", "width", "height", "aovs"}
    assert (settings.width, settings.height, settings.spp) == (20, 10, 3)
    assert settings.aovs == ("normal", "depth", "albedo")


def test_no_options_leave_everything_to_the_scene() -> None:
    assert RenderOptions().settings().model_fields_set == set()


def test_every_setting_has_an_option() -> None:
    every = RenderOptions(
        spp=1,
        size="4x4",
        max_depth=2,
        rr_depth=3,
        integrator="ao",
        sampler="independent",
        filter="box",
        camera="c",
        crop="0,0,1,1",
        seed=1,
        threads=1,
        time_budget=1.0,
        noise_threshold=0.1,
        aov=["depth"],
        denoise=True,
    )
    assert every.settings().model_fields_set == set(RenderSettings.model_fields)


@given(st.integers(1, 65536), st.integers(1, 65536), st.sampled_from(["x", "X", "×", " x "]))
def test_sizes_are_read_back(width: int, height: int, times: str) -> None:
    assert parse_size(f"{width}{times}{height}") == (width, height)


@pytest.mark.parametrize(
    "text", ["", "512", "512x", "x512", "1.5x2", "axb", "1x2x3", "9" * 30 + "x1"]
)
def test_what_is_not_a_size_is_refused(text: str) -> None:
    with pytest.raises(CommandError, match=r"--size: not a size \(found .*accepted: WIDTHxHEIGHT"):
        parse_size(text)


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d", "1,2,3,4,5", "-1,0,3,3"])
def test_what_is_not_a_crop_is_refused(text: str) -> None:
    with pytest.raises(CommandError, match="--crop: not a crop window"):
        parse_crop(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spp": 0}, r"--spp: .*\(found 0\); accepted: 1 to 1048576"),
        ({"size": "0x10"}, r"--size: .*\(found 0\); accepted: 1 to 65536"),
        ({"size": "10x-3"}, r"--size: .*\(found -3\); accepted: 1 to 65536"),
        ({"size": "100000x100000"}, r"--size: .*\(found 100000\); accepted: 1 to 65536"),
        ({"size": "65536x65536"}, r"--size: .*over the limit"),
        ({"max_depth": 0}, "^--max-depth: max_depth must be"),
        ({"crop": "5,5,5,9"}, "^--crop: crop must lie"),
        ({"crop": "0,0,9,9", "size": "8x8"}, "^--crop: crop must lie within the 8 x 8 image"),
        ({"integrator": "magic"}, r"--integrator: .*accepted: path, whitted, direct, ao"),
        ({"aov": ["colour"]}, r"--aov: .*found 'colour'.*accepted: albedo, normal, depth"),
        ({"time_budget": -1.0}, r"--time-budget: .*accepted: a number above 0"),
        ({"threads": -1}, r"--threads: .*accepted: 0 to 1024"),
        ({"seed": 1 << 32}, r"--seed: "),
    ],
)
def test_a_bad_option_is_named_with_what_is_accepted(options: dict[str, Any], message: str) -> None:
    with pytest.raises(CommandError, match=message) as caught:
        RenderOptions(**options).settings()
    assert caught.value.exit_code == 2


def test_settings_from_elsewhere_name_their_place() -> None:
    with pytest.raises(CommandError, match=r"jobs.jsonl: line 3: spp: .*\(found 0\)"):
        settings_of({"spp": 0}, "jobs.jsonl: line 3")
    with pytest.raises(CommandError, match=r"line 3: samples: no such setting; accepted: .*spp"):
        settings_of({"samples": 1}, "line 3")


@pytest.mark.parametrize("field", sorted(RenderSettings.model_fields))
def test_every_field_has_words_for_an_error(field: str) -> None:
    assert option_of(field).startswith("--")
    free = {"camera", "crop", "denoise"}
    assert (accepted_values(field) is None) == (field in free)
