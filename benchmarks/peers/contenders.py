"""Who takes part, with which settings, and how many samples a run of a given length has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Contender:
    """A renderer with its settings. `rr` None: its own Russian roulette; -1: none."""

    key: str
    title: str
    engine: str
    rr: int | None = -1
    sampler: str | None = None
    variant: str | None = None
    watertight: bool = False
    """Told to let no ray through the edges of a mesh, where that is not so anyway."""
    equal: bool = False
    """Runs with the settings that all have in common: throughput is compared there."""

    @property
    def ours(self) -> bool:
        """Whether this is raykiln."""
        return self.engine == "raykiln"

    def job(self) -> dict[str, Any]:
        """What its program is told."""
        return {
            "rr": self.rr,
            "sampler": self.sampler,
            "variant": self.variant,
            "watertight": self.watertight,
        }

    def nearest_spp(self, wanted: float) -> int:
        """A number of samples near `wanted` that suits the sampler."""
        if self.sampler == "multijitter":
            return max(2, round(math.sqrt(wanted))) ** 2
        if self.sampler == "independent":
            return max(4, round(wanted))
        # Sobol' sequences are whole at powers of two.
        return int(2 ** max(2, round(math.log2(max(wanted, 1.0)))))


LLVM, SCALAR = "llvm_ad_rgb", "scalar_rgb"

CONTENDERS = [
    Contender("raykiln", "raykiln, no roulette", "raykiln", equal=True),
    Contender("raykiln-default", "raykiln, its defaults", "raykiln", rr=None),
    Contender("mitsuba", "Mitsuba llvm", "mitsuba", -1, "independent", LLVM, equal=True),
    Contender(
        "mitsuba-watertight",
        "Mitsuba llvm, watertight",
        "mitsuba",
        -1,
        "independent",
        LLVM,
        watertight=True,
    ),
    Contender("mitsuba-rr", "Mitsuba llvm, roulette", "mitsuba", None, "independent", LLVM),
    Contender("mitsuba-mj", "Mitsuba llvm, multijitter", "mitsuba", -1, "multijitter", LLVM),
    Contender(
        "mitsuba-mj-rr", "Mitsuba llvm, multijitter, roulette", "mitsuba", None, "multijitter", LLVM
    ),
    Contender("mitsuba-scalar", "Mitsuba scalar", "mitsuba", -1, "independent", SCALAR, equal=True),
    Contender("cycles", "Cycles", "cycles", equal=True),
    Contender("cycles-rr", "Cycles, roulette", "cycles", rr=None),
    Contender("luxcore", "LuxCore", "luxcore", equal=True),
    Contender("luxcore-rr", "LuxCore, roulette", "luxcore", rr=None),
]
EQUAL = [c for c in CONTENDERS if c.equal]

# The issue that asked for this benchmark gave these for pbrt-v4, which no package registry
# carries: given, not measured here. Throughput in samples per second, relMSE x spp.
GIVEN_PBRT = {
    "cornell": {"samples_per_s": 0.45e6},
    "displaced_sphere": {"samples_per_s": 0.41e6},
    "glass_and_metal": {"samples_per_s": 0.54e6},
    "many_lights": {"samples_per_s": 0.45e6, "error_per_sample": 0.36},
}
