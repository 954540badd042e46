"""The results as text, and as the page docs/performance.md."""

from __future__ import annotations

import math
import statistics
from pathlib import Path
from typing import Any

from contenders import CONTENDERS, GIVEN_PBRT
from environment import load_warning
from four_scenes import SCENES

Json = dict[str, Any]
BEGIN, END = "<!-- results -->", "<!-- end of results -->"
OURS, OURS_DEFAULT = "raykiln", "raykiln-default"
MIB = 2**20


def median(runs: list[Json], key: str) -> float:
    """Of one number over runs."""
    return float(statistics.median(run[key] for run in runs))


def spread(runs: list[Json], key: str) -> float:
    """Half the distance between the greatest and the least, relative to the median."""
    values = [run[key] for run in runs]
    return float((max(values) - min(values)) / 2 / statistics.median(values))


def medians(results: Json) -> Json:
    """What plots need: by scene and contender."""
    keys = ("samples_per_s", "rel_mse", "error_per_sample", "efficiency", "spp", "peak_bytes")
    scenes = {
        name: {
            key: {k: median(entry["runs"], k) for k in keys}
            for key, entry in scene["contenders"].items()
        }
        for name, scene in results.get("scenes", {}).items()
    }
    titles = {c.key: c.title for c in CONTENDERS}
    return {"scenes": scenes, "titles": titles, "replay": results.get("replay", {})}


class Table:
    """A Markdown table whose columns also line up as plain text."""

    def __init__(self, *titles: str) -> None:
        self.rows: list[list[str]] = [list(titles)]

    def add(self, *cells: str) -> None:
        """One row."""
        self.rows.append(list(cells))

    def __str__(self) -> str:
        widths = [max(len(row[i]) for row in self.rows) for i in range(len(self.rows[0]))]
        pad = [
            [
                c.ljust(w) if i == 0 else c.rjust(w)
                for i, (c, w) in enumerate(zip(r, widths, strict=True))
            ]
            for r in self.rows
        ]
        rule = ["-" * w if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(widths)]
        lines = [pad[0], rule, *pad[1:]]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def as_text(results: Json) -> str:
    """All tables."""
    sections = [_head(results)]
    for name, scene in results.get("scenes", {}).items():
        sections += [f"### {SCENES_TITLES[name]}", _scene_lines(scene), str(_scene(name, scene))]
    if "scenes" in results:
        sections += ["### Ours against the best peer", str(_goals(results))]
        sections.append(_geometric_mean(results))
    if "whole" in results:
        sections += ["### Whole processes, 64 samples a pixel", _whole(results)]
    if "loading" in results and "import_s" in results:
        sections += ["### Reading and building 1.3 M triangles; importing", _loading(results)]
    if "replay" in results:
        sections += ["### Against bare Embree on the same rays", str(_replay(results))]
    return "\n\n".join(sections) + "\n"


SCENES_TITLES = {
    "cornell": "Cornell box, 256 x 256, depth 8",
    "displaced_sphere": "Displaced sphere, 1.3 M triangles, 512 x 512, depth 4",
    "glass_and_metal": "Glass and rough metal, sun and sky, 384 x 384, depth 16",
    "many_lights": "1,000 small lights, 384 x 384, depth 4",
}
SHORT_TITLES = {
    "cornell": "Cornell box",
    "displaced_sphere": "Displaced sphere",
    "glass_and_metal": "Glass and metal",
    "many_lights": "1,000 lights",
}
assert SCENES_TITLES.keys() == SHORT_TITLES.keys() == SCENES.keys()


def _head(results: Json) -> str:
    machine = results["machine"]
    memory = machine["memory_bytes"] / 2**30
    lines = [
        f"{machine['cpu']}, {machine['cores']} cores, {memory:.0f} GiB; {machine['system']}.",
        f"Versions: {_versions(results)}.",
    ]
    warning = load_warning(machine["load_average"][0])
    if warning is not None:
        lines.append(f"**Warning: {warning}.**")
    return "  \n".join(lines)


def _versions(results: Json) -> str:
    found: dict[str, str] = {}
    for scene in results.get("scenes", {}).values():
        for key, entry in scene["contenders"].items():
            engine = next(c.engine for c in CONTENDERS if c.key == key)
            found[engine] = entry["runs"][0]["version"]
    return ", ".join(f"{engine} {version}" for engine, version in sorted(found.items()))


def _scene_lines(scene: Json) -> str:
    facts, plan = scene["reference"], scene["plan"]
    return (
        f"Medians of {plan['runs']} run(s) of about {plan['seconds']:g} s, in turn; "
        "± is half the spread.  \n"
        f"Reference: raykiln with {facts['spp'][0]:,} and Mitsuba with {facts['spp'][1]:,} samples "
        f"a pixel, ratio of means {facts['mean_ratio']:.4f}, {facts['blocks_off']} of "
        f"{facts['blocks']} blocks apart, relMSE of the reference itself "
        f"{facts['rel_mse_of_itself']:.1e}."
    )


def _scene(name: str, scene: Json) -> Table:
    table = Table(
        "Renderer", "spp", "Msamples/s", "relMSE", "relMSE x spp", "1/(relMSE x s)", "MiB", "mean"
    )
    for contender in CONTENDERS:
        entry = scene["contenders"].get(contender.key)
        if entry is None:
            continue
        runs, agrees = entry["runs"], entry["agreement"]
        mean = f"{agrees['mean_ratio']:.4f}"
        if not agrees["mean_agrees"]:
            mean += " differs"
        elif agrees["blocks_off"]:
            mean += f" ({agrees['blocks_off']} blocks off)"
        table.add(
            contender.title,
            f"{median(runs, 'spp'):.0f}",
            _with_spread(runs, "samples_per_s", 1e6),
            f"{median(runs, 'rel_mse'):.2e}",
            f"{median(runs, 'error_per_sample'):.3g}",
            _with_spread(runs, "efficiency"),
            f"{median(runs, 'peak_bytes') / MIB:.0f}",
            mean,
        )
    given = GIVEN_PBRT[name]
    quality = f"{given['error_per_sample']:.3g}" if "error_per_sample" in given else ""
    rate = f"{given['samples_per_s'] / 1e6:.2f}"
    table.add("pbrt-v4 (given figure, not run)", "", rate, "", quality, "", "", "")
    return table


def _with_spread(runs: list[Json], key: str, unit: float = 1.0) -> str:
    return f"{median(runs, key) / unit:.3g} ± {100 * spread(runs, key):.0f} %"


def _best_peer(scene: Json, key: str) -> tuple[str, float]:
    peers = [c for c in CONTENDERS if not c.ours and c.key in scene["contenders"]]
    best = max(peers, key=lambda c: median(scene["contenders"][c.key]["runs"], key))
    return best.title, median(scene["contenders"][best.key]["runs"], key)


def ratios(scene: Json) -> Json | None:
    """Ours over Mitsuba llvm in throughput, and over the best peer in efficiency."""
    entries = scene["contenders"]
    if not {OURS, OURS_DEFAULT, "mitsuba"} <= entries.keys():
        return None
    title, best = _best_peer(scene, "efficiency")
    rate, rival = (median(entries[k]["runs"], "samples_per_s") for k in (OURS, "mitsuba"))
    return {
        "throughput": rate / rival,
        "efficiency": median(entries[OURS_DEFAULT]["runs"], "efficiency") / best,
        "best": title,
    }


def _goals(results: Json) -> Table:
    table = Table("Scene", "throughput / Mitsuba llvm", "efficiency / best peer", "best peer", "")
    for name, scene in results["scenes"].items():
        found = ratios(scene)
        if found is None:
            continue
        lost = [
            what
            for what, value in (
                ("throughput", found["throughput"]),
                ("efficiency", found["efficiency"]),
            )
            if value < 1
        ]
        verdict = f"we lose in {' and '.join(lost)}" if lost else "ahead"
        table.add(
            SHORT_TITLES[name],
            f"{found['throughput']:.2f}",
            f"{found['efficiency']:.2f}",
            found["best"],
            verdict,
        )
    return table


def _geometric_mean(results: Json) -> str:
    found = [r for r in map(ratios, results["scenes"].values()) if r is not None]
    if not found:
        return "(a ratio needs raykiln, its defaults and Mitsuba llvm)"
    means = {
        key: math.exp(statistics.mean(math.log(r[key]) for r in found))
        for key in ("throughput", "efficiency")
    }
    return (
        f"Geometric means: throughput {means['throughput']:.2f}, "
        f"efficiency {means['efficiency']:.2f}."
    )


def _whole(results: Json) -> str:
    table = Table(
        "Renderer", *(f"{SHORT_TITLES[n]}, s" for n in results["whole"]), "peak MiB of each"
    )
    for contender in CONTENDERS:
        found = [scene.get(contender.key) for scene in results["whole"].values()]
        if not all(found):
            continue
        peaks = " / ".join(f"{median(runs, 'peak_bytes') / MIB:.0f}" for runs in found if runs)
        table.add(
            contender.title, *(f"{median(runs, 'wall_s'):.2f}" for runs in found if runs), peaks
        )
    text = str(table)
    if "cold" in results:
        cold = results["cold"]["wall_s"]
        text += f"\n\nMitsuba llvm with an empty cache of kernels, Cornell box: {cold:.2f} s."
    return text


def _loading(results: Json) -> str:
    table = Table("Renderer", "read and build, s", "of which imports, s", "import before, s")
    for contender in CONTENDERS:
        runs = results["loading"].get(contender.key)
        if runs:
            imports = statistics.median(results["import_s"][contender.engine])
            late = f"{median(runs, 'read_imports_s'):.2f}" if "read_imports_s" in runs[0] else ""
            table.add(contender.title, f"{median(runs, 'read_s'):.2f}", late, f"{imports:.3f}")
    return str(table)


def _replay(results: Json) -> Table:
    table = Table(
        "Scene", "ours, Mrays/s", "Embree, single rays", "Embree, best packets", "ours / best"
    )
    for name, found in results["replay"].items():
        ours, ceiling = found["render_rays_per_s"], found["ceiling_rays_per_s"]
        table.add(
            SHORT_TITLES[name],
            f"{ours / 1e6:.1f}",
            f"{found['single_rays_per_s'] / 1e6:.1f}",
            f"{ceiling / 1e6:.1f}",
            f"{100 * ours / ceiling:.0f} %",
        )
    return table


def write_page(results: Json, page: Path, images: Path) -> None:
    """Replace the results in the page, with the plots that there are."""
    before, rest = page.read_text().split(BEGIN)
    after = rest.split(END)[1]
    plots = "\n\n".join(
        f"![{image.stem.replace('_', ' ')}]({image.relative_to(page.parent)})"
        for image in (images / "samples_per_s.svg", images / "efficiency.svg")
        if image.is_file()
    )
    page.write_text(f"{before}{BEGIN}\n\n{plots}\n\n{as_text(results)}\n{END}{after}")
