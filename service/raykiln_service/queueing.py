"""Whose turn comes when: places in the queue, and times guessed from the speed of earlier jobs."""

from __future__ import annotations

import heapq
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any, Literal, NamedTuple

from raykiln_service.events import EventHub
from raykiln_service.logs import get_logger
from raykiln_service.store import Store
from raykiln_service.store_queue import Pause, Run, Running, Waiting

Basis = Literal["scene", "recent"]
# What other scenes take says something only if there are a few of them.
_FEWEST_RUNS = 3
_MAX_AGE_S = 1.0
# A short queue is looked at whenever it has changed.  The view of a longer one may be a little
# old: it is made anew in the background, and that takes at most a twentieth of the time.
_SHORT = 500
_SHARE = 20.0


@dataclass(frozen=True, slots=True)
class Guess:
    """How long a job takes, and where that is known from."""

    seconds: float
    basis: Basis


class Turn(NamedTuple):
    """When a job is likely to begin and to end; None = unknown."""

    position: int | None
    """Jobs that go before it; None if it runs."""
    start_s: float | None
    end_s: float | None
    basis: Basis | None


class Speeds:
    """What the last finished jobs tell of those to come."""

    def __init__(self, runs: list[Run]) -> None:
        self._scenes: dict[str, list[Run]] = {}
        for run in runs:
            if run.scene_key is not None:
                self._scenes.setdefault(run.scene_key, []).append(run)
        self._general: tuple[float, float] | None = None
        if len(runs) >= _FEWEST_RUNS:
            pace = median(run.render_s / run.samples for run in runs)
            self._general = (pace, median(run.other_s for run in runs))
        self._known = {key: _pace_of(found) for key, found in self._scenes.items()}
        self._guesses: dict[tuple[int, str | None, int | None], Guess | None] = {}

    @property
    def samples_per_s(self) -> float | None:
        """Of the median job; None if too few are known."""
        return None if self._general is None else 1 / self._general[0]

    def guess(self, job: Waiting | Running) -> Guess | None:
        """How long a job takes from its begin to its end."""
        key = (job.samples, job.scene_key, job.limit_ms)
        if key not in self._guesses:
            self._guesses[key] = self._guess(job)
        return self._guesses[key]

    def _guess(self, job: Waiting | Running) -> Guess | None:
        if job.samples <= 0:
            return None
        basis: Basis = "scene" if job.scene_key in self._known else "recent"
        pace = self._known.get(job.scene_key or "", self._general)
        if pace is None:
            return None
        render_s = job.samples * pace[0]
        if job.limit_ms is not None:
            render_s = min(render_s, job.limit_ms / 1000)
        return Guess(render_s + pace[1], basis)


def _pace_of(runs: list[Run]) -> tuple[float, float]:
    pace = sum(run.render_s for run in runs) / sum(run.samples for run in runs)
    return pace, median(run.other_s for run in runs)


@dataclass(frozen=True, slots=True)
class QueueView:
    """The queue at one moment."""

    turns: Mapping[str, Turn]
    pause: Pause | None
    waiting: int
    running: int
    drained_s: float | None
    """Until all is done; None = unknown."""
    samples_per_s: float | None


class QueueWatch:
    """Looks at the queue, not more often than it is worth.

    Parameters
    ----------
    slots
        Jobs rendered at the same time.
    """

    def __init__(self, store: Store, hub: EventHub, slots: int) -> None:
        self._store = store
        self._hub = hub
        self._slots = slots
        self._lock = threading.Lock()
        self._refresher: threading.Thread | None = None
        self._view: QueueView | None = None
        self._version = -1
        self._taken_at = 0.0
        self._cost_s = 0.0

    def look(self) -> QueueView:
        """The queue as it is now; a long one as it was a moment ago."""
        with self._lock:
            view = self._view
            if view is None or (view.waiting <= _SHORT and self._is_stale()):
                return self._renew()
            if self._refresher is None and self._is_stale():
                self._refresher = threading.Thread(target=self._refresh, daemon=True)
                self._refresher.start()
            return view

    def _is_stale(self) -> bool:
        age_s = time.monotonic() - self._taken_at
        changed = self._version != self._store.version
        if self._view is not None and self._view.waiting > _SHORT:
            return age_s > (1 if changed else 2) * _SHARE * self._cost_s
        return changed or age_s > _MAX_AGE_S

    def _renew(self) -> QueueView:
        started, version = time.monotonic(), self._store.version
        view = self._take()
        self._view, self._version = view, version
        self._taken_at = time.monotonic()
        self._cost_s = self._taken_at - started
        return view

    def _refresh(self) -> None:
        try:
            self._renew()
        except Exception as error:
            # The view stays as it was; the next look tries again.
            get_logger().warning("no look at the queue", error=str(error))
        finally:
            self._refresher = None

    def _take(self) -> QueueView:
        pause, waiting, running = self._store.queue_now()
        speeds = Speeds(self._store.recent_runs())
        now = self._store.clock()
        turns = {job.id: self._running_turn(job, speeds, now) for job in running}
        ends = [_or_infinite(turn.end_s) for turn in turns.values()]
        ends += [0.0] * (self._slots - len(ends))
        heapq.heapify(ends)
        last = max(ends)
        for position, job in enumerate(waiting):
            guess = speeds.guess(job)
            start_s = math.inf if pause is not None else ends[0]
            end_s = start_s + (math.inf if guess is None else guess.seconds)
            heapq.heapreplace(ends, end_s)
            last = max(last, end_s)
            basis = None if guess is None else guess.basis
            turns[job.id] = Turn(position, _or_none(start_s), _or_none(end_s), basis)
        drained_s = _or_none(last)
        return QueueView(turns, pause, len(waiting), len(running), drained_s, speeds.samples_per_s)

    def _running_turn(self, job: Running, speeds: Speeds, now_ms: int) -> Turn:
        progress: Mapping[str, Any] = self._hub.latest_progress(job.id) or job.progress or {}
        if progress.get("eta_s") is not None:
            # The renderer knows best.
            return Turn(None, 0.0, float(progress["eta_s"]), "scene")
        guess = speeds.guess(job)
        left_s = None if guess is None else guess.seconds - (now_ms - job.since_ms) / 1000
        if guess is None or left_s is None or left_s < 0:
            return Turn(None, 0.0, None, None)
        return Turn(None, 0.0, left_s, guess.basis)


def _or_infinite(seconds: float | None) -> float:
    return math.inf if seconds is None else seconds


def _or_none(seconds: float) -> float | None:
    return None if math.isinf(seconds) else seconds
