"""Plots of the sweeps: `python plots.py scaling.json FOLDER` (needs matplotlib)."""

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


def main() -> None:
    """One figure of four plots."""
    results = json.loads(Path(sys.argv[1]).read_text())
    figure, axes = pyplot.subplots(2, 2, figsize=(9, 6.5), layout="constrained")
    for axis, kind, title in (
        (axes[0, 0], "pixels", "Time by pixels"),
        (axes[0, 1], "spp", "Time by samples a pixel"),
    ):
        numbers = [p[kind] for p in results[kind]]
        axis.loglog(numbers, [p["render_s"] for p in results[kind]], "o-", label="measured")
        last = results[kind][-1]
        linear = [last["render_s"] * n / numbers[-1] for n in numbers]
        axis.loglog(numbers, linear, ":", color="grey", label="linear")
        axis.set(title=title, xlabel=kind, ylabel="seconds")
        axis.legend()
    points = results["triangles"]
    axes[1, 0].semilogx(
        [p["triangles"] for p in points], [1e9 * p["render_s"] / p["samples"] for p in points], "o-"
    )
    axes[1, 0].set(title="Time of a sample by triangles", xlabel="triangles", ylabel="ns")
    points = results["lights"]
    relative = [p["cost"] / points[0]["cost"] for p in points]
    axes[1, 1].semilogx([p["lights"] for p in points], relative, "o-")
    axes[1, 1].set(
        title="Cost at equal quality by lights", xlabel="lights", ylabel="relMSE x s, 10 lights = 1"
    )
    for axis in axes.flat:
        axis.set_ylim(bottom=0) if axis.get_yscale() == "linear" else None
        axis.grid(alpha=0.3)
    figure.savefig(Path(sys.argv[2]) / "scaling.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
