"""Rendering for proofs: many runs, one strategy alone, small scenes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import raykiln as rk
from raykiln import _core
from raykiln.compile import compile_scene

from .statistics import Estimate, Floats

FAILURES = Path(__file__).parent / "failures"
IDENTITY = np.eye(4)


def options(settings: rk.RenderSettings, strategy: str = "mis") -> dict[str, Any]:
    """What the core's renderer takes, with the strategy that only proofs choose."""
    names = ("width", "height", "spp", "seed", "threads", "filter", "integrator", "sampler")
    return {
        **{name: getattr(settings, name) for name in (*names, "max_depth", "rr_depth")},
        **dict.fromkeys(("albedo", "normal", "depth"), False),
        "crop": settings.crop or (0, 0, settings.width, settings.height),
        "strategy": strategy,
    }


def render_runs(
    scene: rk.Scene,
    runs: int,
    *,
    strategy: str = "mis",
    seed: int = 1,
    core: Mapping[str, bool] | None = None,
    **settings: Any,
) -> Estimate:
    """Independent renders of a scene that is built once, with seeds from `seed` on.

    `core`: options of the core's renderer that only proofs choose.
    """
    resolved = rk.RenderSettings(**settings).over(scene.settings)
    compiled = compile_scene(scene, resolved)
    images = []
    for run in range(runs):
        once = resolved.model_copy(update={"seed": seed + run})
        renderer = _core.Renderer(compiled.core, {**options(once, strategy), **(core or {})})
        while not renderer.finished:
            renderer.run_pass(lambda _: True)
        assert renderer.counts()["nonfinite_samples"] == 0
        planes = renderer.planes()
        images.append(planes["radiance"].astype(np.float64) / planes["counts"][..., None])
    return Estimate(np.stack(images))


def radiance(scene: rk.Scene, **settings: Any) -> Floats:
    """The image of one render, in double precision."""
    defaults = {"width": 16, "height": 16, "spp": 64, "filter": "box"}
    result = rk.render(scene, rk.RenderSettings(**{**defaults, **settings}))
    assert result.stats.nonfinite_samples == 0
    return result.image.astype(np.float64)


def sha256(image: Any) -> str:
    """Of an array's bytes."""
    return hashlib.sha256(np.ascontiguousarray(image).tobytes()).hexdigest()


def looking(
    scene: rk.Scene, origin: Any, target: Any, *, fov_deg: float = 40.0, up: Any = (0, 1, 0)
) -> rk.Scene:
    """The scene, seen by a camera at `origin`."""
    scene.set_camera(origin=origin, target=target, up=up, fov_deg=fov_deg)
    return scene


def placed(
    translate: Any = (0, 0, 0), scale: Any = (1, 1, 1), turn_x_deg: float = 0.0
) -> tuple[tuple[float, ...], ...]:
    """The matrix that scales, then turns about x, then moves."""
    angle = np.radians(turn_x_deg)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ np.diag(scale)
    matrix[:3, 3] = translate
    return tuple(tuple(float(x) for x in row) for row in matrix)


def floor(material: str | None, half: float = 5.0, y: float = 0.0) -> rk.Rectangle:
    """A square that faces up."""
    return rk.Rectangle(
        material=material, transform=placed((0, y, 0), (half, half, 1), turn_x_deg=-90)
    )


def ceiling_light(radiance: Any, half: float, y: float) -> rk.Rectangle:
    """A black square that shines down."""
    return rk.Rectangle(
        material="black",
        transform=placed((0, y, 0), (half, half, 1), turn_x_deg=90),
        emission=rk.Emission(radiance=radiance),
    )


def write_failure(name: str, image: Floats, reference: Floats, p: Floats | None = None) -> Path:
    """Write image, reference and error as PNG and EXR; returns the folder."""
    FAILURES.mkdir(exist_ok=True)
    error = image - reference
    pictures = {"image": image, "reference": reference, "error": np.abs(error) * 10}
    for kind, picture in pictures.items():
        shown = rk_image().to_png_pixels(picture.astype(np.float32))
        rk_image().write_png(FAILURES / f"{name}-{kind}.png", shown)
    layers = {"beauty": image.astype(np.float32), "error": error.astype(np.float32)}
    layers["reference"] = reference.astype(np.float32)
    if p is not None:
        layers["p"] = p.astype(np.float32)
    rk_image().write_exr(FAILURES / f"{name}.exr", layers)
    return FAILURES


def rk_image() -> Any:
    """The image package, imported where a failure needs it."""
    from raykiln import image

    return image
