"""What a render costs by threads, pixels, samples, triangles and lights.

`./dev bench scaling [--quick] [--publish]`: tables, JSON, and plots for docs/performance.md.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import sweeps

Json = dict[str, Any]
ROOT = Path(__file__).resolve().parents[2]
BEGIN, END = "<!-- scaling -->", "<!-- end of scaling -->"
QUIET_LOAD = 0.5
SCENES = ["cornell_box", "many_lights", "product_shot", "instanced_forest"]
PIXELS = [64, 128, 256, 512]
SPP = [4, 16, 64, 256]
TRIANGLES = [100, 1_000, 10_000, 100_000, 1_000_000, 4_000_000]
LIGHTS = [10, 100, 1_000, 10_000, 100_000]


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="dev bench scaling", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer, shorter runs")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "scaling", help="folder")
    parser.add_argument("--python", type=Path, help="one with matplotlib, for the plots")
    parser.add_argument("--publish", action="store_true", help="draw the plots into docs/images")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    if load > QUIET_LOAD:
        print(f"warning: the load average is {load:.2f}: these numbers are disturbed", flush=True)
    results = measured(1 if given.quick else 3, 1 if given.quick else 4)
    results["load_average"] = load
    path = given.work / "scaling.json"
    path.write_text(json.dumps(results, indent=1) + "\n")
    print(f"wrote {path}")
    if given.publish:
        python = given.python or ROOT / "build" / "peers" / "venv" / "bin" / "python"
        if not python.is_file():
            sys.exit("bench: error: no Python with matplotlib: run `./dev bench peers` or --python")
        folder = ROOT / "docs" / "images" / "performance"
        folder.mkdir(parents=True, exist_ok=True)
        plots = Path(__file__).with_name("plots.py")
        subprocess.run([str(python), str(plots), str(path), str(folder)], check=True)
        publish(results, ROOT / "docs" / "performance.md")


def measured(runs: int, factor: int) -> Json:
    """All sweeps; `factor` times the samples of the quick mode."""
    return {
        "threads": [threads(name, runs, 16 * factor) for name in SCENES],
        "pixels": [row("pixels", n * n, runs, "cornell_box", n, 16 * factor, 0) for n in PIXELS],
        "spp": [row("spp", n, runs, "cornell_box", 128, n * factor, 0) for n in SPP],
        "triangles": [row("triangles", n, runs, n, 256, 8 * factor, 0) for n in TRIANGLES],
        "lights": [light_row(n, 128, 64 * factor) for n in LIGHTS],
    }


def publish(results: Json, page: Path) -> None:
    """Put the numbers and the plot into the page."""
    rows = ["| Scene | 1 thread, Msamples/s | all cores | ratio |", "| --- | ---: | ---: | ---: |"]
    for t in results["threads"]:
        one, all_cores = t["one"] / 1e6, t["all"] / 1e6
        rows.append(f"| {t['scene']} | {one:.2f} | {all_cores:.2f} | {all_cores / one:.2f} |")
    rows += ["", "| Triangles | build, s | ns a sample | MiB |", "| ---: | ---: | ---: | ---: |"]
    rows += [
        f"| {t['triangles']:,} | {t['bvh_s']:.3f} | {1e9 * t['render_s'] / t['samples']:.0f} "
        f"| {t['peak_bytes'] / 2**20:.0f} |"
        for t in results["triangles"]
    ]
    rows += ["", "| Lights | relMSE x spp | cost at equal quality |", "| ---: | ---: | ---: |"]
    first = results["lights"][0]["cost"]
    rows += [
        f"| {t['lights']:,} | {t['error_per_sample']:.3f} | {t['cost'] / first:.2f} |"
        for t in results["lights"]
    ]
    disturbed = f"**Warning: the load average was {results['load_average']:.2f}.**\n\n"
    note = disturbed if results["load_average"] > QUIET_LOAD else ""
    text = f"{note}![scaling](images/performance/scaling.svg)\n\n" + "\n".join(rows)
    before, rest = page.read_text().split(BEGIN)
    page.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.split(END)[1]}")


def fresh(function: Callable[..., Json], *arguments: Any) -> Json:
    """Call in a process of its own: peak memory never falls within one."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def row(kind: str, number: int, runs: int, *render: Any) -> Json:
    """Medians of one point of a sweep."""
    done = [fresh(sweeps.timed, kind, *render) for _ in range(runs)]
    point = {key: statistics.median(run[key] for run in done) for key in done[0]}
    per_sample = point["render_s"] / point["samples"] * 1e9
    print(
        f"{kind:10} {number:>9,} {point['render_s']:8.3f} s {per_sample:8.0f} ns a sample "
        f"{point['bvh_s']:7.3f} s build {point['peak_bytes'] / 2**20:6.0f} MiB",
        flush=True,
    )
    return {kind: number, **point}


def threads(name: str, runs: int, spp: int) -> Json:
    """The rate with one thread and with all cores, in turn."""
    cores = os.cpu_count() or 1
    rates: dict[int, list[float]] = {1: [], cores: []}
    for _ in range(runs):
        for count, kept in rates.items():
            kept.append(fresh(sweeps.timed, "scene", name, 256, spp, count)["samples_per_s"])
    one, all_cores = (statistics.median(rates[count]) for count in (1, cores))
    print(
        f"threads    {name:18} 1: {one / 1e6:.2f} Ms/s, {cores}: {all_cores / one:.2f} x",
        flush=True,
    )
    return {"scene": name, "threads": cores, "one": one, "all": all_cores}


def light_row(count: int, size: int, spp: int) -> Json:
    """Cost at equal quality: relMSE times seconds."""
    point = fresh(sweeps.lit, count, size, spp)
    print(
        f"lights     {count:>9,} {point['render_s']:8.3f} s  relMSE x spp "
        f"{point['error_per_sample']:.4f}  relMSE x s {point['cost']:.6f}",
        flush=True,
    )
    return point


if __name__ == "__main__":
    main()
