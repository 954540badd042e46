"""Idempotency keys: which request made which job, for a day.

The functions run in the transaction that makes the job.  A key belongs to its token: two tokens
may use the same key.
"""

from __future__ import annotations

import sqlalchemy as sa

from raykiln_service.errors import IdempotencyMismatchError
from raykiln_service.tables_access import idempotency

IDEMPOTENCY_MS = 24 * 3600 * 1000


def job_of_key(
    connection: sa.Connection, owner: str | None, key: str, digest: str, now_ms: int
) -> str | None:
    """The id of the job that the same request made; `IdempotencyMismatchError` for another one."""
    query = sa.select(idempotency.c.digest, idempotency.c.job_id).where(
        idempotency.c.owner == (owner or ""),
        idempotency.c.key == key,
        idempotency.c.created_ms >= now_ms - IDEMPOTENCY_MS,
    )
    row = connection.execute(query).one_or_none()
    if row is None:
        return None
    if row.digest != digest:
        raise IdempotencyMismatchError(
            f"Idempotency-Key {key!r} came with another request before; use a new key"
        )
    return str(row.job_id)


def keep_key(
    connection: sa.Connection, owner: str | None, key: str, digest: str, job_id: str, now_ms: int
) -> None:
    """Remember the request that makes a job."""
    row = {"owner": owner or "", "key": key, "digest": digest, "job_id": job_id}
    connection.execute(idempotency.insert().values(**row, created_ms=now_ms))


def prune_keys(connection: sa.Connection, now_ms: int) -> int:
    """Forget the keys of more than a day ago; how many there were."""
    old = idempotency.c.created_ms < now_ms - IDEMPOTENCY_MS
    return connection.execute(idempotency.delete().where(old)).rowcount
