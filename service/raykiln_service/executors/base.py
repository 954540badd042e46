"""What the dispatcher hands to an executor, and what it gets back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

from raykiln_service.planner import Unit


@dataclass(frozen=True, slots=True)
class Task:
    """One attempt at one unit."""

    job_id: str
    token: str
    """The attempt's lease token: names its folder, and tells late messages from current ones."""
    unit: Unit
    scene_path: Path
    base_dir: Path
    settings: Mapping[str, Any]
    outputs: tuple[str, ...]
    work_dir: Path
    """Empty folder for the outputs."""
    checkpoint: Path
    preview: Path
    scene_key: str | None = None
    """Names the scene by its content: tasks with the same key may share what was loaded.  None =
    keep nothing."""
    memory_bytes: int | None = None
    """Most memory that it may take, if less than the executor allows."""
    time_left_s: float | None = None
    """It ends as `TIMED_OUT` after this time."""


class StopReason(StrEnum):
    """Why a running task is to stop."""

    CANCEL = "cancel"
    SHUTDOWN = "shutdown"
    LEASE_LOST = "lease-lost"


class OutcomeKind(StrEnum):
    """How a task ended."""

    DONE = "done"
    """The outputs are in `work_dir`."""
    STOPPED = "stopped"
    """Stopped as asked; the partial image is in `work_dir` if `result` is given."""
    REJECTED = "rejected"
    """It cannot be rendered, or not within its memory: another attempt would end the same."""
    TIMED_OUT = "timed-out"
    """Its time is over; the partial image is in `work_dir` if `result` is given."""
    BROKEN = "broken"
    """The attempt failed; another one may do better."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a task ended, and what there is to tell."""

    kind: OutcomeKind
    result: Mapping[str, Any] | None = None
    """stats, warnings, scene_sha256, settings, complete, width, height."""
    error: Mapping[str, Any] = field(default_factory=dict)
    """reason, title, detail, and for scenes file, pointer, found, accepted."""


class Watcher(Protocol):
    """Who a task reports to; all calls come from the thread that runs the task."""

    def progress(self, progress: Mapping[str, Any]) -> None:
        """It has come so far."""

    def preview(self) -> None:
        """There is a new preview image."""

    def log(self, line: str) -> None:
        """Something for the job's log."""

    def stop_reason(self) -> StopReason | None:
        """Asked several times a second: whether the task is to stop."""


class Executor(Protocol):
    """Runs tasks somewhere else than in this process."""

    slots: int

    def start(self) -> None:
        """Get ready."""

    def run(self, slot: int, task: Task, watcher: Watcher) -> Outcome:
        """Run one task in a slot (0 to `slots` - 1) to its end."""

    def stop(self) -> None:
        """End all that runs."""

    def is_ready(self) -> bool:
        """Whether tasks can be run now."""
