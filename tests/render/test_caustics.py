"""Light that smooth surfaces focus: the guide takes noise away and leaves the mean."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .proof_scenes import SCENES as DULL
from .statistics import Estimate, excess
from .support import ceiling_light, floor, looking, placed, render_runs, sha256
from .test_wide import assert_same_to_rounding

SETTINGS: dict[str, Any] = {"width": 48, "height": 48, "spp": 32, "filter": "box", "max_depth": 6}


def _sun() -> rk.EnvironmentLight:
    """A dim sky with a sun of a pixel, high and behind."""
    pixels = np.full((32, 64, 3), 0.2, np.float32)
    pixels[7, 40] = 900, 800, 600
    return rk.EnvironmentLight(pixels=pixels)


def _stage(floor_material: Any) -> rk.Scene:
    scene = rk.Scene()
    scene.add_material("floor", floor_material)
    scene.add_material("black", rk.Diffuse(reflectance=0.0))
    scene.shapes.append(floor("floor"))
    return looking(scene, (0, 2.6, 4.5), (0, 0.5, 0))


def sun_through_a_ball() -> rk.Scene:
    """A glass ball on a diffuse floor under a map with a sun."""
    scene = _stage(rk.Diffuse(reflectance=0.6))
    scene.add_sphere((0, 0.81, 0), 0.8, rk.Dielectric())
    scene.add_light(_sun())
    return scene


def box_with_balls() -> rk.Scene:
    """A lamp on the ceiling, a ball of glass, one of mirror, two walls."""
    scene = _stage(rk.Diffuse(reflectance=0.7))
    for x, color in ((-1.6, (0.6, 0.1, 0.1)), (1.6, (0.1, 0.6, 0.1))):
        wall = rk.Cube(material=f"wall{x}", transform=placed((x, 1.5, 0), (0.05, 1.5, 1.6)))
        scene.add_material(f"wall{x}", rk.Diffuse(reflectance=color))
        scene.shapes.append(wall)
    scene.add_sphere((-0.7, 0.6, 0.3), 0.6, rk.Dielectric())
    scene.add_sphere((0.8, 0.6, -0.5), 0.6, rk.Conductor(metal="Ag"))
    scene.shapes.append(ceiling_light((20.0, 18.0, 14.0), 0.3, 2.9))
    return scene


def brushed_metal() -> rk.Scene:
    """The focus of a glass ball on rough metal."""
    scene = _stage(rk.Conductor(metal="Al", alpha=0.3))
    scene.add_sphere((0, 0.9, 0), 0.7, rk.Dielectric())
    scene.add_light(_sun())
    return scene


def polished_plastic() -> rk.Scene:
    """The same on plastic, whose coat is a mirror beside its diffuse base."""
    scene = _stage(rk.Plastic(diffuse_reflectance=(0.5, 0.3, 0.2)))
    scene.add_sphere((0, 0.9, 0), 0.7, rk.Dielectric())
    scene.add_light(_sun())
    return scene


def principled_floor() -> rk.Scene:
    """The same on a principled floor, from a principled ball that lets light through."""
    scene = _stage(rk.Principled(base_color=(0.7, 0.6, 0.3), roughness=0.4, metallic=0.4))
    scene.add_sphere((-0.8, 0.9, 0), 0.7, rk.Principled(roughness=0.05, transmission=1.0))
    scene.add_sphere((0.8, 0.7, 0), 0.6, rk.Principled(roughness=0.1, metallic=1.0))
    scene.add_sphere((0.5, 4.5, 2.0), 0.3, "black", emission=60.0)
    return scene


def frosted_receiver() -> rk.Scene:
    """Light from a ball into frosted glass, which scatters to both sides."""
    scene = _stage(rk.Diffuse(reflectance=0.5))
    scene.add_material("frosted", rk.Dielectric(alpha=0.3))
    pane = placed((0, 0.4, 0), (1.5, 0.1, 1.5))
    scene.shapes.append(rk.Cube(material="frosted", transform=pane))
    scene.add_sphere((0, 1.4, 0), 0.7, rk.Dielectric())
    scene.add_light(_sun())
    return scene


def instanced_glass() -> rk.Scene:
    """Turned, unevenly scaled instances of a mesh of glass."""
    scene = _stage(rk.Diffuse(reflectance=0.6))
    scene.add_material("glass", rk.Dielectric())
    points = np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32
    )
    faces = np.array([[i, 2 + j, 4 + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    odd = np.array([(i + j + k) % 2 for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    faces[odd == 1] = faces[odd == 1][:, ::-1]
    scene.add_mesh(points, faces.astype(np.uint32), material="glass", group="gem")
    places = [
        placed((-0.8, 0.9, 0), (0.7, 0.8, 0.6), turn_x_deg=20),
        placed((0.8, 0.8, 0), (-0.6, 0.6, 0.7), turn_x_deg=-40),
    ]
    scene.add_instances("gem", np.array(places, np.float32))
    scene.add_light(_sun())
    return scene


SCENES: dict[str, Callable[[], rk.Scene]] = {
    make.__name__: make
    for make in (
        sun_through_a_ball, box_with_balls, brushed_metal, polished_plastic, principled_floor,
        frosted_receiver, instanced_glass,
    )
}  # fmt: skip


def render(
    scene: rk.Scene,
    *,
    guide: bool = True,
    strategy: str = "mis",
    reference: bool = False,
    runs: int = 1,
    seed: int = 1,
    **settings: Any,
) -> Estimate:
    """Renders with seeds from `seed` on; each learns a guide of its own."""
    core = {"caustic_guide": guide, "reference": reference}
    chosen = {**SETTINGS, **settings}
    return render_runs(scene, runs, strategy=strategy, seed=seed, core=core, **chosen)


@cache
def guided(name: str, spp: int, runs: int) -> Estimate:
    return render(SCENES[name](), spp=spp, runs=runs)


@cache
def unguided(name: str, spp: int, runs: int) -> Estimate:
    return render(SCENES[name](), spp=spp, runs=runs, seed=1000, guide=False)


def assert_equal_means(a: Estimate, b: Estimate, *, relative: float = 0.01) -> None:
    """Of the whole image, and of its sixteenths, within their error bars."""
    for across in (1, 4):
        off = excess(a.blocks(across), b.blocks(across), relative=relative, sigmas=4.0)
        assert off.max() <= 1, f"{across} x {across} blocks: {off.max():.2f} of what is allowed"


EFFORTS = [
    pytest.param(48, 20, 0.01, id="quick"),
    pytest.param(512, 48, 0.002, id="close", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("spp", "runs", "relative"), EFFORTS)
@pytest.mark.parametrize("name", SCENES)
def test_guide_keeps_the_mean(name: str, spp: int, runs: int, relative: float) -> None:
    assert_equal_means(guided(name, spp, runs), unguided(name, 2 * spp, runs), relative=relative)


@pytest.mark.parametrize(("spp", "runs", "relative"), EFFORTS)
@pytest.mark.parametrize("strategy", ["light", "bsdf"])
def test_guided_strategies_have_equal_means(
    strategy: str, spp: int, runs: int, relative: float
) -> None:
    # The caustic itself is found by all of them; they differ in the direct light of the sun.
    name = "sun_through_a_ball"
    alone = render(SCENES[name](), spp=4 * spp, runs=runs, seed=500, strategy=strategy)
    assert_equal_means(alone, guided(name, spp, runs), relative=relative)


@pytest.mark.parametrize(("name", "factor"), [("sun_through_a_ball", 4.0), ("box_with_balls", 1.5)])
def test_guide_takes_noise_away(name: str, factor: float) -> None:
    with_guide, without = guided(name, 256, 8), unguided(name, 256, 8)
    seen = 0.5 * (with_guide.mean + without.mean).mean(axis=2)
    noise = [
        float(np.mean(e.luminance().var(axis=0, ddof=1) / (seen**2 + 1e-6)))
        for e in (with_guide, without)
    ]
    assert noise[0] * factor < noise[1]


@pytest.mark.parametrize("name", SCENES)
def test_wide_paths_ask_the_guide_as_the_reference_does(name: str) -> None:
    wide = render(SCENES[name](), spp=20, rr_depth=3).mean
    reference = render(SCENES[name](), spp=20, rr_depth=3, reference=True).mean
    assert_same_to_rounding(wide, reference)


class TestBits:
    """Every part and every repetition has the guide of the whole image."""

    settings = rk.RenderSettings(**{**SETTINGS, "width": 53, "height": 41, "aovs": ("variance",)})

    def image(self, name: str = "sun_through_a_ball", **changes: Any) -> Any:
        settings = self.settings.model_copy(update=changes)
        return rk.render(SCENES[name](), settings).image

    @pytest.mark.parametrize("name", ["sun_through_a_ball", "principled_floor"])
    @pytest.mark.parametrize("threads", [1, 2, 5])
    def test_threads_and_repetition(self, name: str, threads: int) -> None:
        assert sha256(self.image(name, threads=threads)) == sha256(self.image(name))

    @pytest.mark.parametrize("crop", [(0, 0, 53, 41), (7, 20, 40, 33), (30, 30, 31, 31)])
    def test_crops(self, crop: tuple[int, int, int, int]) -> None:
        x0, y0, x1, y1 = crop
        np.testing.assert_array_equal(self.image(crop=crop), self.image()[y0:y1, x0:x1])

    def test_resume(self, tmp_path: Any) -> None:
        path, scene = tmp_path / "state", SCENES["sun_through_a_ball"]()
        part = rk.render(scene, self.settings, lambda p: p.samples <= 5 * 53 * 41, checkpoint=path)
        assert not part.complete
        rest = rk.render(scene, self.settings, checkpoint=path, resume=True)
        assert sha256(rest.image) == sha256(self.image())


def with_and_without(scene: rk.Scene, **settings: Any) -> tuple[str, str]:
    """Hashes of an image with a guide, and of one without."""
    few = {"spp": 8, **settings}
    return (
        sha256(render(scene, **few).runs),
        sha256(render(scene, guide=False, **few).runs),
    )


@pytest.mark.parametrize("reference", [False, True])
class TestNothingToGuide:
    """Where no path could gain, the bits are those of a render without a guide."""

    def test_guide_is_at_work_elsewhere(self, reference: bool) -> None:
        for name, make in SCENES.items():
            a, b = with_and_without(make(), reference=reference, max_depth=4)
            assert a != b, name

    @pytest.mark.parametrize("max_depth", [1, 2])
    def test_paths_too_short_for_a_caustic(self, reference: bool, max_depth: int) -> None:
        scene = sun_through_a_ball()
        a, b = with_and_without(scene, reference=reference, max_depth=max_depth)
        assert a == b

    @pytest.mark.parametrize("integrator", ["direct", "whitted", "ao"])
    def test_other_integrators(self, reference: bool, integrator: str) -> None:
        scene = sun_through_a_ball()
        a, b = with_and_without(scene, reference=reference, integrator=integrator)
        assert a == b

    @pytest.mark.parametrize("name", DULL)
    def test_no_smooth_surface(self, reference: bool, name: str) -> None:
        a, b = with_and_without(DULL[name](), reference=reference)
        assert a == b

    def test_caustic_in_frosted_glass_alone(self, reference: bool) -> None:
        # Its own lobes are narrow: what a guide took from them would be missed.
        scene = _stage(rk.Dielectric(alpha=0.3))
        scene.add_sphere((0, 0.9, 0), 0.7, rk.Dielectric())
        scene.add_light(_sun())
        a, b = with_and_without(scene, reference=reference)
        assert a == b

    def test_no_light_that_has_a_size(self, reference: bool) -> None:
        scene = _stage(rk.Diffuse(reflectance=0.5))
        scene.add_sphere((0, 0.9, 0), 0.7, rk.Dielectric())
        scene.add_light(rk.PointLight(position=(0, 4, 1), intensity=9.0))
        a, b = with_and_without(scene, reference=reference)
        assert a == b
