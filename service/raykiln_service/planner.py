"""From a job to its work units: parts of the image times ranges of samples, in merge order.

A job is one unit for now.  Everything downstream takes an ordered list, so that splitting a job
over slots or machines changes this file and the merge only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Unit:
    """A region and a range of samples.  None means all of them."""

    ordinal: int
    region: tuple[int, int, int, int] | None = None
    """(x0, y0, x1, y1) in pixels, x1 and y1 excluded."""
    samples: tuple[int, int] | None = None
    """First sample, and one past the last."""


def plan(settings: Mapping[str, Any]) -> list[Unit]:
    """The units of a job with these settings, in the order in which their sums are merged."""
    crop = settings.get("crop")
    return [Unit(0, region=None if crop is None else tuple(crop))]
