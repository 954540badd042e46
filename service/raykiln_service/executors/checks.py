"""Scene checks in child processes: confined, timed, and one scene each."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from typing import Any

from raykiln_service.assets import SceneFile
from raykiln_service.errors import InvalidSceneError, UnavailableError
from raykiln_service.executors.limits import OWN_BYTES, Sandbox, private_bytes
from raykiln_service.executors.nursery import Nursery
from raykiln_service.executors.process import JsonChild
from raykiln_service.sandbox import Confinement

_MODULE = "raykiln_service.executors.check"
_PARALLEL = 2
_TOO_LARGE = "the scene needs more memory than a check may use"
_CACHED = 256


class CheckPool:
    """Checks scenes, at most two at a time, and keeps what it learns of unchangeable ones."""

    def __init__(
        self,
        timeout_s: float,
        memory_bytes: int,
        *,
        sandbox: Sandbox = "auto",
        nursery: Nursery | None = None,
    ) -> None:
        self._timeout_s = timeout_s
        self._memory_bytes = memory_bytes
        self._sandbox = sandbox
        self._own_nursery = nursery is None
        self._nursery = nursery or Nursery()
        self._places = threading.BoundedSemaphore(_PARALLEL)
        self._lock = threading.Lock()
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
        for child in children:
            child.kill()
        if self._own_nursery:
            self._nursery.close()

    def _ask(self, scene: SceneFile) -> dict[str, Any]:
        child = self._start()
        try:
            return self._answer(child, scene)
        finally:
            with self._lock:
                self._all.discard(child)
            # It has seen this scene, so it is not for another.
            child.kill()

    def _start(self) -> JsonChild:
        try:
            child = JsonChild(_MODULE, launch=self._nursery.start)
        except OSError as error:
            raise UnavailableError(f"no scene can be checked now: {error.strerror}") from None
        with self._lock:
            self._all.add(child)
        return child

    def _answer(self, child: JsonChild, scene: SceneFile) -> dict[str, Any]:
        limits = Confinement(
            readable=(str(scene.path if scene.alone else scene.base_dir),),
            writable=(),
            memory_bytes=self._memory_bytes + OWN_BYTES,
            file_bytes=0,
        )
        child.send(
            {
                "type": "check",
                "confine": {"sandbox": self._sandbox, "limits": limits.as_dict()},
                "path": str(scene.path),
                "base_dir": str(scene.base_dir),
            }
        )
        deadline = time.monotonic() + self._timeout_s
        reply: dict[str, Any] | None = {}
        while reply == {} and time.monotonic() < deadline:
            reply = child.receive(min(0.2, max(0.0, deadline - time.monotonic())))
            if private_bytes(child.pid) > self._memory_bytes + OWN_BYTES:
                raise InvalidSceneError(_TOO_LARGE)
        if not reply:
            raise self._given_up(child, timed_out=reply is not None)
        if reply["type"] == "rejected":
            raise InvalidSceneError(**reply["error"])
        return reply

    def _given_up(self, child: JsonChild, *, timed_out: bool) -> InvalidSceneError:
        if timed_out:
            return InvalidSceneError(f"the scene check took more than {self._timeout_s:g} s")
        how = child.reap()
        if self._closed:
            raise UnavailableError("the service is shutting down")
        last = next((line for line in reversed(child.tail) if line.strip()), "")
        if "MemoryError" in last or "bad_alloc" in last:
            return InvalidSceneError(_TOO_LARGE)
        return InvalidSceneError(f"the scene broke the process that checked it ({how})")
