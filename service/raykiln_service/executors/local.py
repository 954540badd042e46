"""Rendering in supervised child processes of this machine: one slot, one child at a time.

A child is confined to the scene of its first task (see the decision on sandbox and warm children)
and kept for further tasks of that scene, unless its task ended in any other way than well.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

from raykiln_service.errors import StartupError
from raykiln_service.executors.base import Outcome, OutcomeKind, Task, Watcher
from raykiln_service.executors.limits import MAX_FILE_BYTES, OWN_BYTES, Limits
from raykiln_service.executors.nursery import Nursery
from raykiln_service.executors.pool import Worker, WorkerPool
from raykiln_service.executors.process import JsonChild
from raykiln_service.executors.supervision import Supervision
from raykiln_service.sandbox import Confinement, missing_layers

_MODULE = "raykiln_service.executors.child"
_PROBE = "raykiln_service.executors.probe"
_PROBE_TIMEOUT_S = 30.0


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
    limits
        What children may take.
    scratch
        Folder for what children write, best on the file system of the results; None = one of
        its own.
    nursery
        Where children come from; None = one of its own.
    """

    def __init__(
        self,
        slots: int,
        *,
        checkpoint_interval_s: float = 5.0,
        module: str = _MODULE,
        limits: Limits | None = None,
        scratch: Path | None = None,
        nursery: Nursery | None = None,
    ) -> None:
        self.slots = slots
        self.limits = limits or Limits()
        self._threads = max(1, len(os.sched_getaffinity(0)) // slots)
        self._interval_s = checkpoint_interval_s
        self._module = module
        self._own_scratch = scratch is None
        self._scratch = Path(tempfile.mkdtemp(prefix="raykiln-")) if scratch is None else scratch
        self._own_nursery = nursery is None
        self._nursery = nursery or Nursery()
        self._pool = WorkerPool(
            lambda: JsonChild(self._module, launch=self._nursery.start),
            self._scratch,
            self.limits.warm_scenes,
            self.limits.warm_memory_bytes,
        )
        self._lock = threading.Lock()
        self._layers: dict[str, str] | None = None
        self._stopped = False

    def start(self) -> None:
        """Get ready, so that the first job finds everything loaded."""
        self.sandbox_layers()

    def sandbox_layers(self) -> dict[str, str]:
        """What confines children on this machine, by layer; found out by confining one.

        Raises
        ------
        StartupError
            A layer is missing and the sandbox is required, or no process can be started.
        """
        if self.limits.sandbox == "off":
            return {}
        with self._lock:
            if self._layers is None:
                self._layers = self._probe()
        missing = missing_layers(self._layers)
        if missing and self.limits.sandbox == "require":
            reasons = "; ".join(f"{name}: {reason}" for name, reason in missing.items())
            raise StartupError(f"the sandbox is required and cannot be had here ({reasons})")
        return self._layers

    def _probe(self) -> dict[str, str]:
        try:
            child = JsonChild(_PROBE, launch=self._nursery.start)
        except OSError as error:
            raise StartupError(f"no render process can be started: {error.strerror}") from None
        child.send({"writable": [str(self._scratch)]})
        reply = child.receive(_PROBE_TIMEOUT_S)
        child.kill()
        if not reply:
            said = " ".join(child.tail)
            raise StartupError(f"no render process can be confined: {said or 'no answer'}")
        layers: dict[str, str] = reply["layers"]
        return layers

    def is_ready(self) -> bool:
        """Whether tasks can be run now."""
        return not self._stopped

    def child_pids(self) -> list[int]:
        """Process ids of the children that run now."""
        return self._pool.pids()

    def stop(self) -> None:
        """End all children."""
        self._stopped = True
        self._pool.close()
        if self._own_nursery:
            self._nursery.close()
        if self._own_scratch:
            shutil.rmtree(self._scratch, ignore_errors=True)

    def run(self, slot: int, task: Task, watcher: Watcher) -> Outcome:
        """Run one task to its end, whatever the child does."""
        while True:
            try:
                worker = self._pool.take(task.scene_key)
            except OSError as error:
                detail = f"no render process could be started: {error.strerror or error}"
                problem = {"reason": "crashed", "title": "No render process", "detail": detail}
                return Outcome(OutcomeKind.BROKEN, error=problem)
            try:
                outcome = self._run_in(worker, task, watcher)
            except BaseException:
                self._pool.discard(worker)
                raise
            worker.child.on_line = None
            if outcome is not None and outcome.kind is OutcomeKind.DONE:
                # What lies there would outlive the job's deletion.
                worker.desk.clear()
                self._pool.give_back(worker)
                return outcome
            self._pool.discard(worker)
            if outcome is not None:
                return outcome

    def _run_in(self, worker: Worker, task: Task, watcher: Watcher) -> Outcome | None:
        """How the task ended; None if the child had died before, while it waited for one."""
        memory_bytes = min(task.memory_bytes or self.limits.memory_bytes, self.limits.memory_bytes)
        worker.desk.lay_out(task.checkpoint)
        worker.child.on_line = watcher.log
        worker.child.send(self._request(worker, task, memory_bytes))
        supervision = Supervision(
            worker,
            task,
            watcher,
            memory_bytes=memory_bytes,
            silence_s=self.limits.silence_s,
        )
        outcome = supervision.run()
        # Its end is told a moment after it, so the pool may have taken it for alive.
        is_old = worker.tasks > 0 and not supervision.was_heard
        return None if is_old and outcome.error.get("reason") == "crashed" else outcome

    def _request(self, worker: Worker, task: Task, memory_bytes: int) -> dict[str, Any]:
        frame = task.unit.frame
        return {
            "type": "render",
            "token": task.token,
            "confine": self._confinement(worker, task),
            "memory_bytes": memory_bytes,
            "scene_path": str(task.scene_path),
            "base_dir": str(task.base_dir),
            "settings": dict(task.settings),
            "camera": None if frame is None or frame.camera is None else dict(frame.camera),
            "time_s": None if frame is None else frame.time_s,
            "outputs": list(task.outputs),
            "work_dir": str(worker.desk.out),
            "checkpoint": str(worker.desk.checkpoint),
            "checkpoint_interval_s": self._interval_s,
            "preview": str(worker.desk.preview),
            "threads": self._threads,
        }

    def _confinement(self, worker: Worker, task: Task) -> dict[str, Any]:
        limits = Confinement(
            readable=(readable_of(task.scene_path, task.base_dir, task.checkpoint.parent),),
            writable=(str(worker.desk.path),),
            memory_bytes=self.limits.memory_bytes + OWN_BYTES,
            file_bytes=MAX_FILE_BYTES,
        )
        return {"sandbox": self.limits.sandbox, "limits": limits.as_dict()}


def readable_of(scene: Path, base_dir: Path, job_dir: Path) -> str:
    """What of the disk a scene is: its folder, or one file if it lies among a job's own files."""
    return str(scene if base_dir == job_dir else base_dir)
