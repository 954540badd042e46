"""The render children: each belongs to one scene for life, and waits for more jobs of it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from raykiln_service.executors.desk import Desk
from raykiln_service.executors.limits import private_bytes
from raykiln_service.executors.process import JsonChild

# A process that has rendered so much is thrown away for its leaks and fragments.
_MOST_TASKS = 1000


@dataclass(eq=False)
class Worker:
    """A child, the folder that it writes in, and the scene that it belongs to."""

    child: JsonChild
    desk: Desk
    key: str | None
    tasks: int = 0

    def end(self) -> None:
        """End it."""
        self.child.kill()
        self.desk.remove()


class WorkerPool:
    """Gives out children by the scene they have loaded.

    Parameters
    ----------
    start
        Starts a child.
    root
        Folder for the desks.
    warm_scenes, warm_memory_bytes
        How many idle children are kept, and how much memory they hold, at most.
    """

    def __init__(
        self,
        start: Callable[[], JsonChild],
        root: Path,
        warm_scenes: int,
        warm_memory_bytes: int,
    ) -> None:
        self._start = start
        self._root = root
        self._warm_scenes = warm_scenes
        self._warm_memory_bytes = warm_memory_bytes
        self._lock = threading.Lock()
        self._busy: set[Worker] = set()
        self._idle: OrderedDict[Worker, None] = OrderedDict()
        self._closed = False

    def take(self, key: str | None) -> Worker:
        """A child that has this scene loaded, or a new one; `OSError` if none can be started."""
        dead = []
        with self._lock:
            for worker in reversed(self._idle):
                if not worker.child.is_alive():
                    dead.append(worker)
                elif key is not None and worker.key == key:
                    del self._idle[worker]
                    self._busy.add(worker)
                    break
            else:
                worker = None
            for gone in dead:
                del self._idle[gone]
        for gone in dead:
            gone.end()
        return worker or self._new(key)

    def _new(self, key: str | None) -> Worker:
        worker = Worker(self._start(), Desk(self._root), key)
        with self._lock:
            closed = self._closed
            self._busy.add(worker)
        if closed:
            self.discard(worker)
            raise OSError(0, "the executor has been stopped")
        return worker

    def give_back(self, worker: Worker) -> None:
        """Keep a child that ended its task well, if it may serve again."""
        worker.tasks += 1
        if worker.key is None or worker.tasks >= _MOST_TASKS:
            self.discard(worker)
            return
        with self._lock:
            self._busy.discard(worker)
            self._idle[worker] = None
            surplus = self._surplus()
        for old in surplus:
            old.end()

    def discard(self, worker: Worker) -> None:
        """End a child."""
        with self._lock:
            self._busy.discard(worker)
        worker.end()

    def pids(self) -> list[int]:
        """Process ids of the children that run."""
        with self._lock:
            return [w.child.pid for w in (*self._busy, *self._idle) if w.child.is_alive()]

    def close(self) -> None:
        """End all children."""
        with self._lock:
            self._closed = True
            workers = [*self._busy, *self._idle]
            self._idle.clear()
        for worker in workers:
            worker.end()

    def _surplus(self) -> list[Worker]:
        """Take the idle children past the limits out of the pool, the longest unused first."""
        held = {worker: private_bytes(worker.child.pid) for worker in self._idle}
        surplus = []
        while self._idle and (
            self._closed
            or len(held) > self._warm_scenes
            or sum(held.values()) > self._warm_memory_bytes
        ):
            oldest, _ = self._idle.popitem(last=False)
            del held[oldest]
            surplus.append(oldest)
        return surplus
