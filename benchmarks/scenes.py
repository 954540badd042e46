"""Throughput of the bundled scenes: `./dev bench [SCENE ...] [--spp N] [--runs N] [--json F]`."""

from __future__ import annotations

import argparse
import json
import statistics
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import raykiln as rk

HEADER = f"{'scene':24} " + " ".join(
    f"{title:>{width}}"
    for title, width in [
        ("triangles", 10),
        ("BVH s", 8),
        ("render s", 8),
        ("spread", 6),
        ("Ms/s", 8),
        ("Mrays/s", 8),
        ("MiB", 8),
    ]
)


def measure(name: str, settings: rk.RenderSettings, runs: int) -> dict[str, Any]:
    """Render one scene `runs` times; medians of times and rates."""
    scene = rk.load_scene(name)
    stats = [rk.render(scene, settings).stats.as_dict() for _ in range(runs)]
    seconds = [run["render_s"] for run in stats]
    return {
        "scene": name,
        "triangles": stats[0]["triangles"],
        "samples": stats[0]["samples"],
        "bvh_s": statistics.median(run["bvh_s"] for run in stats),
        "render_s": statistics.median(seconds),
        "render_s_spread": max(seconds) - min(seconds),
        "samples_per_s": statistics.median(run["samples"] / run["render_s"] for run in stats),
        "rays_per_s": statistics.median(run["rays_per_s"] for run in stats),
        "peak_memory_bytes": max(run["peak_memory_bytes"] for run in stats),
        "threads": stats[0]["threads"],
        "isa": stats[0]["isa"],
    }


def as_line(row: dict[str, Any]) -> str:
    """One line of the table."""
    return (
        f"{row['scene']:24} {row['triangles']:>10,} {row['bvh_s']:8.3f} {row['render_s']:8.2f} "
        f"±{row['render_s_spread'] / 2:5.2f} {row['samples_per_s'] / 1e6:8.2f} "
        f"{row['rays_per_s'] / 1e6:8.2f} {row['peak_memory_bytes'] / 2**20:8.0f}"
    )


def main() -> None:
    """Measure, print a table, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names or files; default: all bundled scenes")
    parser.add_argument("--size", type=int, default=256, help="width and height in pixels")
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also write the numbers here")
    given = parser.parse_args()
    settings = rk.RenderSettings(width=given.size, height=given.size, spp=given.spp)
    print(HEADER)
    rows = []
    # A process for each scene: peak memory never falls within one.
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        for name in given.scenes or sorted(rk.bundled_scenes()):
            rows.append(processes.submit(measure, name, settings, given.runs).result())
            print(as_line(rows[-1]), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
