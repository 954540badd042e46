"""The outbox: what webhooks are to hear, written in the transaction that makes it true.

A delivery that is being sent is *claimed*: its next time lies `CLAIM_MS` ahead.  So one that was
being sent when the service was killed is sent again, with the same id, and receivers can tell.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from raykiln_service.database import Database
from raykiln_service.errors import NotFoundError
from raykiln_service.jobs import FINAL_STATES, JobState, Webhook
from raykiln_service.rows import dump
from raykiln_service.tables import jobs
from raykiln_service.tables_webhooks import deliveries, webhooks

CLAIM_MS = 30_000
_SHOWN = 100
_IS_PENDING = deliveries.c.state == sa.literal_column("'pending'")


@dataclass(frozen=True, slots=True)
class Delivery:
    """One message to one receiver, as it was at one moment.  Times are Unix milliseconds."""

    id: str
    job_id: str
    event: str
    host: str
    state: str
    """pending, delivered or failed."""
    attempts: int
    """Begun; counts the one under way."""
    created_ms: int
    next_ms: int | None
    last_ms: int | None
    status: int | None
    """HTTP status of the last answer."""
    error: str | None
    """Why the last attempt did not deliver it."""
    body: str


@dataclass(frozen=True, slots=True)
class Hook:
    """A job's webhook, as it is stored."""

    url: str
    events: tuple[str, ...]
    disabled_ms: int | None
    has_secret: bool


def add_webhook(connection: sa.Connection, job_id: str, webhook: Webhook) -> None:
    """Note who is to hear of a new job."""
    query = webhooks.insert().values(
        job_id=job_id,
        url=webhook.url,
        host=webhook.host,
        events=dump(list(webhook.events)),
        secret=webhook.secret,
    )
    connection.execute(query)


def announce(connection: sa.Connection, job_id: str, state: JobState, now_ms: int) -> None:
    """Put the news of a job's end into the outbox, if its webhook wants to hear of it."""
    if state not in FINAL_STATES:
        return
    query = sa.select(webhooks).where(webhooks.c.job_id == job_id)
    hook = connection.execute(query).one_or_none()
    if hook is None or hook.disabled_ms is not None or state not in json.loads(hook.events):
        return
    connection.execute(
        deliveries.insert().values(
            id=f"msg_{secrets.token_hex(16)}",
            job_id=job_id,
            host=hook.host,
            event=f"job.{state}",
            body=_body(connection, job_id, state, now_ms),
            state="pending",
            attempts=0,
            created_ms=now_ms,
            next_ms=now_ms,
        )
    )


def _body(connection: sa.Connection, job_id: str, state: JobState, now_ms: int) -> str:
    columns = (jobs.c.attempts, jobs.c.created_ms, jobs.c.labels, jobs.c.error, jobs.c.result)
    row = connection.execute(sa.select(*columns).where(jobs.c.id == job_id)).one()
    error = None if row.error is None else json.loads(row.error)
    result = {} if row.result is None else json.loads(row.result)
    data: dict[str, Any] = {
        "id": job_id,
        "state": state,
        "attempts": row.attempts,
        "created_at": _time(row.created_ms),
        "finished_at": _time(now_ms),
        "labels": json.loads(row.labels),
        "cached": result.get("cached_from") is not None,
        "complete": result.get("complete"),
        "error": error and {"reason": error.get("reason"), "detail": error.get("detail")},
        "href": f"/v1/jobs/{job_id}",
    }
    return dump({"type": f"job.{state}", "timestamp": _time(now_ms), "data": data})


def _time(unix_ms: int) -> str:
    text = datetime.fromtimestamp(unix_ms / 1000, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


class Outbox:
    """The messages that wait, as their sender and their readers see them.

    Parameters
    ----------
    horizon_ms
        No message waits longer than this: one that seems to was noted by a clock that was ahead.
    """

    def __init__(self, database: Database, clock: Callable[[], int], horizon_ms: int) -> None:
        self._database = database
        self._clock = clock
        self._horizon_ms = horizon_ms

    def claim(self, limit: int, full_hosts: Collection[str], per_host: int) -> list[Delivery]:
        """Take messages that are due, at most `per_host` for each host and none for full ones."""
        now = self._clock()
        place = sa.func.row_number().over(
            partition_by=deliveries.c.host, order_by=(deliveries.c.next_ms, deliveries.c.seq)
        )
        due = (
            sa.select(deliveries.c.seq, deliveries.c.next_ms, place.label("place"))
            .where(_IS_PENDING, self._is_due(now), deliveries.c.host.not_in(list(full_hosts)))
            .subquery()
        )
        found = sa.select(due.c.seq, due.c.next_ms).where(due.c.place <= per_host)
        with self._database.read() as connection:
            rows = connection.execute(found.order_by(due.c.next_ms, due.c.seq).limit(limit)).all()
        return self._take([(row.seq, row.next_ms) for row in rows], now) if rows else []

    def _take(self, rows: list[tuple[int, int]], now: int) -> list[Delivery]:
        taken = []
        with self._database.write() as connection:
            for seq, next_ms in rows:
                # Another service may have been quicker.
                query = deliveries.update().where(
                    deliveries.c.seq == seq, _IS_PENDING, deliveries.c.next_ms == next_ms
                )
                values = {"next_ms": now + CLAIM_MS, "attempts": deliveries.c.attempts + 1}
                if connection.execute(query.values(**values)).rowcount == 1:
                    taken.append(seq)
            query_taken = sa.select(deliveries).where(deliveries.c.seq.in_(taken))
            found = connection.execute(query_taken.order_by(deliveries.c.seq)).mappings().all()
        return [_delivery_of(row) for row in found]

    def _is_due(self, now: int) -> sa.ColumnElement[bool]:
        return sa.or_(deliveries.c.next_ms <= now, deliveries.c.next_ms > now + self._horizon_ms)

    def next_due_s(self) -> float | None:
        """Seconds until the next message is due; None if none waits."""
        query = sa.select(sa.func.min(deliveries.c.next_ms)).where(_IS_PENDING)
        with self._database.read() as connection:
            next_ms = connection.execute(query).scalar_one()
        return None if next_ms is None else max(0, next_ms - self._clock()) / 1000

    def waiting(self) -> int:
        """How many messages wait."""
        query = sa.select(sa.func.count()).select_from(deliveries).where(_IS_PENDING)
        with self._database.read() as connection:
            return int(connection.execute(query).scalar_one())

    def target_of(self, job_id: str) -> tuple[str, str | None]:
        """URL and secret of a job's webhook."""
        query = sa.select(webhooks.c.url, webhooks.c.secret).where(webhooks.c.job_id == job_id)
        with self._database.read() as connection:
            row = connection.execute(query).one()
        return row.url, row.secret

    def delivered(self, delivery: Delivery, status: int) -> None:
        """Note that a message has arrived."""
        self._settle(delivery, state="delivered", next_ms=None, status=status, error=None)

    def postpone(
        self, delivery: Delivery, delay_s: float | None, status: int | None, error: str
    ) -> None:
        """Note that a message did not arrive; None = it is given up."""
        failed = {"state": "failed", "next_ms": None}
        again = {"next_ms": self._clock() + round((delay_s or 0) * 1000)}
        values = failed if delay_s is None else again
        self._settle(delivery, **values, status=status, error=error)

    def redeliver(self, job_id: str, delivery_id: str) -> None:
        """Send a message again, at once and with all its attempts; `NotFoundError` without it.

        A webhook that asked for no more is told again from now on.
        """
        fresh = {"state": "pending", "next_ms": self._clock(), "attempts": 0, "error": None}
        wanted = (deliveries.c.id == delivery_id, deliveries.c.job_id == job_id)
        with self._database.write() as connection:
            query = deliveries.update().where(*wanted).values(**fresh, status=None)
            if connection.execute(query).rowcount == 0:
                raise NotFoundError(f"job {job_id} has no delivery {delivery_id!r}")
            hook = webhooks.update().where(webhooks.c.job_id == job_id)
            connection.execute(hook.values(disabled_ms=None))

    def disable(self, delivery: Delivery, status: int) -> None:
        """The receiver is gone for good: send it nothing more about this job."""
        now = self._clock()
        self._settle(delivery, state="failed", next_ms=None, status=status, error="gone")
        of_job = deliveries.c.job_id == delivery.job_id
        rest = {"state": "failed", "next_ms": None, "error": "the webhook is disabled"}
        with self._database.write() as connection:
            hook = webhooks.update().where(webhooks.c.job_id == delivery.job_id)
            connection.execute(hook.values(disabled_ms=now))
            connection.execute(deliveries.update().where(of_job, _IS_PENDING).values(**rest))

    def _settle(self, delivery: Delivery, **values: Any) -> None:
        query = deliveries.update().where(deliveries.c.id == delivery.id, _IS_PENDING)
        with self._database.write() as connection:
            connection.execute(query.values(last_ms=self._clock(), **values))

    def of_job(self, job_id: str) -> tuple[Hook | None, list[Delivery]]:
        """The webhook of a job, and its last messages, newest first."""
        hook_query = sa.select(webhooks).where(webhooks.c.job_id == job_id)
        query = sa.select(deliveries).where(deliveries.c.job_id == job_id)
        query = query.order_by(deliveries.c.seq.desc()).limit(_SHOWN)
        with self._database.read() as connection:
            row = connection.execute(hook_query).one_or_none()
            rows = connection.execute(query).mappings().all()
        if row is None:
            return None, []
        hook = Hook(row.url, tuple(json.loads(row.events)), row.disabled_ms, row.secret is not None)
        return hook, [_delivery_of(found) for found in rows]

    def prune(self) -> int:
        """Forget the webhooks of deleted jobs that have nothing more to hear; how many."""
        waits = sa.exists().where(deliveries.c.job_id == webhooks.c.job_id, _IS_PENDING)
        is_job = sa.exists().where(jobs.c.id == webhooks.c.job_id)
        with self._database.read() as connection:
            query = sa.select(webhooks.c.job_id).where(~is_job, ~waits).limit(500)
            gone = connection.execute(query).scalars().all()
        if gone:
            with self._database.write() as connection:
                connection.execute(webhooks.delete().where(webhooks.c.job_id.in_(gone)))
        return len(gone)


def _delivery_of(row: sa.RowMapping) -> Delivery:
    names = Delivery.__dataclass_fields__
    return Delivery(**{name: row[name] for name in names})
