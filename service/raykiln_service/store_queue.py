"""The order of the queue, its pause, and what is known of the speed of earlier jobs.

Order: a job that is put into the queue gets the rank `queued_ms - priority x step`, and the
lowest rank goes first.  So a level of priority is worth one step of waiting, and nothing starves:
every job passes those that came later than its handicap.  The rank never changes while the job
waits, which keeps the queue one index scan.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, NamedTuple

import sqlalchemy as sa

from raykiln_service.jobs import JobState
from raykiln_service.store_base import StoreBase
from raykiln_service.tables import IS_QUEUED, IS_RUNNING, IS_SUCCEEDED, jobs, queue

_RECENT = 64


@dataclass(frozen=True, slots=True)
class Traits:
    """What the service found out about a new job, for its turn and for the cache."""

    scene_key: str | None = None
    """Names the scene: jobs with the same one run at about the same speed."""
    limit_ms: int | None = None
    """Render time that the job allows itself."""
    cache_key: str | None = None
    """Names the result; None = it is not the same each time."""
    use_cache: bool = True
    """Whether an earlier result may be the answer."""


NO_TRAITS = Traits()


@dataclass(frozen=True, slots=True)
class Pause:
    """That, since when and why no job is begun.  The time is in Unix milliseconds."""

    since_ms: int
    reason: str | None


class Waiting(NamedTuple):
    """A queued job, as far as its turn and its duration go."""

    id: str
    samples: int
    """Camera samples asked for; 0 = unknown."""
    scene_key: str | None
    limit_ms: int | None


class Running(NamedTuple):
    """A running job: what the heartbeat last said."""

    id: str
    samples: int
    scene_key: str | None
    limit_ms: int | None
    since_ms: int
    """When the attempt began."""
    progress: Any


@dataclass(frozen=True, slots=True)
class Run:
    """How long an earlier job took."""

    scene_key: str | None
    samples: int
    render_s: float
    """Pure rendering."""
    other_s: float
    """Loading, building, encoding, writing."""


class QueueStore(StoreBase):
    """The queue as a whole."""

    def pause(self, reason: str | None = None) -> Pause:
        """Begin no further job, also after a restart; those that run go on."""
        now = self.clock()
        with self.database.write() as connection:
            query = queue.update().where(queue.c.paused_ms.is_(None))
            connection.execute(query.values(paused_ms=now, reason=reason))
            found = self._pause(connection)
        self.queue_changed()
        assert found is not None
        return found

    def resume(self) -> None:
        """Begin jobs again."""
        with self.database.write() as connection:
            connection.execute(queue.update().values(paused_ms=None, reason=None))
        self.queue_changed()

    def paused(self) -> Pause | None:
        """The pause of the queue, if there is one."""
        with self.database.read() as connection:
            return self._pause(connection)

    def rerank(self) -> None:
        """Give the waiting jobs the ranks of this store's priority step."""
        rank = jobs.c.queued_ms - jobs.c.priority * sa.literal(self.priority_step_ms, sa.BigInteger)
        with self.database.write() as connection:
            query = jobs.update().where(IS_QUEUED, jobs.c.rank_ms != rank)
            connection.execute(query.values(rank_ms=rank))

    def waiting(self) -> list[Waiting]:
        """All queued jobs, the next one first."""
        return self.queue_now()[1]

    def queue_now(self) -> tuple[Pause | None, list[Waiting], list[Running]]:
        """The pause, all queued jobs (the next one first), and all running ones."""
        what = (jobs.c.id, jobs.c.pixel_samples, jobs.c.scene_key, jobs.c.limit_ms)
        queued = sa.select(*what).where(IS_QUEUED).order_by(jobs.c.rank_ms, jobs.c.seq)
        run = sa.select(*what, jobs.c.updated_ms, jobs.c.progress).where(IS_RUNNING)
        with self.database.read() as connection:
            pause = self._pause(connection)
            waiting = [Waiting(*row) for row in connection.execute(queued).all()]
            rows = connection.execute(run).all()
        running = [
            Running(*row[:5], None if row[5] is None else json.loads(row[5])) for row in rows
        ]
        return pause, waiting, running

    def recent_runs(self) -> list[Run]:
        """How long the last finished jobs took, newest first; answers from the cache left out."""
        columns = (jobs.c.scene_key, jobs.c.started_ms, jobs.c.finished_ms, jobs.c.result)
        query = sa.select(*columns).where(IS_SUCCEEDED, jobs.c.attempts == 1)
        query = query.order_by(jobs.c.seq.desc()).limit(_RECENT)
        with self.database.read() as connection:
            rows = connection.execute(query).all()
        return [run for row in rows if (run := _run_of(*row)) is not None]

    def result_of_key(self, cache_key: str) -> tuple[str, dict[str, Any]] | None:
        """The newest job that succeeded with this key, and its result; None if there is none."""
        query = sa.select(jobs.c.id, jobs.c.result)
        query = query.where(IS_SUCCEEDED, jobs.c.cache_key == cache_key)
        with self.database.read() as connection:
            row = connection.execute(query.order_by(jobs.c.seq.desc()).limit(1)).one_or_none()
        return None if row is None else (row.id, json.loads(row.result))

    def cache_key_of(self, job_id: str) -> str | None:
        """The key under which a job may be answered from the cache; None if it may not."""
        query = sa.select(jobs.c.cache_key).where(jobs.c.id == job_id, jobs.c.use_cache == 1)
        with self.database.read() as connection:
            return connection.execute(query).scalar_one_or_none()

    def oldest_queued_ms(self) -> int | None:
        """When the job that waits longest was queued."""
        with self.database.read() as connection:
            found = connection.execute(sa.select(sa.func.min(jobs.c.queued_ms)).where(IS_QUEUED))
            value = found.scalar_one()
        return None if value is None else int(value)

    @staticmethod
    def _pause(connection: sa.Connection) -> Pause | None:
        row = connection.execute(sa.select(queue.c.paused_ms, queue.c.reason)).one()
        return None if row.paused_ms is None else Pause(row.paused_ms, row.reason)

    def _place(self, connection: sa.Connection, priority: int) -> dict[str, int]:
        """When a job comes into the queue, and its rank there.

        A clock that was set back does not let new jobs pass those that wait already.
        """
        query = sa.select(jobs.c.queued_ms).where(jobs.c.state == JobState.QUEUED)
        last = connection.execute(query.order_by(jobs.c.seq.desc()).limit(1)).scalar_one_or_none()
        now = max(self.clock(), last or 0)
        return {"queued_ms": now, "rank_ms": now - priority * self.priority_step_ms}


def _run_of(scene_key: str | None, started: int, finished: int, result: str) -> Run | None:
    value = json.loads(result)
    stats = value.get("stats") or {}
    render_s, samples = float(stats.get("render_s") or 0), int(stats.get("samples") or 0)
    if value.get("cached_from") or render_s <= 0 or samples <= 0:
        return None
    return Run(scene_key, samples, render_s, max(0.0, (finished - started) / 1000 - render_s))
