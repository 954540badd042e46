"""How near the limit the core is: its rays per second against those of Embree alone.

A render's rays are recorded where it calls Embree and traced again, in the same scene and process,
by bare loops: one at a time in the renderer's own order, and in packets of 8 and 16 of one kind and
depth.  The ceiling takes the quickest way for each kind.
"""

from __future__ import annotations

import math
import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contenders import CONTENDERS
from environment import UnavailableError

if TYPE_CHECKING:
    from measure import Bench

SAMPLES = 1 << 20
MAX_RAYS = 40_000_000
THREADS = 2
REPEATS = 3


def library(work: Path) -> Path:
    """The recorder, built with the system's compiler and Embree."""
    sources = sorted(Path(__file__).with_name("recorder").glob("*.cpp"))
    headers = sorted(Path(__file__).with_name("recorder").glob("*.h"))
    target = work / "librecorder.so"
    newest = max(f.stat().st_mtime for f in [*sources, *headers])
    if target.is_file() and target.stat().st_mtime > newest:
        return target
    version = 4 if Path("/usr/include/embree4").is_dir() else 3
    flags = ["-std=c++20", "-O3", "-march=native", "-shared", "-fPIC", "-pthread"]
    # Linked though nothing seems to need it: the hooks look for the next definition after theirs.
    links = ["-Wl,--no-as-needed", f"-lembree{version}", "-ldl"]
    command = ["c++", *flags, "-o", str(target), *map(str, sources), *links]
    built = subprocess.run(command, check=False, capture_output=True, text=True)
    if built.returncode != 0:
        raise UnavailableError(f"the recorder does not build:\n{built.stderr[-2000:]}")
    return target


def measure(bench: Bench) -> dict[str, Any]:
    """Rays per second of the renderer and of the bare loops, for one scene."""
    recorder = library(bench.children.work)
    spp = 2 ** max(0, round(math.log2(SAMPLES / bench.pixels)))
    told = {
        "scene": str(bench.folder),
        "size": bench.scene.size,
        "depth": bench.scene.depth,
        "spp": spp,
        "library": str(recorder),
        "rays": MAX_RAYS,
        "repeats": REPEATS,
        "threads": THREADS,
    }
    before = os.environ.get("LD_PRELOAD")
    os.environ["LD_PRELOAD"] = str(recorder)
    try:
        recorded = bench.children.run("replay", told)
    finally:
        if before is None:
            del os.environ["LD_PRELOAD"]
        else:
            os.environ["LD_PRELOAD"] = before
    ours = next(c for c in CONTENDERS if c.key == "raykiln")
    spp = bench.calibrated_spp(ours, bench.plan.seconds)
    plain = [bench.render(ours, spp, 1 + i)[0] for i in range(bench.plan.runs)]
    rates = sorted(run["rays"] / run["render_s"] for run in plain)
    return {**summary(recorded), "render_rays_per_s": rates[len(rates) // 2]}


def summary(recorded: dict[str, Any]) -> dict[str, Any]:
    """The rates of the bare loops."""
    kinds = {name: kind for name, kind in recorded["kinds"].items() if kind["rays"]}
    total = sum(kind["rays"] for kind in kinds.values())
    if total == 0:
        raise UnavailableError("no ray was recorded: the module does not use a shared libembree")
    single_s = sum(kind["ways"]["1"]["seconds"] for kind in kinds.values())
    best = {
        name: min(kind["ways"].items(), key=lambda way: way[1]["seconds"])
        for name, kind in kinds.items()
    }
    return {
        "recorded_rays": total,
        "counted_rays": recorded["rays"],
        "rays_by_kind": {name: kind["rays"] for name, kind in kinds.items()},
        "hits_by_kind": {
            name: {way: numbers["hits"] for way, numbers in kind["ways"].items()}
            for name, kind in kinds.items()
        },
        "rays_per_s_by_kind": {
            name: {way: kind["rays"] / n["seconds"] for way, n in kind["ways"].items()}
            for name, kind in kinds.items()
        },
        "best_way": {name: way for name, (way, _) in best.items()},
        "single_rays_per_s": total / single_s,
        "ceiling_rays_per_s": total / sum(numbers["seconds"] for _, numbers in best.values()),
    }
