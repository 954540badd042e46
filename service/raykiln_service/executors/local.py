"""Rendering in supervised child processes of this machine: one slot, one child at a time.

A child is kept between tasks and thrown away after anything but a clean end.  The supervisor
never waits for the render thread: it beats the lease's heart itself, and kills a child that does
not stop when told to.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from typing import Any

from raykiln_service.executors.base import Outcome, OutcomeKind, StopReason, Task, Watcher
from raykiln_service.executors.process import JsonChild

_MODULE = "raykiln_service.executors.child"
_TICK_S = 0.1
# How long a child may take to stop by itself; a shutdown also waits for its checkpoint.
_GRACE_S = {StopReason.CANCEL: 1.0, StopReason.SHUTDOWN: 3.0, StopReason.LEASE_LOST: 0.0}

_ENCODE_GRACE_S = 30.0


class LocalExecutor:
    """Runs each task in a child process.

    Parameters
    ----------
    slots
        Tasks at the same time; the processors are shared out among them.
    checkpoint_interval_s
        Render time between checkpoints.
    module
        The child's module (tests put in one that crashes).
    """

    def __init__(
        self, slots: int, *, checkpoint_interval_s: float = 5.0, module: str = _MODULE
    ) -> None:
        self.slots = slots
        self._threads = max(1, len(os.sched_getaffinity(0)) // slots)
        self._interval_s = checkpoint_interval_s
        self._module = module
        self._children: list[JsonChild | None] = [None] * slots
        self._lock = threading.Lock()
        self._stopped = False

    def start(self) -> None:
        """Start a child for each slot, so that the first job finds it warm."""
        for slot in range(self.slots):
            self._child(slot)

    def is_ready(self) -> bool:
        """Whether tasks can be run now."""
        return not self._stopped

    def child_pids(self) -> list[int]:
        """Process ids of the children that run now."""
        return [child.pid for child in self._children if child is not None and child.is_alive()]

    def stop(self) -> None:
        """End all children."""
        with self._lock:
            self._stopped = True
            children = [child for child in self._children if child is not None]
        for child in children:
            child.kill()

    def run(self, slot: int, task: Task, watcher: Watcher) -> Outcome:
        """Run one task to its end, whatever the child does."""
        child = self._child(slot)
        child.on_line = watcher.log
        child.send(self._request(task))
        try:
            outcome = _Supervision(child, task, watcher).run()
        except BaseException:
            self._discard(slot)
            raise
        child.on_line = None
        if outcome.kind is not OutcomeKind.DONE:
            self._discard(slot)
        return outcome

    def _request(self, task: Task) -> dict[str, Any]:
        frame = task.unit.frame
        return {
            "type": "render",
            "token": task.token,
            "scene_path": str(task.scene_path),
            "base_dir": str(task.base_dir),
            "settings": dict(task.settings),
            "camera": None if frame is None or frame.camera is None else dict(frame.camera),
            "time_s": None if frame is None else frame.time_s,
            "outputs": list(task.outputs),
            "work_dir": str(task.work_dir),
            "checkpoint": str(task.checkpoint),
            "checkpoint_interval_s": self._interval_s,
            "preview": str(task.preview),
            "threads": self._threads,
        }

    def _child(self, slot: int) -> JsonChild:
        with self._lock:
            child = self._children[slot]
            if child is None or not child.is_alive():
                child = self._children[slot] = JsonChild(self._module)
            return child

    def _discard(self, slot: int) -> None:
        with self._lock:
            child, self._children[slot] = self._children[slot], None
        if child is not None:
            child.kill()


class _Supervision:
    """Watches one task in one child."""

    def __init__(self, child: JsonChild, task: Task, watcher: Watcher) -> None:
        self._child = child
        self._task = task
        self._watcher = watcher
        self._reason: StopReason | None = None
        self._kill_at = float("inf")

    def run(self) -> Outcome:
        """Until the child has told the end, or has ended."""
        while True:
            message = self._child.receive(_TICK_S)
            if message is None:
                return self._gone()
            if message.get("token") == self._task.token:
                outcome = self._heard(message)
                if outcome is not None:
                    return outcome
            self._look_for_stop()
            if time.monotonic() >= self._kill_at:
                self._child.kill()
                return Outcome(OutcomeKind.STOPPED)

    def _look_for_stop(self) -> None:
        reason = self._watcher.stop_reason()
        if reason is None or reason is self._reason:
            return
        self._reason = reason
        self._kill_at = min(self._kill_at, time.monotonic() + _GRACE_S[reason])
        self._child.send({"type": "stop", "token": self._task.token, "reason": reason})

    def _heard(self, message: Mapping[str, Any]) -> Outcome | None:
        match message["type"]:
            case "progress":
                if self._reason is StopReason.CANCEL and message["progress"]["phase"] == "encode":
                    # The render has stopped; the partial image is being written.
                    self._kill_at = time.monotonic() + _ENCODE_GRACE_S
                self._watcher.progress(message["progress"])
            case "preview":
                self._watcher.preview()
            case "log":
                self._watcher.log(message["line"])
            case "done":
                return Outcome(OutcomeKind.DONE, result=message["result"])
            case "stopped":
                return Outcome(OutcomeKind.STOPPED, result=message["result"])
            case "rejected":
                return Outcome(OutcomeKind.REJECTED, error=message["error"])
            case "broken":
                return Outcome(OutcomeKind.BROKEN, error=message["error"])
        return None

    def _gone(self) -> Outcome:
        how = self._child.reap()
        if self._reason is not None:
            return Outcome(OutcomeKind.STOPPED)
        last = next((line for line in reversed(self._child.tail) if line.strip()), "")
        detail = f"the render process {how}" + (f": {last}" if last else "")
        error = {"reason": "crashed", "title": "The render process broke", "detail": detail}
        return Outcome(OutcomeKind.BROKEN, error=error)
