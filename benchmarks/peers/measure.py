"""The measurements: references, calibrated runs in turn, whole processes, loading, importing."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from contenders import CONTENDERS, EQUAL, Contender
from environment import say
from four_scenes import BenchScene
from process import ChildFailedError, Children, image_of
from quality import Reference, agreement

Json = dict[str, Any]

WHOLE_SPP = 64
CALIBRATION_SPP = 4
REFERENCE_CHUNK_S = 15.0
REFERENCE_SEED = 1_000_000


@dataclass(frozen=True)
class Plan:
    """How long and how often."""

    runs: int
    seconds: float
    reference_s: float
    contenders: tuple[str, ...] = ()
    whole_scenes: tuple[str, ...] = ("cornell",)
    """Where whole processes are measured, at many samples even for the slowest."""

    def takes(self, contender: Contender) -> bool:
        """Whether a contender takes part."""
        return not self.contenders or contender.key in self.contenders


@dataclass
class Bench:
    """One scene, ready to be rendered by all."""

    scene: BenchScene
    folder: Path
    children: Children
    plan: Plan

    @property
    def pixels(self) -> int:
        """Of the image."""
        return self.scene.size**2

    def run(self, contender: Contender, **job: Any) -> Json:
        """One process of one contender."""
        common = {"scene": str(self.folder), "size": self.scene.size, "depth": self.scene.depth}
        return self.children.run(contender.engine, {**common, **contender.job(), **job})

    def render(self, contender: Contender, spp: int, seed: int) -> tuple[Json, Any]:
        """A run and its image."""
        path = self.children.work / "image.npy"
        return self.run(contender, spp=spp, seed=seed, image=str(path)), image_of(path)

    def prepare(self) -> None:
        """Make what only a renderer itself can make: Blender's file."""
        if not (self.folder / "cycles.blend").is_file():
            self.children.run("cycles", {"task": "prepare", "scene": str(self.folder)})

    def calibrated_spp(self, contender: Contender, seconds: float) -> int:
        """Samples per pixel for a run of about `seconds`."""
        say(f"{self.scene.name}: {contender.title}, how quick it is")
        spp = CALIBRATION_SPP
        result = self.run(contender, spp=spp)
        rate = result["spp"] / max(result["render_s"], 1e-3)
        if result["render_s"] < 0.2 * seconds:
            # Too short to tell, above all for what compiles or warms up first.
            spp = contender.nearest_spp(0.3 * rate * seconds)
            result = self.run(contender, spp=spp)
            rate = result["spp"] / max(result["render_s"], 1e-3)
        return contender.nearest_spp(rate * seconds)

    def reference(self) -> tuple[Reference, Json]:
        """The scene's converged images; kept in the work folder."""
        cache = self.folder / "reference.npz"
        if cache.is_file():
            kept = np.load(cache)
            if float(kept["seconds"]) >= self.plan.reference_s:
                return self._checked(Reference(kept["first"], kept["second"]), kept)
        first, spp_first = self._converged("raykiln-default")
        second, spp_second = self._converged("mitsuba-mj")
        kept = {
            "first": first,
            "second": second,
            "seconds": self.plan.reference_s,
            "spp_first": spp_first,
            "spp_second": spp_second,
        }
        np.savez(cache, **kept)
        return self._checked(Reference(first, second), kept)

    def _converged(self, key: str) -> tuple[Any, int]:
        contender = next(c for c in CONTENDERS if c.key == key)
        say(f"{self.scene.name}: reference by {contender.title}")
        chunk_s = min(REFERENCE_CHUNK_S, self.plan.reference_s)
        spp = self.calibrated_spp(contender, chunk_s)
        total, done, spent = np.zeros((self.scene.size, self.scene.size, 3)), 0, 0.0
        while spent < self.plan.reference_s:
            result, image = self.render(contender, spp, REFERENCE_SEED + done)
            total += image.astype(np.float64) * result["spp"]
            done += result["spp"]
            spent += result["render_s"]
        return (total / done).astype(np.float32), done

    def _checked(self, reference: Reference, kept: Any) -> tuple[Reference, Json]:
        facts = {
            "by": ["raykiln-default", "mitsuba-mj"],
            "spp": [int(kept["spp_first"]), int(kept["spp_second"])],
            "rel_mse_of_itself": reference.noise(),
            **agreement(reference.first, reference.second),
        }
        if not facts["mean_agrees"]:
            raise ChildFailedError(f"{self.scene.name}: the two references disagree: {facts}")
        return reference, facts

    def in_turn(self, reference: Reference) -> Json:
        """All contenders, one after the other, again and again."""
        taking_part = [c for c in CONTENDERS if self.plan.takes(c)]
        spp = {c.key: self.calibrated_spp(c, self.plan.seconds) for c in taking_part}
        runs: Json = {c.key: [] for c in taking_part}
        sums: Json = {}
        for number in range(self.plan.runs):
            for contender in taking_part:
                say(f"{self.scene.name}: {contender.title}, {spp[contender.key]} spp, {number + 1}")
                result, image = self.render(contender, spp[contender.key], 1 + number)
                runs[contender.key].append(self._measured(result, reference, image))
                sums[contender.key] = sums.get(contender.key, 0) + image.astype(np.float64)
        return {
            c.key: {
                "runs": runs[c.key],
                "agreement": agreement(
                    (sums[c.key] / self.plan.runs).astype(np.float32), reference.mean
                ),
            }
            for c in taking_part
        }

    def _measured(self, result: Json, reference: Reference, image: Any) -> Json:
        rel_mse = max(reference.rel_mse(image), 1e-12)
        return {
            **result,
            "samples_per_s": self.pixels * result["spp"] / result["render_s"],
            "rel_mse": rel_mse,
            "plain_rel_mse": reference.plain_rel_mse(image),
            "error_per_sample": rel_mse * result["spp"],
            "efficiency": 1.0 / (rel_mse * result["render_s"]),
        }

    def whole(self, runs: int) -> Json:
        """From the start of the process to an EXR on disk, at 64 samples a pixel."""
        exr = str(self.children.work / "whole.exr")
        taking_part = [c for c in EQUAL if self.plan.takes(c)]
        done: Json = {c.key: [] for c in taking_part}
        for _ in range(runs):
            for contender in taking_part:
                done[contender.key].append(
                    self.run(contender, task="whole", spp=WHOLE_SPP, exr=exr)
                )
        return done

    def cold(self) -> Json:
        """The first process ever: Mitsuba's kernels are not in its cache yet."""
        shutil.rmtree(self.children.work / "home" / ".drjit", ignore_errors=True)
        mitsuba = next(c for c in EQUAL if c.key == "mitsuba")
        exr = str(self.children.work / "whole.exr")
        return self.run(mitsuba, task="whole", spp=WHOLE_SPP, exr=exr)

    def loading(self, runs: int) -> Json:
        """Reading the meshes and building what rays are traced with: short, so three times each."""
        taking_part = [c for c in EQUAL if self.plan.takes(c)]
        done: Json = {c.key: [] for c in taking_part}
        for _ in range(3 * runs):
            for contender in taking_part:
                # LuxCore loads only to render: of 16 x 16 pixels that is nothing.
                done[contender.key].append(self.run(contender, task="load", size=16, spp=1))
        return done
