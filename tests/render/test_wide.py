"""The wide estimator against the reference, path by path with the same random numbers."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import raykiln as rk
from raykiln import _core
from raykiln.compile import compile_scene

from .bit_scene import bit_scene
from .proof_scenes import SCENES
from .statistics import Floats
from .support import options

ALL = {**SCENES, "bits": bit_scene}
ISAS = ("sse4.2", "avx2", "avx512")


def render(
    scene: rk.Scene, *, reference: bool, few_triangles: bool = True, **settings: Any
) -> tuple[Floats, dict[str, int]]:
    resolved = rk.RenderSettings(
        **{"width": 48, "height": 40, "spp": 20, "filter": "box", "rr_depth": 3, **settings}
    ).over(scene.settings)
    compiled = compile_scene(scene, resolved)
    chosen = {**options(resolved), "reference": reference, "few_triangles": few_triangles}
    renderer = _core.Renderer(compiled.core, chosen)
    while not renderer.finished:
        renderer.run_pass(lambda _: True)
    planes = renderer.planes()
    image = planes["radiance"].astype(np.float64) / planes["counts"][..., None]
    return image, renderer.counts()


def assert_same_to_rounding(wide: Floats, reference: Floats) -> None:
    """A rounding may send a path another way, which changes a few pixels for good."""
    off = np.abs(wide - reference).max(axis=2) / (reference.max(axis=2) + 1e-3)
    assert np.median(off) < 1e-5
    assert (off > 1e-3).mean() < 0.03
    assert wide.mean() == pytest.approx(reference.mean(), rel=2e-3)


@pytest.mark.parametrize("max_depth", [1, 2, 7])
@pytest.mark.parametrize("name", ALL)
def test_wide_paths_are_the_reference_paths(name: str, max_depth: int) -> None:
    scene = ALL[name]()
    wide, counts = render(scene, reference=False, max_depth=max_depth)
    reference, expected = render(scene, reference=True, max_depth=max_depth)
    assert_same_to_rounding(wide, reference)
    assert counts["camera_rays"] == expected["camera_rays"]
    for kind in ("bounce_rays", "shadow_rays"):
        assert counts[kind] == pytest.approx(expected[kind], rel=2e-3)


def test_few_triangles_need_no_hierarchy() -> None:
    scene = rk.load_scene("cornell_box")
    all_of_them, counts = render(scene, reference=False)
    hierarchy, expected = render(scene, reference=False, few_triangles=False)
    assert_same_to_rounding(all_of_them, hierarchy)
    assert not np.array_equal(all_of_them, hierarchy)  # or it was one way twice
    assert counts["bounce_rays"] == pytest.approx(expected["bounce_rays"], rel=2e-3)


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("integrator", ["path", "direct"])
def test_wide_paths_follow_the_settings(integrator: str, sampler: str) -> None:
    scene = bit_scene()
    settings: dict[str, Any] = {
        "integrator": integrator,
        "sampler": sampler,
        "filter": "gaussian",
        "seed": 7,
    }
    wide, _ = render(scene, reference=False, **settings)
    reference, _ = render(scene, reference=True, **settings)
    assert_same_to_rounding(wide, reference)


PROGRAM = """
import sys
import numpy as np
import raykiln as rk
settings = rk.RenderSettings(width=40, height=40, spp=17, filter="box", threads=1)
result = rk.render(rk.load_scene(sys.argv[2]), settings)
print(result.stats.isa)
np.save(sys.argv[1], result.image)
"""


@pytest.mark.parametrize("name", ["whitted_spheres", "cornell_box"])
@pytest.mark.parametrize("isa", ISAS)
def test_each_instruction_set_gives_the_picture(isa: str, name: str, tmp_path: Any) -> None:
    file = tmp_path / "image.npy"
    environment = {**os.environ, "RAYKILN_ISA": isa}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(file), name],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode != 0 and "cannot be used here" in run.stderr:
        pytest.skip(f"this processor has no {isa}")
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == isa
    settings = rk.RenderSettings(width=40, height=40, spp=17, filter="box")
    here = rk.render(rk.load_scene(name), settings).image.astype(np.float64)
    assert_same_to_rounding(np.load(file).astype(np.float64), here)
