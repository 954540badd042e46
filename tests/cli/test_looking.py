"""`raykiln inspect`, `compare` and `scenes`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from raykiln.image import read_image, write_exr, write_png

from .support import Run, write_scene


def test_inspect_counts_what_would_be_loaded(raykiln: Run, scene: Path) -> None:
    ran = raykiln("inspect", scene, "--json")
    assert ran.code == 0
    assert ran.json["renderable"] is True
    assert ran.json["spheres"] == 1
    assert ran.json["warnings"] == []
    text = raykiln("inspect", scene)
    assert text.code == 0
    assert "spheres" in text.out


def test_inspect_says_warnings_and_still_succeeds(raykiln: Run, tmp_path: Path) -> None:
    dark = write_scene(tmp_path / "dark.json", lights=[])
    ran = raykiln("inspect", dark)
    assert ran.code == 0
    assert "raykiln: warning: " in ran.err
    assert len(raykiln("inspect", dark, "--json").json["warnings"]) == 1


def test_inspect_of_what_cannot_be_rendered(raykiln: Run, tmp_path: Path) -> None:
    shapes = [{"type": "sphere", "material": "gold"}]
    broken = write_scene(tmp_path / "broken.json", shapes=shapes)
    ran = raykiln("inspect", broken)
    assert ran.code == 2
    assert "gold" in ran.error
    ran = raykiln("inspect", broken, "--json")
    assert ran.code == 2
    assert ran.json["renderable"] is False
    assert "gold" in str(ran.json["error"])
    assert raykiln("inspect", "nothing.json").code == 2


def test_inspect_of_every_bundled_scene(raykiln: Run) -> None:
    names = [row["name"] for row in raykiln("scenes", "--json").json]
    assert "cornell_box" in names
    for name in names:
        assert raykiln("inspect", name, "--json").json["renderable"] is True


def test_scenes_are_listed_a_line_each(raykiln: Run) -> None:
    rows = raykiln("scenes", "--json").json
    lines = raykiln("scenes").out.splitlines()
    assert [line.split()[0] for line in lines] == [row["name"] for row in rows]


@pytest.fixture
def images(tmp_path: Path) -> tuple[Path, Path]:
    """A reference, and an image half as bright."""
    pixels = np.full((24, 32, 3), 0.5, dtype=np.float32)
    half, whole = tmp_path / "half.exr", tmp_path / "whole.exr"
    write_exr(whole, {"beauty": pixels})
    write_exr(half, {"beauty": pixels / 2})
    return half, whole


def test_compare_measures(raykiln: Run, images: tuple[Path, Path]) -> None:
    ran = raykiln("compare", *images, "--json", "--heatmap", "d.png")
    assert ran.code == 0
    assert ran.json["mean_ratio"] == pytest.approx(0.5)
    assert ran.json["mse"] == pytest.approx(0.0625)
    assert ran.json["rel_mse"] == pytest.approx(0.0625 / 0.26)
    assert ran.json["flip"] > 0
    assert read_image("d.png").shape == (24, 32, 3)


def test_compare_of_equal_images(raykiln: Run, images: tuple[Path, Path]) -> None:
    ran = raykiln("compare", images[1], images[1])
    assert ran.code == 0
    words = [line.split() for line in ran.out.splitlines()]
    assert ["MSE", "0"] in words
    assert ["PSNR", "(dB)", "inf"] in words


def test_compare_refuses_what_it_cannot_compare(
    raykiln: Run, images: tuple[Path, Path], tmp_path: Path
) -> None:
    small, text = tmp_path / "small.png", tmp_path / "text.png"
    write_png(small, np.zeros((2, 2, 3), dtype=np.uint8))
    text.write_text("hello")
    for other, message in (
        (small, "differ in size"),
        (text, "text.png"),
        (tmp_path / "nothing.exr", "nothing.exr"),
        (tmp_path, str(tmp_path)),
    ):
        ran = raykiln("compare", images[0], other)
        assert ran.code == 2
        assert message in ran.error
    ran = raykiln("compare", *images, "--heatmap", "d.jpg")
    assert ran.code == 2
    assert "--heatmap: " in ran.error
