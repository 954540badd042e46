"""The frames of a job over the wire: what may be asked for, and how each one stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from raykiln_service.jobs import FrameState, Job, JobState
from raykiln_service.planner import frame_name, playback_fps
from raykiln_service.units import FrameRecord

Degrees = Annotated[float, Field(ge=-36000, le=36000)]
Coordinate = Annotated[float, Field(allow_inf_nan=False)]
CameraName = Annotated[str, StringConstraints(min_length=1, max_length=256)]


class Turntable(BaseModel):
    """The scene's camera goes round; the scene and its lights stay."""

    model_config = ConfigDict(extra="forbid")

    count: Annotated[int, Field(ge=1, le=100_000)]
    """Number of frames."""
    axis: Literal["x", "y", "z"] = "y"
    """World axis to turn about, counter-clockwise as seen from its tip."""
    degrees: Degrees = 360.0
    """The whole turn; its end is left out, so that a full turn loops."""
    start_degrees: Degrees = 0.0
    """Where it begins; 0 = the scene's camera."""
    elevation_degrees: Annotated[float, Field(gt=-90, lt=90)] | None = None
    """Height of the camera as an angle above the target; null = as the scene's camera stands."""
    target: tuple[Coordinate, Coordinate, Coordinate] | None = None
    """What to turn about; null = what the camera looks at."""


class TimeRange(BaseModel):
    """Moments of the scene's animation."""

    model_config = ConfigDict(extra="forbid")

    start: Annotated[float, Field(allow_inf_nan=False)] | None = None
    """In seconds; null = where the animation begins."""
    end: Annotated[float, Field(allow_inf_nan=False)] | None = None
    """In seconds, included; null = where the animation ends."""
    fps: Annotated[float, Field(gt=0, le=1000)] = 24.0
    """Frames a second."""


class FrameChoice(BaseModel):
    """Which pictures of the scene: exactly one of `cameras`, `turntable` and `time`."""

    model_config = ConfigDict(extra="forbid")

    cameras: Annotated[list[CameraName], Field(min_length=1)] | Literal["all"] | None = None
    """Names of the scene's cameras, one frame each; "all" = all of them."""
    turntable: Turntable | None = None
    time: TimeRange | None = None
    vary_seed: bool = False
    """Give frame i the seed of the settings + i - 1, so that noise does not stand still."""
    fps: Annotated[float, Field(gt=0, le=120)] | None = None
    """Pictures a second of `webp` and `mp4`; null = 12, or those of `time`."""

    @model_validator(mode="after")
    def _one_choice(self) -> FrameChoice:
        if sum(choice is not None for choice in (self.cameras, self.turntable, self.time)) != 1:
            raise ValueError("frames take exactly one of 'cameras', 'turntable' and 'time'")
        return self


class FramesView(BaseModel):
    """The frames of a job in numbers."""

    count: int
    queued: int
    """Of which one is being rendered, if the job is running."""
    succeeded: int
    failed: int
    cancelled: int
    fps: float
    """Pictures a second of the animations."""
    wanted: dict[str, Any]
    """As given."""


class FrameOutputView(BaseModel):
    """A file of a frame."""

    name: str
    media_type: str
    size_bytes: int
    sha256: str
    href: str


class FrameErrorView(BaseModel):
    """Why a frame failed, or why its last try broke."""

    model_config = ConfigDict(extra="allow")

    reason: str
    detail: str


class FrameView(BaseModel):
    """One frame of a job."""

    number: int
    """From 1."""
    name: str
    """As in file names: 0001."""
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    camera: dict[str, Any] | None
    """The camera in the native format, if it is not one of the scene's."""
    settings: dict[str, Any]
    """What differs from the job's settings."""
    time_s: float | None
    failures: int
    """Tries that broke."""
    error: FrameErrorView | None
    complete: bool | None
    """False for a partial image; null without an image."""
    outputs: list[FrameOutputView]
    stats: dict[str, Any] | None
    links: dict[str, str]


class FramePageView(BaseModel):
    """Frames of a job, by number."""

    items: list[FrameView]
    next_cursor: str | None


def frames_view(job: Job, counts: Mapping[FrameState, int]) -> FramesView | None:
    """The frames of a job in numbers; None for a job of one image."""
    if job.spec.frames is None:
        return None
    return FramesView(
        count=sum(counts.values()),
        fps=playback_fps(job.spec.frames),
        wanted=dict(job.spec.frames),
        **{str(state): counts[state] for state in FrameState},
    )


def frame_view(job: Job, record: FrameRecord, rendering: int | None) -> FrameView:
    """A frame as clients see it; `rendering` is the number of the one at work."""
    frame, result = record.frame, record.result or {}
    base = f"/v1/jobs/{job.id}"
    place = f"{base}/frames/{frame.name}"
    running = job.state is JobState.RUNNING and frame.number == rendering
    is_at_work = running and record.state is FrameState.QUEUED
    return FrameView(
        number=frame.number,
        name=frame.name,
        state="running" if is_at_work else str(record.state),
        camera=None if frame.camera is None else dict(frame.camera),
        settings=dict(frame.settings),
        time_s=frame.time_s,
        failures=record.failures,
        error=None if record.error is None else FrameErrorView(**record.error),
        complete=result.get("complete"),
        outputs=[
            FrameOutputView(href=f"{place}/{file['name']}", **file)
            for file in result.get("files", ())
        ],
        stats=result.get("stats"),
        links={"self": place, "job": base, "frames": f"{base}/frames"},
    )


def file_name_of(number: int, name: str) -> str:
    """The name of a frame's file in a sequence: image.0001.exr."""
    stem, _, suffix = name.rpartition(".")
    return f"{stem}.{frame_name(number)}.{suffix}"
