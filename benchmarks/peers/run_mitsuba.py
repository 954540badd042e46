"""Render one job with Mitsuba 3 (variant "llvm_ad_rgb" or "scalar_rgb")."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from child import Clock, finish, job

given = job()
clock = Clock()
with clock.phase("import_s"):
    mi: Any = importlib.import_module("mitsuba")
    dr: Any = importlib.import_module("drjit")
    mi.set_variant(given["variant"])
wide = given["variant"].startswith("llvm")
if wide:
    dr.set_thread_count(given["threads"])
    # Times of compilation are taken from each launch.
    dr.set_flag(dr.JitFlag.KernelHistory, True)


def rendered(scene: Any, spp: int, seed: int) -> Any:
    """The image, once it is there."""
    image = mi.render(scene, spp=spp, seed=seed)
    if wide:
        dr.eval(image)
        dr.sync_thread()
    return image


def compile_s() -> float:
    """Seconds spent on compiling since the last call."""
    if not wide:
        return 0.0
    launches = dr.kernel_history()
    return float(sum(k.get("codegen_time", 0) + k.get("backend_time", 0) for k in launches)) / 1e3


with clock.phase("read_s"):
    parameters = {
        "size": given["size"],
        "spp": given["spp"],
        "depth": given["depth"],
        "rr_depth": 5 if given["rr"] is None else 100000 if given["rr"] < 0 else given["rr"],
        "sampler": given["sampler"] or "independent",
        "watertight": str(given["watertight"]).lower(),
    }
    scene = mi.load_file(f"{given['scene']}/mitsuba.xml", **parameters)
    if wide:
        dr.sync_thread()
outcome: dict[str, Any] = {"version": mi.__version__}
if given["task"] != "load":
    if given["task"] == "render":
        rendered(scene, 4, given["seed"] + 1)
    compile_s()
    with clock.phase("render_s"):
        image = rendered(scene, given["spp"], given["seed"])
    # Throughput is that of rendering: a kernel that was still compiled does not count.
    compiled = compile_s()
    clock.seconds["render_s"] -= compiled if given["task"] == "render" else 0.0
    outcome |= {"compile_s": compiled, "spp": int(scene.sensors()[0].sampler().sample_count())}
    if given["exr"] is not None:
        mi.Bitmap(image).write(given["exr"])
    if given["image"] is not None:
        np.save(given["image"], np.array(image)[..., :3])
finish(given, {**clock.seconds, **outcome})
