"""Plots of the results: medians as JSON on standard input, SVG into a folder.

Runs in the peers' environment, which has matplotlib.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

matplotlib: Any = importlib.import_module("matplotlib")
matplotlib.use("Agg")
pyplot: Any = importlib.import_module("matplotlib.pyplot")
# The same file for the same numbers.
matplotlib.rcParams["svg.hashsalt"] = "raykiln"

OURS, PEER = "#c2410c", "#64748b"
PLOTS = {
    "samples_per_s": ("Throughput", "million samples a second", 1e6),
    "efficiency": ("Efficiency", "1 / (relMSE x seconds)", 1.0),
}


def bars(results: dict[str, Any], key: str, path: Path) -> None:
    """One panel a scene, one bar a contender, ours in colour."""
    title, label, unit = PLOTS[key]
    scenes = results["scenes"]
    figure, axes = pyplot.subplots(
        1, len(scenes), figsize=(3.2 * len(scenes) + 2.2, 4), layout="constrained", sharey=True
    )
    for axis, (name, entries) in zip(
        [axes] if len(scenes) == 1 else axes, scenes.items(), strict=True
    ):
        names = list(entries)[::-1]
        values = [entries[n][key] / unit for n in names]
        colors = [OURS if n.startswith("raykiln") else PEER for n in names]
        axis.barh([results["titles"][n] for n in names], values, color=colors)
        axis.set(title=name.replace("_", " "), xlabel=label)
        axis.grid(axis="x", alpha=0.3)
    figure.suptitle(title)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Draw what there is."""
    results = json.loads(sys.stdin.read())
    if results["scenes"]:
        for key in PLOTS:
            bars(results, key, Path(sys.argv[1]) / f"{key}.svg")


if __name__ == "__main__":
    main()
