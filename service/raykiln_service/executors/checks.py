"""Scene checks in child processes that are kept warm, thrown away when in doubt, and timed."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from typing import Any

from raykiln_service.assets import SceneFile
from raykiln_service.errors import InvalidSceneError, UnavailableError
from raykiln_service.executors.process import JsonChild

_MODULE = "raykiln_service.executors.check"
_PARALLEL = 2
_CHECKS_A_CHILD = 50
_CACHED = 256


class CheckPool:
    """Checks scenes, at most two at a time, and keeps what it learns of unchangeable ones."""

    def __init__(self, timeout_s: float, memory_bytes: int) -> None:
        self._timeout_s = timeout_s
        self._arguments = [str(memory_bytes)]
        self._places = threading.BoundedSemaphore(_PARALLEL)
        self._lock = threading.Lock()
        self._idle: list[tuple[JsonChild, int]] = []
        self._all: set[JsonChild] = set()
        self._known: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._closed = False

    def check(self, scene: SceneFile, key: str | None) -> dict[str, Any]:
        """What is in a scene: summary, settings, cameras, warnings.

        Parameters
        ----------
        key
            Names an unchangeable scene (the asset's hash and entry), None one that is not kept.

        Raises
        ------
        InvalidSceneError
            It cannot be rendered, or looking at it takes too long or too much memory.
        """
        if key is not None:
            with self._lock:
                if key in self._known:
                    self._known.move_to_end(key)
                    return self._known[key]
        if not self._places.acquire(timeout=self._timeout_s):
            raise UnavailableError(
                "too many scenes are being checked at once", headers={"Retry-After": "10"}
            )
        try:
            report = self._ask(scene)
        finally:
            self._places.release()
        if key is not None:
            with self._lock:
                self._known[key] = report
                while len(self._known) > _CACHED:
                    self._known.popitem(last=False)
        return report

    def close(self) -> None:
        """End the children."""
        with self._lock:
            self._closed = True
            children = list(self._all)
            self._idle.clear()
        for child in children:
            child.kill()

    def _ask(self, scene: SceneFile) -> dict[str, Any]:
        child, uses = self._take()
        child.send({"type": "check", "path": str(scene.path), "base_dir": str(scene.base_dir)})
        deadline = time.monotonic() + self._timeout_s
        reply: dict[str, Any] | None = {}
        while reply == {} and time.monotonic() < deadline:
            reply = child.receive(min(0.5, max(0.0, deadline - time.monotonic())))
        if not reply:
            raise self._given_up(child, timed_out=reply is not None)
        self._give_back(child, uses + 1)
        if reply["type"] == "rejected":
            raise InvalidSceneError(**reply["error"])
        return reply

    def _given_up(self, child: JsonChild, *, timed_out: bool) -> InvalidSceneError:
        with self._lock:
            self._all.discard(child)
        if timed_out:
            child.kill()
            return InvalidSceneError(f"the scene check took more than {self._timeout_s:g} s")
        how = child.reap()
        if self._closed:
            raise UnavailableError("the service is shutting down")
        last = next((line for line in reversed(child.tail) if line.strip()), "")
        if "MemoryError" in last or "bad_alloc" in last:
            return InvalidSceneError("the scene needs more memory than a check may use")
        return InvalidSceneError(f"the scene broke the process that checked it ({how})")

    def _take(self) -> tuple[JsonChild, int]:
        with self._lock:
            while self._idle:
                child, uses = self._idle.pop()
                if child.is_alive():
                    return child, uses
                self._all.discard(child)
        child = JsonChild(_MODULE, self._arguments)
        with self._lock:
            self._all.add(child)
        return child, 0

    def _give_back(self, child: JsonChild, uses: int) -> None:
        with self._lock:
            if not self._closed and uses < _CHECKS_A_CHILD:
                self._idle.append((child, uses))
                return
            self._all.discard(child)
        child.kill()
