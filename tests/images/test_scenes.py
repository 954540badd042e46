"""The bundled scenes: what they hold, how they look, and that their generators make them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk
import scene_references as references
from raykiln.compile import scene_sha256
from raykiln.image import read_image, write_exr
from raykiln.scene import (
    Conductor,
    Dielectric,
    DirectionalLight,
    EnvironmentLight,
    Instance,
    Mesh,
    Principled,
)
from scene_references import Reference

NAMES = [
    "cornell_box", "instanced_forest", "many_lights", "product_shot", "veach_mis",
    "whitted_spheres",
]  # fmt: skip
MIN_SHARE = 0.9975
MAX_BYTES, MAX_BYTES_IN_ALL = 1_500_000, 6_000_000


@pytest.fixture(scope="module")
def scenes_folder(repo_root: Path) -> Path:
    """The scenes of the checkout."""
    return repo_root / "scenes"


def keep_failure(name: str, image: references.Floats, reference: Reference) -> Path:
    """Write what a failed comparison is to be understood by."""
    folder = Path(__file__).parent / "failures"
    folder.mkdir(exist_ok=True)
    layers = {
        "image": image,
        "reference": reference.mean,
        "error": image - reference.mean,
        "p_value": reference.p_values(image),
    }
    for layer, pixels in layers.items():
        write_exr(folder / f"{name}_{layer}.exr", {"beauty": pixels.astype(np.float32)})
    return folder


def test_the_bundled_scenes() -> None:
    assert list(rk.bundled_scenes()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_looks_like_its_reference(name: str) -> None:
    image = references.render(rk.load_scene(name))
    reference = Reference.read(name)
    shares = references.passes(reference, image)
    if min(shares.values()) < MIN_SHARE:
        folder = keep_failure(name, image, reference)
        pytest.fail(f"{name}: shares that pass are {shares}; see {folder}")


def brighter_lamp(scene: rk.Scene) -> None:
    lamp = next(shape for shape in scene.shapes if shape.name == "light")
    assert isinstance(lamp, Mesh)
    assert lamp.emission is not None
    assert isinstance(lamp.emission.radiance, tuple)
    r, g, b = lamp.emission.radiance
    lamp.emission.radiance = (1.04 * r, g, b)


def moved_block(scene: rk.Scene) -> None:
    block = next(shape for shape in scene.shapes if shape.name == "short block")
    assert isinstance(block, Mesh)
    assert block.vertices is not None
    block.vertices = block.vertices + np.array([0.02, 0, 0], np.float32)


def sun_moved(scene: rk.Scene) -> None:
    sun = scene.lights[1]
    assert isinstance(sun, DirectionalLight)
    x, y, z = sun.direction
    sun.direction = (x, y, z + 0.06)


def no_birches(scene: rk.Scene) -> None:
    scene.shapes = [s for s in scene.shapes if not (isinstance(s, Instance) and s.group == "birch")]


def lamps_out(scene: rk.Scene) -> None:
    del scene.shapes[-60:]


def sky_turned(scene: rk.Scene) -> None:
    (sky,) = (light for light in scene.lights if isinstance(light, EnvironmentLight))
    c, s = float(np.cos(0.15)), float(np.sin(0.15))
    sky.transform = ((c, 0, s, 0), (0, 1, 0, 0), (-s, 0, c, 0), (0, 0, 0, 1))


def gold_gone(scene: rk.Scene) -> None:
    mug = scene.materials["mug"]
    assert isinstance(mug, Principled)
    mug.metallic = 0.0


def dull_brass(scene: rk.Scene) -> None:
    brass = scene.materials["brass"]
    assert isinstance(brass, Principled)
    brass.roughness = 0.45


def rougher_plate(scene: rk.Scene) -> None:
    metal = scene.materials["metal 3"]
    assert isinstance(metal, Conductor)
    metal.alpha = 0.07


def other_glass(scene: rk.Scene) -> None:
    glass = scene.materials["glass"]
    assert isinstance(glass, Dielectric)
    glass.int_ior = 1.45


@pytest.mark.parametrize(
    ("name", "tamper"),
    [
        ("cornell_box", brighter_lamp),
        ("cornell_box", moved_block),
        ("instanced_forest", sun_moved),
        ("instanced_forest", no_birches),
        ("many_lights", lamps_out),
        ("product_shot", sky_turned),
        ("product_shot", gold_gone),
        ("product_shot", dull_brass),
        ("veach_mis", rougher_plate),
        ("whitted_spheres", other_glass),
    ],
)
def test_a_tampered_scene_does_not(name: str, tamper: Callable[[rk.Scene], None]) -> None:
    scene = rk.load_scene(name)
    tamper(scene)
    shares = references.passes(Reference.read(name), references.render(scene))
    assert min(shares.values()) < MIN_SHARE, shares


def test_the_spheres_render_with_the_path_tracer_too() -> None:
    """Which sees the same sky, and all the light that Whitted's estimator sees, and more."""
    scene = rk.load_scene("whitted_spheres")
    settings = references.settings_of(scene, 0)
    whitted, traced = (
        rk.render(scene, settings.model_copy(update={"integrator": kind})).image
        for kind in ("whitted", "path")
    )
    np.testing.assert_allclose(traced[:5], whitted[:5], rtol=1e-3)
    ratio = traced.mean(axis=(0, 1)) / whitted.mean(axis=(0, 1))
    assert (ratio > 1.0).all()
    assert (ratio < 1.25).all(), ratio


@pytest.mark.parametrize("name", NAMES)
def test_loads_without_a_warning(name: str) -> None:
    scene = rk.load_scene(name)
    report = rk.check(scene)
    assert (scene.warnings, report.warnings) == ([], [])
    assert scene.description
    assert scene.name
    assert {"width", "height", "spp", "max_depth"} <= scene.settings.keys()


def test_each_scene_holds_what_it_is_for() -> None:
    reports = {name: rk.check(rk.load_scene(name)) for name in NAMES}
    assert reports["instanced_forest"].triangles > 1_000_000
    assert reports["many_lights"].lights == 1000
    assert reports["whitted_spheres"].spheres == 3
    assert reports["whitted_spheres"].settings["integrator"] == "whitted"
    assert reports["veach_mis"].spheres == 4
    # 18 quadrilaterals: 5 of the walls with the ceiling's 4, 5 of each block, and the light.
    assert reports["cornell_box"].triangles == 2 * (4 + 4 + 5 + 5 + 1)
    assert reports["product_shot"].textures >= 4


def test_the_lamps_of_veach_have_equal_power() -> None:
    lamps = [s for s in rk.load_scene("veach_mis").shapes if s.type == "sphere"]
    powers = []
    for lamp in lamps:
        assert lamp.emission is not None
        luminance = np.dot(np.asarray(lamp.emission.radiance), [0.2126, 0.7152, 0.0722])
        powers.append(luminance * 4 * np.pi**2 * lamp.radius**2)
    np.testing.assert_allclose(powers, powers[0], rtol=1e-4)


def test_the_scenes_are_small(scenes_folder: Path) -> None:
    sizes = {p: p.stat().st_size for p in scenes_folder.rglob("*") if p.is_file()}
    assert max(sizes.values()) < MAX_BYTES
    assert sum(sizes.values()) < MAX_BYTES_IN_ALL


@contextmanager
def generators(folder: Path) -> Iterator[Callable[[str], Any]]:
    """The modules of `folder`, importable by their plain names for a while."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield import_module
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if str(folder) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]


@pytest.mark.parametrize("name", NAMES)
def test_the_generator_makes_the_scene(name: str, scenes_folder: Path, tmp_path: Path) -> None:
    with generators(scenes_folder / "generate") as load_module:
        files = load_module(name).build()
    for file, content in files.items():
        stored = (scenes_folder / file).read_bytes()
        # Packed arrays and images depend on the compressor too: their content counts.
        assert content == stored or b"base64" in content or not file.endswith(".json")
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_bytes(content)
    entry = tmp_path / rk.bundled_scenes()[name].name
    made, stored_scene = rk.load_scene(entry), rk.load_scene(name)
    assert made.settings == stored_scene.settings
    assert scene_sha256(made) == scene_sha256(stored_scene)
    for file in files:
        if file.endswith(".exr"):
            np.testing.assert_array_equal(
                read_image(tmp_path / file), read_image(scenes_folder / file)
            )


def test_the_command_lists_them() -> None:
    command = [sys.executable, "-m", "raykiln_service.cli", "scenes"]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert [line.split()[0] for line in out.splitlines()] == NAMES
    for name, line in zip(NAMES, out.splitlines(), strict=True):
        assert line.split(maxsplit=1)[1] == rk.load_scene(name).description
