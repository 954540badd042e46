"""Jobs as values, their states, and the one table of transitions between them.

Nothing else in the service decides whether a state may change; the store asks `next_state` and
the database refuses what contradicts it.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from raykiln_service.planner import Frame


class JobState(StrEnum):
    """Where a job stands."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_final(self) -> bool:
        """Whether the job has ended (it may still be retried)."""
        return self in FINAL_STATES


FINAL_STATES = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED})


class FrameState(StrEnum):
    """Where a frame of a job stands (a queued one may be the one that is being rendered)."""

    QUEUED = "queued"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


class JobEvent(StrEnum):
    """What may happen to a job."""

    CLAIM = "claim"
    """A dispatcher takes it."""
    ANSWER = "answer"
    """Its result was there already."""
    SUCCEED = "succeed"
    """Its attempt delivered the whole image."""
    FAIL = "fail"
    """It cannot be rendered, or its attempts are used up."""
    LOSE = "lose"
    """Its attempt was lost; it is to be tried again."""
    CANCEL = "cancel"
    """Someone asked for its end."""
    RETRY = "retry"
    """Someone asked for another go."""


_S, _E = JobState, JobEvent

TRANSITIONS: Mapping[tuple[JobState, JobEvent], JobState] = MappingProxyType(
    {
        (_S.QUEUED, _E.CLAIM): _S.RUNNING,
        (_S.QUEUED, _E.ANSWER): _S.SUCCEEDED,
        (_S.QUEUED, _E.CANCEL): _S.CANCELLED,
        (_S.RUNNING, _E.SUCCEED): _S.SUCCEEDED,
        (_S.RUNNING, _E.FAIL): _S.FAILED,
        (_S.RUNNING, _E.CANCEL): _S.CANCELLED,
        (_S.RUNNING, _E.LOSE): _S.QUEUED,
        (_S.FAILED, _E.RETRY): _S.QUEUED,
        (_S.CANCELLED, _E.RETRY): _S.QUEUED,
    }
)


class IllegalTransitionError(Exception):
    """An event that the job's state does not allow."""

    def __init__(self, state: JobState, event: JobEvent) -> None:
        self.state = state
        self.event = event
        super().__init__(f"a job that is {state} cannot {event}")


def next_state(state: JobState, event: JobEvent) -> JobState:
    """The state after `event`; `IllegalTransitionError` if it cannot happen in `state`."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise IllegalTransitionError(state, event) from None


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to work on a job; commits carry its token, so a lost attempt changes nothing."""

    job_id: str
    token: str
    attempt: int


@dataclass(frozen=True, slots=True)
class Webhook:
    """Who is to hear how a job ends."""

    url: str
    host: str
    """Host and port in the URL: messages to the same one wait for each other."""
    events: tuple[str, ...] = ("succeeded", "failed", "cancelled")
    secret: str | None = field(default=None, repr=False)
    """Key of the signatures; None = the service's own."""


@dataclass(frozen=True, slots=True)
class JobSpec:
    """What was asked for; never changes."""

    scene: Mapping[str, Any]
    """{"name"}, {"asset", "entry"} or {"inline": True}."""
    settings: Mapping[str, Any]
    """The `RenderSettings` fields that were given."""
    outputs: tuple[str, ...] = ("exr", "png")
    priority: int = 0
    labels: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    """What the scene check had to say."""
    frames: Mapping[str, Any] | None = None
    """Which pictures are asked for, as given; None = one image."""
    planned: tuple[Frame, ...] = ()
    """These pictures one by one; given at submission, kept by the store on their own."""
    memory_bytes: int | None = None
    """Most memory that it may take, if less than the service allows."""
    timeout_s: float | None = None
    """Longest time on a slot, all attempts together."""

    trace: str | None = None
    """The `traceparent` of its submission, if that was traced."""
    webhook: Webhook | None = None
    """Given at submission, kept by the store on its own."""

    @property
    def limits(self) -> dict[str, float]:
        """The limits that were asked for, by name."""
        found = {"memory_bytes": self.memory_bytes, "timeout_s": self.timeout_s}
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, slots=True)
class Job:
    """One row of the queue, as it was at one moment.  Times are Unix milliseconds."""

    id: str
    seq: int
    spec: JobSpec
    state: JobState
    created_ms: int
    updated_ms: int
    started_ms: int | None = None
    """First time it ran."""
    finished_ms: int | None = None
    attempts: int = 0
    """Attempts begun."""
    failures: int = 0
    """Attempts lost by the job's own doing (a crash), since submission or the last retry."""
    interruptions: int = 0
    """Attempts lost because the service went away."""
    stalls: int = 0
    """Interruptions in a row without a finished pass between them."""
    max_attempts: int = 3
    used_ms: int = 0
    """Time on a slot since submission or the last retry, as of the last heartbeat."""
    cancel_requested: bool = False
    progress: Mapping[str, Any] | None = None
    error: Mapping[str, Any] | None = None
    result: Mapping[str, Any] | None = None
    lease: Lease | None = None


def new_job_id() -> str:
    """A fresh id: sorts by time, fits into a path and a URL."""
    return f"job-{int(time.time() * 1000):011x}-{secrets.token_hex(5)}"
