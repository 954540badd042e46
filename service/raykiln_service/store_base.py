"""How the job store changes things: one fenced transaction, one event, then the listeners."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from raykiln_service.database import Database
from raykiln_service.errors import ConflictError, LeaseLostError, NotFoundError
from raykiln_service.jobs import (
    IllegalTransitionError,
    Job,
    JobEvent,
    JobState,
    Lease,
    next_state,
)
from raykiln_service.outbox import announce
from raykiln_service.rows import StateEvent, dump, job_of
from raykiln_service.tables import IS_RUNNING, events, jobs

Listener = Callable[[StateEvent], None]
PRIORITY_STEP_S = 600.0


def now_ms() -> int:
    """The wall clock in Unix milliseconds."""
    return time.time_ns() // 1_000_000


@dataclass
class Change:
    """A transaction in progress and the events to tell of once it is committed."""

    connection: sa.Connection
    events: list[StateEvent] = field(default_factory=list)


class StoreBase:
    """A database, a clock, listeners, and the one statement that changes a job's state.

    Parameters
    ----------
    priority_step_s
        How much waiting a level of priority is worth.
    """

    def __init__(
        self,
        database: Database,
        *,
        clock: Callable[[], int] = now_ms,
        priority_step_s: float = PRIORITY_STEP_S,
    ) -> None:
        self.database = database
        self.clock = clock
        self.priority_step_ms = round(priority_step_s * 1000)
        self.version = 0
        """Grows with every change of a job's state or of the queue made here."""
        self._listeners: list[Listener] = []
        self._queue_listeners: list[Callable[[], None]] = []

    def listen(self, listener: Listener) -> None:
        """Call `listener` after each committed change of a state, in the thread that made it."""
        self._listeners.append(listener)

    def listen_to_queue(self, listener: Callable[[], None]) -> None:
        """Call `listener` after the queue was paused or resumed here."""
        self._queue_listeners.append(listener)

    def queue_changed(self) -> None:
        """The queue was paused, resumed or put into another order."""
        self.version += 1
        for listener in self._queue_listeners:
            listener()

    def job(self, job_id: str) -> Job:
        """One job; `NotFoundError` if there is none of that id."""
        with self.database.read() as connection:
            return self._job(connection, job_id)

    @contextmanager
    def _change(self) -> Iterator[Change]:
        with self.database.write() as connection:
            change = Change(connection)
            yield change
        self.version += len(change.events)
        for event in change.events:
            for listener in self._listeners:
                listener(event)

    def _move(self, change: Change, job: Job, event: JobEvent, **values: Any) -> JobState:
        """The one statement that changes a state, fenced by the state and lease it was in."""
        now = self.clock()
        state = next_state(job.state, event)
        values |= {"state": state, "updated_ms": now}
        values["finished_ms"] = now if state.is_final else None
        if state is not JobState.RUNNING:
            values |= {"lease_owner": None, "lease_token": None, "lease_expires_ms": None}
        token = None if job.lease is None else job.lease.token
        query = jobs.update().where(
            jobs.c.id == job.id,
            jobs.c.state == job.state,
            jobs.c.lease_token.is_(None) if token is None else jobs.c.lease_token == token,
        )
        if change.connection.execute(query.values(**values)).rowcount != 1:
            raise LeaseLostError(f"job {job.id} changed at the same time")
        attempts = values.get("attempts", job.attempts)
        self._note(change, job.id, state, attempts, values.get("error"))
        return state

    def _note(
        self, change: Change, job_id: str, state: JobState, attempts: int, error: str | None
    ) -> None:
        now = self.clock()
        data: dict[str, Any] = {"id": job_id, "state": state, "attempts": attempts, "at_ms": now}
        if error is not None:
            data["has_error"] = True
        query = events.insert().values(job_id=job_id, at_ms=now, data=dump(data))
        key = change.connection.execute(query).inserted_primary_key
        assert key is not None
        announce(change.connection, job_id, state, now)
        change.events.append(StateEvent(key[0], job_id, now, data))

    def _held_job(self, connection: sa.Connection, lease: Lease) -> Job:
        query = sa.select(jobs).where(*fence(lease)).with_for_update()
        row = connection.execute(query).mappings().one_or_none()
        if row is None:
            raise LeaseLostError(f"attempt {lease.attempt} of {lease.job_id} lost its lease")
        return job_of(row)

    def _job(self, connection: sa.Connection, job_id: str) -> Job:
        query = sa.select(jobs).where(jobs.c.id == job_id)
        return self._one(connection, query, job_id)

    def _locked_job(self, connection: sa.Connection, job_id: str) -> Job:
        query = sa.select(jobs).where(jobs.c.id == job_id).with_for_update()
        return self._one(connection, query, job_id)

    @staticmethod
    def _one(connection: sa.Connection, query: sa.Select[Any], job_id: str) -> Job:
        row = connection.execute(query).mappings().one_or_none()
        if row is None:
            raise NotFoundError(f"there is no job {job_id!r}")
        return job_of(row)

    @staticmethod
    def _allowed(job: Job, event: JobEvent) -> None:
        try:
            next_state(job.state, event)
        except IllegalTransitionError as error:
            raise ConflictError(f"job {job.id}: {error}") from None


def fence(lease: Lease) -> tuple[sa.ColumnElement[bool], ...]:
    """What must still hold for a commit under this lease."""
    return (
        jobs.c.id == lease.job_id,
        IS_RUNNING,
        jobs.c.lease_token == lease.token,
        jobs.c.attempts == lease.attempt,
    )
