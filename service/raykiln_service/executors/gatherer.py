"""Supervising the process that puts the frames of a job together."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raykiln_service.executors.base import Outcome, OutcomeKind, Watcher
from raykiln_service.executors.limits import MAX_FILE_BYTES, OWN_BYTES, Sandbox
from raykiln_service.executors.process import JsonChild
from raykiln_service.sandbox import Confinement

_MODULE = "raykiln_service.executors.gather"
_TICK_S = 0.1
# It tells of each frame; one that is silent for longer hangs.
_SILENCE_S = 300.0


@dataclass(frozen=True, slots=True)
class Gathering:
    """What to make of which frames."""

    frames: Sequence[tuple[int, Path]]
    """Number and EXR file, in order."""
    outputs: Sequence[str]
    fps: float
    job_dir: Path
    """Where the frames are."""
    work_dir: Path
    memory_bytes: int
    sandbox: Sandbox


def gather(task: Gathering, watcher: Watcher, module: str = _MODULE) -> Outcome:
    """Write the contact sheet and the animations; stops at once when `watcher` says so."""
    child = JsonChild(module, on_line=watcher.log)
    try:
        child.send(_request(task))
        heard_at = time.monotonic()
        while True:
            message = child.receive(_TICK_S)
            if message is None:
                return _broken(f"the process that gathers the frames {child.reap()}")
            if watcher.stop_reason() is not None:
                return Outcome(OutcomeKind.STOPPED)
            if message:
                heard_at = time.monotonic()
            elif time.monotonic() - heard_at > _SILENCE_S:
                return _broken("the process that gathers the frames hangs")
            match message.get("type"):
                case "progress":
                    watcher.progress({"phase": "gather", "fraction": float(message["share"])})
                case "done":
                    return Outcome(OutcomeKind.DONE)
                case "broken":
                    return _broken(f"the frames cannot be gathered: {message['detail']}")
    finally:
        child.kill()


def _request(task: Gathering) -> Mapping[str, Any]:
    limits = Confinement(
        readable=(str(task.job_dir),),
        writable=(str(task.work_dir),),
        memory_bytes=task.memory_bytes + OWN_BYTES,
        file_bytes=MAX_FILE_BYTES,
    )
    return {
        "type": "gather",
        "confine": {"sandbox": task.sandbox, "limits": limits.as_dict()},
        "frames": [[number, str(path)] for number, path in task.frames],
        "outputs": list(task.outputs),
        "fps": task.fps,
        "work_dir": str(task.work_dir),
    }


def _broken(detail: str) -> Outcome:
    error = {"reason": "gather-error", "title": "The frames cannot be gathered", "detail": detail}
    return Outcome(OutcomeKind.BROKEN, error=error)
