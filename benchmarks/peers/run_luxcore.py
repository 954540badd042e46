"""Render one job with LuxCore (PATHCPU)."""

from __future__ import annotations

import importlib
import time
from pathlib import Path
from typing import Any

import numpy as np
from child import Clock, finish, job

given = job()
clock = Clock()
with clock.phase("import_s"):
    lux: Any = importlib.import_module("pyluxcore")
    lux.Init()


def settings() -> dict[str, Any]:
    """The job's settings; nothing clamped, nothing denoised, no adaptive sampling."""
    size, bounces = given["size"], given["depth"]
    endless = 1 << 20
    sampler = (given["sampler"] or "sobol").upper()
    return {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": given["seed"] + 1,
        "native.threads.count": given["threads"],
        "sampler.type": sampler,
        f"sampler.{sampler.lower()}.adaptive.strength": 0.0,
        "lightstrategy.type": given.get("variant") or "LOG_POWER",
        "film.width": size,
        "film.height": size,
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "film.imagepipelines.0.0.type": "NOP",
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": given["exr"] or "unused.exr",
        "path.pathdepth.total": bounces,
        "path.pathdepth.diffuse": bounces,
        "path.pathdepth.glossy": bounces,
        "path.pathdepth.specular": bounces,
        "path.russianroulette.depth": {None: 3, -1: endless}.get(given["rr"], given["rr"]),
        "path.clamping.variance.maxvalue": 0.0,
        "path.forceblackbackground.enable": False,
        "batch.haltspp": given["spp"],
        "batch.halttime": 0,
    }


def properties(values: dict[str, Any]) -> Any:
    """The settings as LuxCore's own."""
    made = lux.Properties()
    for key, value in values.items():
        made.Set(lux.Property(key, value))
    return made


with clock.phase("read_s"):
    told = lux.Properties(str(Path(given["scene"]) / "luxcore.scn"))
    scene = lux.Scene()
    scene.Parse(told)
    session = lux.RenderSession(lux.RenderConfig(properties(settings()), scene))
    begun = time.perf_counter()
    session.Start()
with clock.phase("render_s"):
    while not session.HasDone():
        session.UpdateStats()
        time.sleep(0.002)
session.UpdateStats()
stats = session.GetStats()
outcome = {
    "version": lux.Version(),
    # It may take some more than it was asked for.
    "spp": stats.Get("stats.renderengine.total.samplecount").GetFloat() / given["size"] ** 2,
    "passes": stats.Get("stats.renderengine.pass").GetInt(),
    "engine_s": stats.Get("stats.renderengine.time").GetFloat(),
}
if given["task"] == "load":
    clock.seconds["read_s"] += clock.seconds.pop("render_s")
film = session.GetFilm()
if given["exr"] is not None:
    film.SaveOutput(given["exr"], lux.FilmOutputType.RGB, lux.Properties())
if given["image"] is not None:
    pixels = np.zeros((given["size"], given["size"], 3), np.float32)
    film.GetOutputFloat(lux.FilmOutputType.RGB, pixels)
    np.save(given["image"], pixels[::-1])
session.Stop()
finish(given, {**clock.seconds, **outcome})
