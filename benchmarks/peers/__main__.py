"""raykiln against every renderer that one could install instead.

`./dev bench peers [--quick] [--publish]`: makes an environment with Mitsuba 3, LuxCore and Cycles,
writes four scenes for each, checks that the images agree, runs all in turn, and prints a table.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import environment
import replay
import report
from environment import UnavailableError, say
from exports import export
from four_scenes import SCENES
from measure import Bench, Plan
from process import ChildFailedError, Children

ROOT = Path(__file__).resolve().parents[2]
FULL = Plan(runs=3, seconds=6.0, reference_s=90.0, whole_scenes=tuple(SCENES))
QUICK = Plan(runs=1, seconds=1.0, reference_s=10.0)


def main() -> None:
    """Measure, print, and write JSON; with --publish also the page and its plots."""
    given = _arguments()
    work = given.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    if given.only == "report":
        results = json.loads((work / "results.json").read_text())
    else:
        try:
            results = _measure(given, work)
        except (UnavailableError, ChildFailedError) as error:
            sys.exit(f"bench: error: {error}")
    print(report.as_text(results))
    if given.publish:
        _publish(results, environment.peers_python(work))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="dev bench peers", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one short run each: a first look")
    parser.add_argument("--scene", action="append", choices=list(SCENES), help="default: all four")
    parser.add_argument("--contender", action="append", default=[], help="by key; default: all")
    parser.add_argument("--runs", type=int, help=f"default: {FULL.runs}, quick {QUICK.runs}")
    parser.add_argument("--seconds", type=float, help="length of a run")
    parser.add_argument("--reference-seconds", type=float, help="for each of two renderers")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "peers", help="folder")
    parser.add_argument("--only", choices=["scenes", "processes", "replay", "report"])
    parser.add_argument("--publish", action="store_true", help="write docs/performance.md, plots")
    return parser.parse_args()


def _measure(given: argparse.Namespace, work: Path) -> dict[str, Any]:
    plain = QUICK if given.quick else FULL
    plan = Plan(
        given.runs or plain.runs,
        given.seconds or plain.seconds,
        given.reference_seconds or plain.reference_s,
        tuple(given.contender),
        plain.whole_scenes,
    )
    machine = environment.machine()
    environment.require_system_packages()
    children = Children(work, environment.peers_python(work))
    path = work / "results.json"
    results: dict[str, Any] = json.loads(path.read_text()) if given.only and path.is_file() else {}
    results["machine"] = machine
    benches = {}
    for name in given.scene or list(SCENES):
        say(f"{name}: writing the scene for each renderer")
        scene = SCENES[name]()
        benches[name] = Bench(scene, export(scene, work / "scenes"), children, plan)
        benches[name].prepare()
    parts = {"scenes": _scenes, "processes": _processes, "replay": _replay}
    for part, function in parts.items():
        if given.only in (None, part):
            for _ in function(benches, results):
                # Kept after each scene: an hour's work should not hang on the last minute.
                path.write_text(json.dumps(results, indent=1) + "\n")
    return results


def _scenes(benches: dict[str, Bench], results: dict[str, Any]) -> Iterator[None]:
    kept = results.setdefault("scenes", {})
    for name, bench in benches.items():
        reference, facts = bench.reference()
        contenders = bench.in_turn(reference)
        kept[name] = {"plan": vars(bench.plan), "reference": facts, "contenders": contenders}
        yield


def _processes(benches: dict[str, Bench], results: dict[str, Any]) -> Iterator[None]:
    whole = results.setdefault("whole", {})
    for name, bench in benches.items():
        if name not in bench.plan.whole_scenes:
            continue
        say(f"{name}: whole processes")
        if name == "cornell":
            results["cold"] = bench.cold()
        whole[name] = bench.whole(bench.plan.runs if name == "cornell" else 1)
        yield
    if "displaced_sphere" in benches:
        say("reading and building 1.3 M triangles")
        bench = benches["displaced_sphere"]
        results["loading"] = bench.loading(bench.plan.runs)
        yield
    children = next(iter(benches.values())).children
    engines = ("raykiln", "mitsuba", "cycles", "luxcore")
    results["import_s"] = {e: [children.import_s(e) for _ in range(3)] for e in engines}
    yield


def _replay(benches: dict[str, Bench], results: dict[str, Any]) -> Iterator[None]:
    kept = results.setdefault("replay", {})
    for name, bench in benches.items():
        say(f"{name}: replaying the rays with the bare ray tracer")
        kept[name] = replay.measure(bench)
        yield


def _publish(results: dict[str, Any], python: Path) -> None:
    page, folder = ROOT / "docs" / "performance.md", ROOT / "docs" / "images" / "performance"
    folder.mkdir(parents=True, exist_ok=True)
    data = json.dumps(report.medians(results))
    plots = Path(__file__).with_name("plots.py")
    subprocess.run([str(python), str(plots), str(folder)], input=data, text=True, check=True)
    report.write_page(results, page, folder)
    say(f"wrote {page} and {folder}")


if __name__ == "__main__":
    main()
