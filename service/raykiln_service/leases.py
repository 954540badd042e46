"""The dispatcher's side of the job store: claims, heartbeats and the ends of attempts."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping
from typing import Any

import sqlalchemy as sa

from raykiln_service.errors import LeaseLostError
from raykiln_service.jobs import Job, JobEvent, JobState, Lease
from raykiln_service.rows import dump, job_of
from raykiln_service.settings import MAX_DELAY_S
from raykiln_service.store_base import Change, fence
from raykiln_service.tables import IS_QUEUED, IS_RUNNING, jobs, queue
from raykiln_service.units import UnitStore, unfinished_frames

# A job whose every attempt takes the whole service down must end some day; each finished pass
# starts the count anew.
MAX_STALLS = 100


class LeaseStore(UnitStore):
    """Jobs as a dispatcher works on them."""

    def claim(self, owner: str, lease_s: float) -> Job | None:
        """Take the first job that is due, with a fresh lease; None if none is, or in a pause."""
        now = self.clock()
        is_due = sa.or_(
            jobs.c.not_before_ms <= now,
            jobs.c.not_before_ms > now + int(MAX_DELAY_S * 1000),
        )
        is_paused = sa.exists().where(queue.c.paused_ms.is_not(None))
        query = (
            sa.select(jobs)
            .where(IS_QUEUED, is_due, ~is_paused)
            .order_by(jobs.c.rank_ms, jobs.c.seq)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        with self._change() as change:
            row = change.connection.execute(query).mappings().one_or_none()
            if row is None:
                return None
            job = job_of(row)
            self._move(
                change,
                job,
                JobEvent.CLAIM,
                attempts=job.attempts + 1,
                started_ms=job.started_ms or now,
                lease_owner=owner,
                lease_token=secrets.token_hex(16),
                lease_expires_ms=now + int(lease_s * 1000),
            )
        return self.job(job.id)

    def heartbeat(
        self,
        lease: Lease,
        lease_s: float,
        progress: Mapping[str, Any] | None,
        *,
        advanced: bool,
        used_ms: int | None = None,
    ) -> None:
        """Prolong a lease and note the progress; `LeaseLostError` if it is lost.

        `advanced` says that a pass was finished since the attempt began, `used_ms` how long the
        job has been on a slot in all.
        """
        now = self.clock()
        values: dict[str, Any] = {"lease_expires_ms": now + int(lease_s * 1000)}
        if progress is not None:
            values["progress"] = dump(dict(progress))
        if advanced:
            values["stalls"] = 0
        if used_ms is not None:
            values["used_ms"] = used_ms
        with self.database.write() as connection:
            query = jobs.update().where(*fence(lease)).values(**values)
            if connection.execute(query).rowcount != 1:
                raise LeaseLostError(f"attempt {lease.attempt} of {lease.job_id} lost its lease")

    def succeed(self, lease: Lease, result: Mapping[str, Any]) -> JobState:
        """Commit a finished image."""
        return self._end_attempt(lease, JobEvent.SUCCEED, result=result)

    def end_cancelled(self, lease: Lease, result: Mapping[str, Any] | None) -> JobState:
        """Commit the end that was asked for, with the partial image if there is one."""
        return self._end_attempt(lease, JobEvent.CANCEL, result=result)

    def fail(
        self, lease: Lease, error: Mapping[str, Any], result: Mapping[str, Any] | None = None
    ) -> JobState:
        """Commit that the job cannot be rendered, with what there is of it all the same."""
        return self._end_attempt(lease, JobEvent.FAIL, error=error, result=result)

    def lose(
        self, lease: Lease, error: Mapping[str, Any], *, own_fault: bool, delay_s: float = 0.0
    ) -> JobState:
        """Commit that an attempt was lost: back into the queue, or failed if that was too often.

        Parameters
        ----------
        error
            Why; kept as the job's error if it fails by this.
        own_fault
            The render process broke (counts against the attempts), not the service around it.
        delay_s
            Do not try again before; at most `MAX_DELAY_S`.
        """
        with self._change() as change:
            job = self._held_job(change.connection, lease)
            failures = job.failures + own_fault
            stalls = job.stalls + (not own_fault)
            values: dict[str, Any] = {"failures": failures, "stalls": stalls}
            if not own_fault:
                values["interruptions"] = job.interruptions + 1
            if failures >= job.max_attempts or stalls >= MAX_STALLS:
                return self._finish(change, job, JobEvent.FAIL, error=error, **values)
            values["not_before_ms"] = self.clock() + int(min(delay_s, MAX_DELAY_S) * 1000)
            return self._finish(change, job, JobEvent.LOSE, error=error, **values)

    def release(self, lease: Lease, *, delay_s: float = 0.0) -> JobState:
        """Give a job back unharmed: at an orderly shutdown, or to try a frame of it again later."""
        due_ms = self.clock() + int(min(delay_s, MAX_DELAY_S) * 1000)
        return self._end_attempt(lease, JobEvent.LOSE, not_before_ms=due_ms)

    def leases_of_others(self, owner: str) -> dict[Lease, int]:
        """The leases of other owners, each with its beat: a number that heartbeats change."""
        return self._leases(jobs.c.lease_owner != owner)

    def leases_of(self, owner: str) -> dict[Lease, int]:
        """The leases of one owner."""
        return self._leases(jobs.c.lease_owner == owner)

    def _leases(self, whose: sa.ColumnElement[bool]) -> dict[Lease, int]:
        query = sa.select(jobs).where(IS_RUNNING, whose)
        with self.database.read() as connection:
            rows = connection.execute(query).mappings().all()
        found = {job_of(row).lease: row["lease_expires_ms"] for row in rows}
        return {lease: int(beat) for lease, beat in found.items() if lease is not None}

    def void(self, lease: Lease, delay_s: float = 0.0) -> bool:
        """Take back the job of an owner that is gone; False if its lease is no more."""
        reason = {"reason": "interrupted", "detail": "the service went away during the render"}
        try:
            self.lose(lease, reason, own_fault=False, delay_s=delay_s)
        except LeaseLostError:
            return False
        return True

    def _end_attempt(self, lease: Lease, event: JobEvent, **values: Any) -> JobState:
        with self._change() as change:
            job = self._held_job(change.connection, lease)
            return self._finish(change, job, event, **values)

    def _finish(
        self, change: Change, job: Job, event: JobEvent, *, error: Any = None, **values: Any
    ) -> JobState:
        # A cancel that was accepted wins over every other end of the attempt.
        if job.cancel_requested:
            event = JobEvent.CANCEL
        if event is JobEvent.SUCCEED and unfinished_frames(change.connection, job.id):
            raise AssertionError(f"job {job.id} has frames that did not succeed")
        if event is JobEvent.FAIL:
            values["error"] = dump(dict(error))
        if values.get("result") is not None:
            values["result"] = dump(dict(values["result"]))
        return self._move(change, job, event, **values)


class LeaseWatch:
    """Finds leases of other services that nobody keeps alive any more.

    It asks for a beat within `lease_s` of this machine's steady clock, so neither a clock that
    jumps nor two that differ can take a job from a service that lives.
    """

    def __init__(
        self, store: LeaseStore, lease_s: float, steady_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._store = store
        self._lease_s = lease_s
        self._steady_s = steady_s
        self._seen: dict[Lease, tuple[int, float]] = {}

    def sweep(self, owner: str) -> list[str]:
        """Take back the jobs of silent owners; returns their ids."""
        now = self._steady_s()
        seen: dict[Lease, tuple[int, float]] = {}
        taken = []
        for lease, beat in self._store.leases_of_others(owner).items():
            last_beat, since = self._seen.get(lease, (None, now))
            if beat != last_beat:
                seen[lease] = (beat, now)
            elif now - since < self._lease_s:
                seen[lease] = (beat, since)
            elif self._store.void(lease):
                taken.append(lease.job_id)
        self._seen = seen
        return taken
