"""From a job to its work units: the frames of a job, or its one image.

Everything downstream takes an ordered list of units.  A unit is rendered by one task, has its
own outputs, and is tried again alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Frame:
    """How one frame of a job differs from the job's scene and settings."""

    number: int
    """From 1."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """`RenderSettings` fields in place of the job's."""
    camera: Mapping[str, Any] | None = None
    """A camera of the native format to see the scene by (`settings` names it); None = its own."""
    time_s: float | None = None
    """The moment of the scene's animation; None = at rest."""

    @property
    def name(self) -> str:
        """As it appears in file names and addresses."""
        return frame_name(self.number)


def frame_name(number: int) -> str:
    """The name of a frame: its number with at least four digits."""
    return f"{number:04d}"


@dataclass(frozen=True, slots=True)
class Unit:
    """What one task renders."""

    ordinal: int
    region: tuple[int, int, int, int] | None = None
    """(x0, y0, x1, y1) in pixels, x1 and y1 excluded; None = all."""
    frame: Frame | None = None
    """None = the job's one image."""


def plan(settings: Mapping[str, Any]) -> list[Unit]:
    """The units of a job of one image with these settings."""
    crop = settings.get("crop")
    return [Unit(0, region=None if crop is None else tuple(crop))]


GATHERED = ("contact_sheet", "webp", "mp4")
"""Outputs that are made of all frames together."""
_FPS, _TIME_FPS = 12.0, 24.0


def playback_fps(frames: Mapping[str, Any]) -> float:
    """The pictures a second at which the frames of a request are shown."""
    if frames.get("fps") is not None:
        return float(frames["fps"])
    if frames.get("time") is not None:
        return float(frames["time"].get("fps", _TIME_FPS))
    return _FPS
