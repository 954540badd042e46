"""What goes over the wire: requests as they must be, replies as they are."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator
from raykiln.settings import RenderSettings

from raykiln_service.jobs import Job, JobState
from raykiln_service.schemas_frames import FrameChoice, FramesView
from raykiln_service.schemas_webhooks import WebhookChoice

_NO_CONTROLS = r"^[^\x00-\x1f\x7f]*$"
LabelText = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=_NO_CONTROLS)]
LabelValue = Annotated[str, StringConstraints(max_length=200, pattern=_NO_CONTROLS)]
OutputKind = Literal["exr", "png", "contact_sheet", "webp", "mp4"]


class SceneChoice(BaseModel):
    """Which scene to render: exactly one of `asset`, `name` and `inline`."""

    model_config = ConfigDict(extra="forbid")

    asset: Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")] | None = None
    """Id of an uploaded file or zip bundle."""
    entry: Annotated[str, Field(min_length=1, max_length=1024)] | None = None
    """The scene file within a bundle; the file's name for other assets."""
    name: Annotated[str, Field(min_length=1, max_length=256)] | None = None
    """A bundled scene, see `GET /v1/scenes`."""
    inline: dict[str, Any] | None = None
    """A scene in the native JSON format."""

    @model_validator(mode="after")
    def _one_choice(self) -> SceneChoice:
        if sum(choice is not None for choice in (self.asset, self.name, self.inline)) != 1:
            raise ValueError("a scene takes exactly one of 'asset', 'name' and 'inline'")
        if self.entry is not None and self.asset is None:
            raise ValueError("'entry' goes with 'asset' only")
        return self


class JobRequest(BaseModel):
    """A job to render."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "scene": {"name": "cornell_box"},
                    "settings": {"width": 256, "height": 256, "spp": 64},
                    "labels": {"shot": "010"},
                },
                {
                    "scene": {"name": "cornell_box"},
                    "frames": {"turntable": {"count": 36}},
                    "outputs": ["exr", "png", "contact_sheet"],
                },
            ]
        },
    )

    scene: SceneChoice
    settings: RenderSettings = Field(default_factory=RenderSettings)
    frames: FrameChoice | None = None
    """Many pictures of the scene; null = one."""
    outputs: Annotated[list[OutputKind], Field(min_length=1, max_length=8)] | None = None
    """The EXR is always kept; `png` adds a picture of it.  `contact_sheet`, `webp` and `mp4` are
    made of all frames.  null = EXR and PNG, with the contact sheet of frames."""
    priority: Annotated[int, Field(ge=-1000, le=1000)] = 0
    """Higher goes first; waiting makes up for it."""
    memory_bytes: Annotated[int, Field(ge=1 << 26)] | None = None
    """Memory that it may take; null or more than the service allows = what that allows."""
    timeout_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Longest time that it may spend on a slot, all attempts together; then it fails, and keeps
    the image so far."""
    cache: bool = True
    """Whether the result of an identical job may be the answer; false = render in any case."""
    labels: Annotated[dict[LabelText, LabelValue], Field(max_length=32)] = Field(
        default_factory=dict
    )
    """Names and values to find the job by."""
    webhook: WebhookChoice | None = None
    """Who is to hear how it ends; see `GET /v1/jobs/{id}/deliveries`."""


class AssetView(BaseModel):
    """A stored upload."""

    id: str
    size_bytes: int
    filename: str | None
    created_at: datetime


class MissingRequest(BaseModel):
    """Which of these have to be uploaded?"""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"ids": ["sha256:" + "0" * 64]}]}
    )

    ids: Annotated[
        list[Annotated[str, Field(pattern=r"^(sha256:)?[0-9a-f]{64}$")]], Field(max_length=10_000)
    ]
    """SHA-256 of files, in hex, with or without `sha256:` before it."""


class MissingView(BaseModel):
    """Those that are not there, in the order asked."""

    missing: list[str]


class UploadView(BaseModel):
    """A resumable upload."""

    id: str
    href: str
    length: int
    offset: int
    """Bytes that have arrived."""
    filename: str | None
    sha256: str | None
    asset: str | None
    """Id of the asset, once all has arrived."""
    created_at: datetime
    expires_at: datetime


class UploadListView(BaseModel):
    """Unfinished uploads."""

    items: list[UploadView]


class ProgressView(BaseModel):
    """How far a job has come."""

    phase: str
    """waiting, load, render, denoise, encode, gather or done."""
    fraction: float
    spp_done: int | None = None
    spp: int | None = None
    elapsed_s: float | None = None
    eta_s: float | None = None
    samples: int | None = None
    frame: int | None = None
    """Number of the frame that `spp_done` and `samples` are of."""
    frames: int | None = None
    frames_done: int | None = None


class TimingsView(BaseModel):
    """Where the time went, in seconds."""

    queue_s: float | None
    run_s: float | None
    total_s: float | None


class EtaView(BaseModel):
    """When a job is likely to begin and to end; null = unknown, which it is told to be."""

    start_s: float | None
    """Seconds until it begins; 0 if it runs."""
    end_s: float | None
    """Seconds until it ends."""
    basis: Literal["scene", "recent"] | None
    """Speed of earlier jobs of the same scene, or of recent jobs of any."""


class OutputView(BaseModel):
    """A file of the result."""

    name: str
    media_type: str
    size_bytes: int
    sha256: str
    href: str


class ErrorView(BaseModel):
    """Why a job failed."""

    model_config = ConfigDict(extra="allow")

    reason: str
    detail: str


class JobView(BaseModel):
    """A job."""

    id: str
    state: JobState
    progress: ProgressView
    queue_position: int | None
    """Jobs that go before it, if it is queued."""
    eta: EtaView | None
    """None once it has ended."""
    cached: bool
    """Whether an earlier job's result is the answer: nothing was rendered."""
    scene: dict[str, Any]
    settings: dict[str, Any]
    """As given; the result tells what they became."""
    outputs_wanted: list[str]
    frames: FramesView | None
    """Null for a job of one image."""
    priority: int
    labels: dict[str, str]
    attempts: int
    max_attempts: int
    interruptions: int
    memory_bytes: int | None
    timeout_s: float | None
    """As asked for; the service may allow less."""
    used_s: float
    """Time on a slot, all attempts together, as of the last heartbeat."""
    cancel_requested: bool
    created_at: datetime
    updated_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    timings: TimingsView
    error: ErrorView | None
    warnings: list[str]
    complete: bool | None
    """False for the partial image of a cancelled job; None without an image."""
    outputs: list[OutputView]
    stats: dict[str, Any] | None
    links: dict[str, str]


class JobPageView(BaseModel):
    """Jobs, newest first."""

    items: list[JobView]
    next_cursor: str | None


class QueueStateView(BaseModel):
    """The queue as a whole."""

    paused: bool
    paused_at: datetime | None
    pause_reason: str | None
    queued: int
    running: int
    slots: int
    """Jobs that this service renders at the same time."""
    oldest_queued_at: datetime | None
    drained_in_s: float | None
    """Until all of it is done; null = unknown, or paused."""
    samples_per_s: float | None
    """Of the median recent job; null = too few are known."""


class PauseRequest(BaseModel):
    """Why the queue is paused."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, StringConstraints(max_length=500)] | None = None


class SceneView(BaseModel):
    """A bundled scene."""

    name: str
    title: str | None
    description: str | None
    settings: dict[str, Any]
    """The scene's own; they apply where a job gives none."""
    cameras: list[str]
    thumbnail: str | None
    """A small picture of it."""


class VersionView(BaseModel):
    """What runs here."""

    version: str
    api: str
    executor: str
    slots: int
    sandbox: dict[str, str]
    """What confines the processes that read scenes, by layer; `off:` and why, where one is
    missing; empty = not confined."""


class Problem(BaseModel):
    """An error (RFC 9457), as `application/problem+json`."""

    type: str
    title: str
    status: int
    detail: str
    limit: str | None = None
    file: str | None = None
    pointer: str | None = None
    found: str | None = None
    accepted: str | None = None


def timestamp(unix_ms: int) -> datetime:
    """A moment as a date and time in UTC."""
    return datetime.fromtimestamp(unix_ms / 1000, UTC)


def job_view(
    job: Job,
    queue_position: int | None,
    eta: EtaView | None,
    live_progress: Mapping[str, Any] | None,
    now_ms: int,
    frames: FramesView | None = None,
) -> JobView:
    """A job as clients see it."""
    result = job.result or {}
    base = f"/v1/jobs/{job.id}"
    return JobView(
        id=job.id,
        state=job.state,
        progress=_progress(job, live_progress),
        queue_position=queue_position,
        eta=None if job.state.is_final else eta,
        cached=result.get("cached_from") is not None,
        scene=dict(job.spec.scene),
        settings=dict(job.spec.settings),
        outputs_wanted=list(job.spec.outputs),
        frames=frames,
        priority=job.spec.priority,
        labels=dict(job.spec.labels),
        attempts=job.attempts,
        max_attempts=job.max_attempts,
        interruptions=job.interruptions,
        memory_bytes=job.spec.memory_bytes,
        timeout_s=job.spec.timeout_s,
        used_s=job.used_ms / 1000,
        cancel_requested=job.cancel_requested,
        created_at=timestamp(job.created_ms),
        updated_at=timestamp(job.updated_ms),
        started_at=None if job.started_ms is None else timestamp(job.started_ms),
        finished_at=None if job.finished_ms is None else timestamp(job.finished_ms),
        timings=_timings(job, now_ms),
        error=None if job.error is None else ErrorView(**job.error),
        warnings=list(dict.fromkeys([*job.spec.warnings, *result.get("warnings", ())])),
        complete=result.get("complete"),
        outputs=[
            OutputView(href=f"{base}/outputs/{file['name']}", **file)
            for file in result.get("files", ())
        ],
        stats=result.get("stats"),
        links=_links(job, base),
    )


def _progress(job: Job, live: Mapping[str, Any] | None) -> ProgressView:
    if job.state is JobState.SUCCEEDED:
        stats = (job.result or {}).get("stats", {})
        return ProgressView(phase="done", fraction=1.0, spp_done=stats.get("spp"))
    known = live or job.progress
    if job.state is JobState.QUEUED or known is None:
        return ProgressView(phase="waiting", fraction=float((known or {}).get("fraction", 0.0)))
    return ProgressView(**known)


def _timings(job: Job, now_ms: int) -> TimingsView:
    end = job.finished_ms or now_ms
    started = job.started_ms
    return TimingsView(
        queue_s=_span_s(job.created_ms, started or end),
        run_s=None if started is None else _span_s(started, end),
        total_s=_span_s(job.created_ms, end),
    )


def _span_s(start_ms: int, end_ms: int) -> float:
    # A clock that was set back must not make a time negative.
    return max(0, end_ms - start_ms) / 1000


def _links(job: Job, base: str) -> dict[str, str]:
    links = {"self": base, "events": f"{base}/events", "log": f"{base}/outputs/log.txt"}
    links["deliveries"] = f"{base}/deliveries"
    if job.spec.frames is not None:
        links["frames"] = f"{base}/frames"
    if job.started_ms is not None:
        links["preview"] = f"{base}/preview.png"
        links["archive"] = f"{base}/outputs.zip"
    if not job.state.is_final:
        links["cancel"] = f"{base}/cancel"
    if job.state in (JobState.FAILED, JobState.CANCELLED):
        links["retry"] = f"{base}/retry"
    return links
