"""Watching one task in one child, from the outside: it must end, in time and within its memory.

The supervisor never waits for the render thread.  It beats the lease's heart itself, and kills a
child that does not stop when told to, that takes too much, or that is not heard of any more.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from raykiln_service.executors.base import Outcome, OutcomeKind, StopReason, Task, Watcher
from raykiln_service.executors.limits import OWN_BYTES, private_bytes
from raykiln_service.executors.pool import Worker

_TICK_S = 0.05
# How long a child may take to stop by itself; a shutdown also waits for its checkpoint.
_GRACE_S = {StopReason.CANCEL: 0.6, StopReason.SHUTDOWN: 3.0, StopReason.LEASE_LOST: 0.0}
_TIMEOUT_GRACE_S = 10.0
# On a machine that is too busy, a child that is heard of gets more time to save its image.
_ALIVE_S, _ALIVE_GRACE_S = 2.0, 5.0
# An image that is stopped is kept, which is worth waiting for, until its first file is there.
_ENCODE_GRACE_S = 10.0
_SILENT_PHASES, _SILENCE_FACTOR = ("load", "encode"), 10
_TALKING_PHASES = ("render", "denoise")
_TIMEOUT = "timeout"
_OUT_OF_MEMORY = "out-of-memory"


class Supervision:
    """Watches one task in one child.

    Parameters
    ----------
    memory_bytes
        What the task may take besides what every child does.
    silence_s
        See `Limits`.
    """

    def __init__(
        self, worker: Worker, task: Task, watcher: Watcher, *, memory_bytes: int, silence_s: float
    ) -> None:
        self._child = worker.child
        self._desk = worker.desk
        self._task = task
        self._watcher = watcher
        self._memory_bytes = memory_bytes
        self._silence_s = silence_s
        self._reason: StopReason | None = None
        self._timed_out = False
        self._phase = "load"
        self._partial: Mapping[str, Any] | None = None
        self._peak_bytes = 0
        now = time.monotonic()
        self._kill_at = float("inf")
        self._grace_ends = float("inf")
        self._heard_at = now
        self.was_heard = False
        """Whether the child has said anything of the task."""
        left = task.time_left_s
        self._ends_at = float("inf") if left is None else now + left

    def run(self) -> Outcome:
        """Until the child has told the end, has ended, or is ended."""
        while True:
            message = self._child.receive(_TICK_S)
            if message is None:
                return self._gone()
            if message.get("token") == self._task.token:
                self._heard_at = time.monotonic()
                self.was_heard = True
                outcome = self._heard(message)
                if outcome is not None:
                    return outcome
            outcome = self._look()
            if outcome is not None:
                return outcome

    def _look(self) -> Outcome | None:
        """What a look at the child, the clock and the lease leads to."""
        now = time.monotonic()
        reason = self._watcher.stop_reason()
        if reason is not None and reason is not self._reason:
            self._reason = reason
            self._stop(reason, _GRACE_S[reason])
        if now >= self._ends_at and not self._timed_out:
            self._timed_out = True
            self._stop(_TIMEOUT, _TIMEOUT_GRACE_S)
        if now >= self._kill_at and not self._may_still_stop(now):
            return self._killed()
        used = private_bytes(self._child.pid)
        self._peak_bytes = max(self._peak_bytes, used)
        if used > self._memory_bytes + OWN_BYTES:
            self._child.kill()
            return self._too_large(f"it held {used >> 20} MiB")
        factor = _SILENCE_FACTOR if self._phase in _SILENT_PHASES else 1
        if now - self._heard_at > factor * self._silence_s:
            self._child.kill()
            self._desk.take_checkpoint(self._task.checkpoint)
            detail = (
                f"the render process said nothing for {factor * self._silence_s:g} s "
                f"in the phase {self._phase!r}"
            )
            error = {"reason": "stalled", "title": "The render process hung", "detail": detail}
            return Outcome(OutcomeKind.BROKEN, error=error)
        return None

    def _stop(self, reason: str, grace_s: float) -> None:
        self._child.send({"type": "stop", "token": self._task.token, "reason": reason})
        # Loading cannot be stopped, and leads to nothing that is worth keeping, unless an earlier
        # attempt left an image.
        nothing = self._phase == "load" and not self._task.checkpoint.exists()
        ends = time.monotonic() + (0.0 if nothing else grace_s)
        self._grace_ends = min(self._grace_ends, ends)
        self._kill_at = min(self._kill_at, ends)
        self._wait_for_image()

    def _keeps_image(self) -> bool:
        return self._reason is StopReason.CANCEL or (self._timed_out and self._reason is None)

    def _may_still_stop(self, now: float) -> bool:
        return (
            self._keeps_image()
            and self._phase in _TALKING_PHASES
            and now - self._heard_at < _ALIVE_S
            and now < self._grace_ends + _ALIVE_GRACE_S
        )

    def _wait_for_image(self) -> None:
        if self._keeps_image() and self._phase == "encode" and self._partial is None:
            self._kill_at = max(self._kill_at, time.monotonic() + _ENCODE_GRACE_S)

    def _heard(self, message: Mapping[str, Any]) -> Outcome | None:
        match message["type"]:
            case "progress":
                self._enter(message["progress"]["phase"])
                self._watcher.progress(message["progress"])
            case "preview":
                if self._desk.take_preview(self._task.preview):
                    self._watcher.preview()
            case "checkpoint":
                self._desk.take_checkpoint(self._task.checkpoint)
            case "partial":
                self._partial = message["result"]
                self._kill_at = self._grace_ends
            case "log":
                self._watcher.log(message["line"])
            case "done":
                self._desk.take_outputs(self._task.work_dir)
                return Outcome(OutcomeKind.DONE, result=message["result"])
            case "stopped":
                return self._stopped(message["result"])
            case "rejected":
                return Outcome(OutcomeKind.REJECTED, error=message["error"])
            case "broken":
                self._desk.take_checkpoint(self._task.checkpoint)
                return Outcome(OutcomeKind.BROKEN, error=message["error"])
        return None

    def _enter(self, phase: str) -> None:
        if phase != self._phase:
            self._phase = phase
            if self._reason is not None or self._timed_out:
                self._wait_for_image()

    def _killed(self) -> Outcome:
        self._child.kill()
        return self._stopped(self._partial)

    def _stopped(self, result: Mapping[str, Any] | None) -> Outcome:
        """The end that was asked for."""
        self._desk.take_checkpoint(self._task.checkpoint)
        if result is not None:
            self._desk.take_outputs(self._task.work_dir)
        if self._timed_out and self._reason is None:
            detail = "the job took longer than its time limit"
            error = {"reason": _TIMEOUT, "title": "The time is over", "detail": detail}
            return Outcome(OutcomeKind.TIMED_OUT, result=result, error=error)
        return Outcome(OutcomeKind.STOPPED, result=result)

    def _gone(self) -> Outcome:
        how = self._child.reap()
        if self._reason is not None or self._timed_out:
            return self._stopped(self._partial)
        self._desk.take_checkpoint(self._task.checkpoint)
        last = next((line for line in reversed(self._child.tail) if line.strip()), "")
        if "MemoryError" in last or "bad_alloc" in last:
            return self._too_large(last)
        detail = f"the render process {how}" + (f": {last}" if last else "")
        error = {"reason": "crashed", "title": "The render process broke", "detail": detail}
        return Outcome(OutcomeKind.BROKEN, error=error)

    def _too_large(self, found: str) -> Outcome:
        return Outcome(OutcomeKind.REJECTED, error=out_of_memory(self._memory_bytes, found))


def out_of_memory(memory_bytes: int, found: str | None = None) -> dict[str, Any]:
    """The problem of a job that needs more memory than it may take."""
    detail = f"the render needs more than the {memory_bytes >> 20} MiB of memory that it may take"
    problem = {"reason": _OUT_OF_MEMORY, "title": "Out of memory", "detail": detail}
    return problem if found is None else {**problem, "found": found}
