"""Every way to estimate an image has the same mean."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
import raykiln as rk
from raykiln import _core
from raykiln.compile import compile_scene

from .proof_scenes import SCENES
from .statistics import Estimate, excess
from .support import ceiling_light, floor, looking, options, render_runs

SMALL: dict[str, Any] = {"width": 32, "height": 32, "filter": "box", "rr_depth": -1}


def assert_equal_means(a: Estimate, b: Estimate, *, relative: float = 0.005) -> None:
    """Of the whole image tightly, of its sixteenths within their error bars."""
    for across in (1, 4):
        off = excess(a.blocks(across), b.blocks(across), relative=relative, sigmas=4.5)
        assert off.max() <= 1, f"{across} x {across} blocks: {off.max():.2f} of what is allowed"


EFFORTS = [
    pytest.param(32, id="quick"),
    pytest.param(256, id="close", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("spp", EFFORTS)
@pytest.mark.parametrize("strategy", ["light", "bsdf"])
@pytest.mark.parametrize("name", SCENES)
def test_one_strategy_has_the_mean_of_both(name: str, strategy: str, spp: int) -> None:
    scene = SCENES[name]()
    settings = {**SMALL, "max_depth": 4}
    both = render_runs(scene, 12, spp=spp, **settings)
    alone = render_runs(scene, 12, spp=4 * spp, strategy=strategy, seed=100, **settings)
    assert_equal_means(alone, both)


@pytest.mark.parametrize("option", ["strategy", "sampler", "integrator", "filter"])
def test_a_name_that_is_not_known_is_an_error(option: str) -> None:
    settings = rk.RenderSettings(width=4, height=4, spp=1)
    scene = next(iter(SCENES.values()))()
    resolved = settings.over(scene.settings)
    compiled = compile_scene(scene, resolved)
    with pytest.raises(rk.SettingsError, match=rf'{option}: .*found "lights", accepted: \w+, \w+'):
        _core.Renderer(compiled.core, {**options(resolved), option: "lights"})


@pytest.mark.parametrize("name", SCENES)
def test_both_strategies_have_less_noise_than_one(name: str) -> None:
    scene = SCENES[name]()
    settings = {**SMALL, "spp": 16, "max_depth": 3}
    noise = {
        strategy: render_runs(scene, 8, strategy=strategy, **settings).standard_error.mean()
        for strategy in ("mis", "light", "bsdf")
    }
    assert noise["mis"] < 1.25 * min(noise["light"], noise["bsdf"])


def test_lights_that_look_small_are_left_to_light_samples() -> None:
    # Nothing but the lamp could be at the end of a second ray.
    scene = looking(rk.Scene(), (0, 1, 3), (0, 0, 0))
    scene.add_material("white", rk.Diffuse(reflectance=0.7))
    scene.add_material("black", rk.Diffuse(reflectance=0.0))
    scene.shapes += [floor("white", half=2.0), ceiling_light(50.0, 0.1, 3.0)]
    settings = {**SMALL, "spp": 16, "max_depth": 2}
    assert rk.render(scene, rk.RenderSettings(**settings)).stats.bounce_rays == 0
    joined = render_runs(scene, 1, **settings).runs
    assert (joined == render_runs(scene, 1, strategy="light", **settings).runs).all()
    bsdf = render_runs(scene, 12, strategy="bsdf", **{**settings, "spp": 4096})
    assert_equal_means(bsdf, render_runs(scene, 4, **settings), relative=0.01)


@pytest.mark.parametrize("name", SCENES)
def test_samplers_have_equal_means(name: str) -> None:
    scene = SCENES[name]()
    settings = {**SMALL, "max_depth": 4}
    sobol = render_runs(scene, 12, spp=32, **settings)
    independent = render_runs(scene, 12, spp=64, sampler="independent", seed=50, **settings)
    assert_equal_means(independent, sobol)
    assert sobol.standard_error.mean() < independent.standard_error.mean() * 2**0.5


@pytest.mark.parametrize("name", SCENES)
def test_roulette_keeps_the_mean(name: str) -> None:
    scene = SCENES[name]()
    settings = {**SMALL, "spp": 64, "max_depth": 12}
    never = render_runs(scene, 10, **settings)
    early = render_runs(scene, 10, seed=50, **{**settings, "rr_depth": 1})
    assert_equal_means(early, never)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("filter_name", ["tent", "gaussian", "blackman_harris"])
def test_filters_keep_the_mean_inside(name: str, filter_name: str) -> None:
    # What a filter takes from beyond the edge is not in the box's image: compare a crop of it
    # with the same blocks shifted by less than they are wide.
    scene = SCENES[name]()
    settings = {**SMALL, "spp": 32, "max_depth": 3}
    box = render_runs(scene, 6, **settings).whole()
    other = render_runs(scene, 6, seed=50, **{**settings, "filter": filter_name}).whole()
    assert excess(other, box, relative=0.03, sigmas=4.5).max() <= 1


@pytest.mark.parametrize("name", SCENES)
def test_each_depth_adds_light(name: str) -> None:
    # The same random numbers serve the same vertices: a longer path only adds to a shorter one.
    scene = SCENES[name]()
    images = [
        render_runs(scene, 1, spp=8, **{**SMALL, "max_depth": depth}).runs[0]
        for depth in (1, 2, 3, 4, 6)
    ]
    for shorter, longer in pairwise(images):
        assert (longer - shorter).min() >= -1e-5 * longer.max()
    assert images[-1].mean() >= images[1].mean() > images[0].mean()


@pytest.mark.parametrize("name", ["area_light", "environment", "inside_a_lamp"])
@pytest.mark.parametrize("integrator", ["direct", "whitted"])
def test_direct_light_by_other_integrators(name: str, integrator: str) -> None:
    scene = SCENES[name]()
    path = render_runs(scene, 12, spp=64, **{**SMALL, "max_depth": 2})
    other = render_runs(
        scene, 12, spp=64, seed=50, integrator=integrator, **{**SMALL, "max_depth": 2}
    )
    assert_equal_means(other, path)
