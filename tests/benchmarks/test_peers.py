"""What the comparison with other renderers rests on: its errors, its checks, its scenes."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk


@pytest.fixture
def bench(repo_root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Imports a module of the benchmark by name."""
    monkeypatch.syspath_prepend(str(repo_root / "benchmarks" / "peers"))
    return importlib.import_module


def noisy(truth: Any, sigma: float, seed: int) -> Any:
    """An image with relative noise."""
    noise = np.random.default_rng(seed).normal(0.0, sigma, truth.shape)
    return (truth * (1 + noise)).astype(np.float32)


TRUTH = np.random.default_rng(9).uniform(0.2, 2.0, (256, 256, 3)).astype(np.float32)


def test_noise_of_the_references_drops_out(bench: Any) -> None:
    quality = bench("quality")
    reference = quality.Reference(noisy(TRUTH, 0.03, 1), noisy(TRUTH, 0.03, 2))
    image = noisy(TRUTH, 0.03, 3)
    true_error = float(np.mean((image - TRUTH) ** 2 / (TRUTH**2 + 0.01)))
    assert reference.rel_mse(image) == pytest.approx(true_error, rel=0.05)
    # Against one noisy image, the noise would count as error.
    assert reference.plain_rel_mse(image) > 1.4 * true_error
    assert reference.noise() == pytest.approx(0.03**2 / 2, rel=0.1)


def test_the_same_scene_with_noise_agrees(bench: Any) -> None:
    found = bench("quality").agreement(noisy(TRUTH, 0.3, 1), TRUTH)
    assert found["mean_agrees"]
    assert found["blocks_off"] == 0


def test_a_brighter_image_does_not_agree(bench: Any) -> None:
    assert not bench("quality").agreement(TRUTH * np.float32(1.02), TRUTH)["mean_agrees"]


def test_a_shifted_part_does_not_agree(bench: Any) -> None:
    """Two errors that cancel in the mean still show in blocks."""
    image = TRUTH.copy()
    image[:32, :32] *= 1.2
    image[32:64, :32] *= 0.8
    found = bench("quality").agreement(image, TRUTH)
    assert found["mean_agrees"]
    assert found["blocks_off"] == 2


@pytest.mark.parametrize(
    ("sampler", "wanted", "spp"),
    [("independent", 100.2, 100), ("multijitter", 110.0, 100), (None, 100.0, 128), (None, 0.1, 4)],
)
def test_samples_suit_the_sampler(bench: Any, sampler: str | None, wanted: float, spp: int) -> None:
    contender = bench("contenders").Contender("key", "title", "engine", sampler=sampler)
    assert contender.nearest_spp(wanted) == spp


def test_scenes_can_be_rendered(bench: Any, tmp_path: Path) -> None:
    """The exported files are what the descriptions say, up to the last triangle."""
    scenes = bench("four_scenes").SCENES
    for name in ("cornell", "many_lights"):
        described = scenes[name]()
        folder = bench("exports").export(described, tmp_path)
        report = rk.check(rk.load_scene(folder / "raykiln.json"))
        assert report.warnings == []
        assert report.triangles == sum(len(part.mesh.faces) for part in described.parts)
        lit = [len(p.mesh.faces) for p in described.parts if p.radiance is not None]
        assert report.lights == sum(lit) // 2  # a square of two triangles is one light


def test_scenes_are_the_same_at_each_making(bench: Any) -> None:
    shapes = bench("shapes")
    first, second = shapes.displaced_sphere(4), shapes.displaced_sphere(4)
    assert np.array_equal(first.vertices, second.vertices)
    assert len(first.faces) == 20 * 4**4
    # Closed and facing outwards: the signed volume is that of a sphere of about the same size.
    a, b, c = (first.vertices[first.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi, rel=0.1)


def test_a_part_that_was_measured_alone_is_reported(bench: Any) -> None:
    machine = bench("environment").machine()
    text = bench("report").as_text({"machine": machine})
    assert f"{machine['cores']} cores" in text
    assert "###" not in text
