"""Record the rays of a render by raykiln, and trace them again with Embree alone.

Runs with the recorder's library preloaded (see `replay.py`).
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Any

import raykiln as rk
from child import finish, job
from raykiln import _core
from raykiln.compile import compile_scene

KINDS = ("camera", "bounce", "shadow")
WAYS = {"1": (1, 0), "8": (8, 0), "8 coherent": (8, 1), "16": (16, 0), "16 coherent": (16, 1)}

given = job()
library = ctypes.CDLL(given["library"])
library.recorder_start.argtypes = [ctypes.c_int64, ctypes.POINTER(ctypes.c_float)]
library.recorder_replay.restype = ctypes.c_double
outcome: dict[str, Any] = {"version": rk.__version__}


def ways(kind: int) -> dict[str, Any]:
    """Seconds, and rays that met something, for each way of calling Embree."""
    hits = ctypes.c_int64()
    done = {}
    for name, (width, coherent) in WAYS.items():
        seconds = library.recorder_replay(
            kind, width, coherent, given["threads"], given["repeats"], ctypes.byref(hits)
        )
        done[name] = {"seconds": seconds, "hits": hits.value}
    return done


settings = rk.RenderSettings(
    width=given["size"],
    height=given["size"],
    spp=given["spp"],
    max_depth=given["depth"],
    rr_depth=-1,
    seed=given["seed"],
    threads=given["threads"],
    filter="box",
)
scene = rk.load_scene(Path(given["scene"]) / "raykiln.json")
settings = settings.over(scene.settings)
compiled = compile_scene(scene, settings)
names = ("width", "height", "spp", "seed", "threads", "filter", "integrator", "sampler")
renderer = _core.Renderer(
    compiled.core,
    {
        **{name: getattr(settings, name) for name in (*names, "max_depth", "rr_depth")},
        **dict.fromkeys(("albedo", "normal", "depth"), False),
        "crop": (0, 0, settings.width, settings.height),
        # Scenes of a few triangles are traced without Embree, which would leave nothing to record.
        "few_triangles": False,
    },
)
origin = json.loads((Path(given["scene"]) / "neutral.json").read_text())["origin"]
library.recorder_start(given["rays"], (ctypes.c_float * 3)(*origin))
while not renderer.finished:
    renderer.run_pass(lambda _: True)
counts = (ctypes.c_int64 * len(KINDS))()
library.recorder_stop(counts)
if counts[0] != renderer.counts()["camera_rays"]:
    # Not every ray was kept, or the camera is elsewhere: the ways would be of other rays.
    sys.exit(f"{counts[0]} camera rays recorded, {renderer.counts()['camera_rays']} traced")
outcome["kinds"] = {
    name: {"rays": count, "ways": ways(i) if count else {}}
    for i, (name, count) in enumerate(zip(KINDS, counts, strict=True))
}
outcome["rays"] = sum(renderer.counts()[f"{name}_rays"] for name in KINDS)
finish(given, outcome)
