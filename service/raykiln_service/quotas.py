"""What a token may use: jobs, samples and bytes are counted in the database, requests here."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from typing import Any, NoReturn

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from raykiln_service.access import Caller
from raykiln_service.errors import QuotaError
from raykiln_service.tables import assets, jobs
from raykiln_service.tables_access import asset_owners, tokens, uploads, usage

_HOUR_MS = 3_600_000
_RETRY_S = {"queued_jobs": 30, "queued_samples": 60, "stored_bytes": 3600}


def admit_job(connection: sa.Connection, caller: Caller, samples: int, now_ms: int) -> None:
    """Count a job that is about to be queued in the same transaction; `QuotaError` if too much.

    Parameters
    ----------
    samples
        Pixel samples that it takes at most.
    """
    if caller.owner is None:
        return
    _serialize(connection, caller.owner)
    limits = caller.limits
    if limits.queued_jobs is not None or limits.queued_samples is not None:
        open_jobs, open_samples = _open_work(connection, caller.owner)
        if limits.queued_jobs is not None and open_jobs >= limits.queued_jobs:
            _refuse("queued_jobs", "jobs that wait or run", open_jobs, limits.queued_jobs)
        if limits.queued_samples is not None and open_samples + samples > limits.queued_samples:
            _refuse(
                "queued_samples",
                "pixel samples of jobs that wait or run",
                open_samples + samples,
                limits.queued_samples,
            )
    _use_samples(connection, caller, samples, now_ms)


def admit_bytes(connection: sa.Connection, caller: Caller, size_bytes: int) -> None:
    """`QuotaError` if the caller's uploads would come to more than its limit with these."""
    limit = caller.limits.stored_bytes
    if caller.owner is None or limit is None:
        return
    _serialize(connection, caller.owner)
    total = stored_bytes(connection, caller.owner) + size_bytes
    if total > limit:
        _refuse("stored_bytes", "bytes of uploads", total, limit)


def stored_bytes(connection: sa.Connection, owner: str) -> int:
    """The sizes of what a token has uploaded, and is uploading."""
    kept = (
        sa.select(sa.func.coalesce(sa.func.sum(assets.c.size_bytes), 0))
        .join(asset_owners, asset_owners.c.asset_id == assets.c.id)
        .where(asset_owners.c.owner == owner)
    )
    coming = sa.select(sa.func.coalesce(sa.func.sum(uploads.c.length), 0)).where(
        uploads.c.owner == owner, uploads.c.asset_id.is_(None)
    )
    return int(connection.execute(kept).scalar_one()) + int(connection.execute(coming).scalar_one())


def _open_work(connection: sa.Connection, owner: str) -> tuple[int, int]:
    query = sa.select(
        sa.func.count(), sa.func.coalesce(sa.func.sum(jobs.c.pixel_samples), 0)
    ).where(jobs.c.owner == owner, jobs.c.state.in_(["queued", "running"]))
    count, samples = connection.execute(query).one()
    return int(count), int(samples)


def _use_samples(connection: sa.Connection, caller: Caller, samples: int, now_ms: int) -> None:
    hour = now_ms // _HOUR_MS
    day = sa.and_(usage.c.owner == caller.owner, usage.c.hour > hour - 24)
    limit = caller.limits.samples_per_day
    if limit is not None:
        rows = connection.execute(sa.select(usage.c.hour, usage.c.samples).where(day)).all()
        used = sum(int(row.samples) for row in rows)
        if used + samples > limit:
            first = min((row.hour for row in rows), default=hour)
            _refuse(
                "samples_per_day",
                "pixel samples in 24 hours",
                used + samples,
                limit,
                ((first + 24) * _HOUR_MS - now_ms) // 1000,
            )
    connection.execute(
        usage.delete().where(usage.c.owner == caller.owner, usage.c.hour <= hour - 24)
    )
    insert: Any = postgresql.insert if connection.dialect.name == "postgresql" else sqlite.insert
    row = insert(usage).values(owner=caller.owner, hour=hour, samples=samples)
    connection.execute(
        row.on_conflict_do_update(
            index_elements=["owner", "hour"],
            set_={"samples": usage.c.samples + row.excluded.samples},
        )
    )


def _serialize(connection: sa.Connection, owner: str) -> None:
    # Two processes on one PostgreSQL must not both take the last place.
    connection.execute(sa.select(tokens.c.id).where(tokens.c.id == owner).with_for_update())


def _refuse(
    name: str, what: str, found: int, limit: int, retry_after_s: int | None = None
) -> NoReturn:
    wait_s = _RETRY_S.get(name, 60) if retry_after_s is None else max(1, retry_after_s)
    raise QuotaError(
        f"this token's limit {name} is reached",
        limit=name,
        found=f"{found} {what}",
        accepted=f"at most {limit}",
        headers={"Retry-After": str(wait_s)},
    )


class RateLimiter:
    """Requests per minute, by caller: a bucket that refills evenly.  For any thread."""

    _KEPT = 10_000

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def check(self, caller: Caller, now_s: float | None = None) -> None:
        """Count a request; `QuotaError` says when the next one may come.

        A quiet caller may send a tenth of its minute's requests at once.
        """
        limit = caller.limits.requests_per_minute
        if caller.owner is None or limit is None:
            return
        now = time.monotonic() if now_s is None else now_s
        burst, per_s = max(1.0, limit / 10), limit / 60
        with self._lock:
            left, since = self._buckets.get(caller.owner, (burst, now))
            left = min(burst, left + (now - since) * per_s)
            allowed = left >= 1
            self._buckets[caller.owner] = (left - 1 if allowed else left, now)
            self._buckets.move_to_end(caller.owner)
            while len(self._buckets) > self._KEPT:
                self._buckets.popitem(last=False)
        if not allowed:
            wait_s = math.ceil((1 - left) / per_s)
            _refuse("requests_per_minute", "requests came too fast", limit, limit, wait_s)
