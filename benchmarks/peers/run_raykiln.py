"""Render one job with raykiln, through its public API, in a fresh process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from child import Clock, finish, job

given = job()
clock = Clock()
with clock.phase("import_s"):
    import raykiln as rk

values: dict[str, Any] = {
    "width": given["size"],
    "height": given["size"],
    "spp": given["spp"],
    "max_depth": given["depth"],
    "seed": given["seed"],
    "threads": given["threads"],
    "filter": "box",
}
# What is not given is our default.
if given["rr"] is not None:
    values["rr_depth"] = given["rr"]
if given["sampler"] is not None:
    values["sampler"] = given["sampler"]

if given["task"] == "load":
    # What reading imports, as `import raykiln` does not: a part of it, measured by itself.
    with clock.phase("read_imports_s"):
        from raykiln.formats import native, ply  # noqa: F401
        from raykiln.rendering import check  # noqa: F401
    clock.seconds["read_s"] = clock.seconds["read_imports_s"]

with clock.phase("read_s"):
    scene = rk.load_scene(Path(given["scene"]) / "raykiln.json")
if given["task"] == "load":
    with clock.phase("read_s"):
        rk.check(scene, rk.RenderSettings(**values))
    finish(given, {**clock.seconds, "version": rk.__version__})
else:
    rendered = rk.render(scene, rk.RenderSettings(**values))
    if given["exr"] is not None:
        rendered.save(given["exr"])
    if given["image"] is not None:
        import numpy as np

        np.save(given["image"], rendered.image)
    stats = rendered.stats
    finish(
        given,
        {
            **clock.seconds,
            "version": rk.__version__,
            "build_s": stats.load_s + stats.bvh_s,
            "render_s": stats.render_s,
            "spp": stats.spp,
            "rays": stats.camera_rays + stats.bounce_rays + stats.shadow_rays,
            "nonfinite": stats.nonfinite_samples,
            "isa": stats.isa,
        },
    )
