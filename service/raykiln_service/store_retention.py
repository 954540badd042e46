"""What may be removed from the store, and removing it: nothing that anybody still refers to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import sqlalchemy as sa

from raykiln_service.jobs import FINAL_STATES
from raykiln_service.store_base import StoreBase
from raykiln_service.tables import assets, jobs

# Whoever was told that an upload is there has this long to submit its job.
ASSET_GRACE_MS = 15 * 60_000
_TOUCH_MS = 60_000
_BATCH = 500


@dataclass(frozen=True, slots=True)
class EndedJob:
    """A job that has ended, and when.  The time is in Unix milliseconds."""

    id: str
    finished_ms: int


@dataclass(frozen=True, slots=True)
class IdleAsset:
    """An upload that no job refers to, and when it was last uploaded, asked for or used."""

    id: str
    size_bytes: int
    used_ms: int


class RetentionStore(StoreBase):
    """The store as clean-ups see it."""

    def ended_jobs(self) -> list[EndedJob]:
        """All jobs that have ended, the one that ended first at the head."""
        query = sa.select(jobs.c.id, jobs.c.finished_ms).where(jobs.c.finished_ms.is_not(None))
        with self.database.read() as connection:
            rows = connection.execute(query.order_by(jobs.c.finished_ms, jobs.c.seq)).all()
        return [EndedJob(*row) for row in rows]

    def delete_ended(self, job: EndedJob) -> bool:
        """Forget a job if it is still the end that was seen; a retried one stays."""
        query = jobs.delete().where(
            jobs.c.id == job.id,
            jobs.c.state.in_(list(FINAL_STATES)),
            jobs.c.finished_ms == job.finished_ms,
        )
        with self.database.write() as connection:
            gone = connection.execute(query).rowcount == 1
        self.version += 1
        return gone

    def idle_assets(self) -> list[IdleAsset]:
        """The uploads that no job refers to, past their grace, least recently used first."""
        is_used = sa.exists().where(jobs.c.asset_id == assets.c.id)
        query = sa.select(assets.c.id, assets.c.size_bytes, assets.c.used_ms)
        query = query.where(~is_used, assets.c.used_ms < self.clock() - ASSET_GRACE_MS)
        with self.database.read() as connection:
            rows = connection.execute(query.order_by(assets.c.used_ms, assets.c.id)).all()
        return [IdleAsset(*row) for row in rows]

    def asset_bytes(self) -> int:
        """The size of all uploads."""
        with self.database.read() as connection:
            total = connection.execute(sa.select(sa.func.sum(assets.c.size_bytes))).scalar_one()
        return int(total or 0)

    def known_assets(self) -> set[str]:
        """The ids of all uploads."""
        with self.database.read() as connection:
            return set(connection.execute(sa.select(assets.c.id)).scalars())

    def delete_idle(self, asset: IdleAsset) -> bool:
        """Forget an upload if nobody has used it since; False if somebody has."""
        is_used = sa.exists().where(jobs.c.asset_id == asset.id)
        query = assets.delete().where(
            assets.c.id == asset.id, assets.c.used_ms == asset.used_ms, ~is_used
        )
        with self.database.write() as connection:
            return connection.execute(query).rowcount == 1

    def touch_assets(self, asset_ids: Iterable[str]) -> None:
        """Note that these uploads are about to be used."""
        now, wanted = self.clock(), list(asset_ids)
        # Seldom anything: a note of the last minute will do.
        is_old = sa.or_(assets.c.used_ms < now - _TOUCH_MS, assets.c.used_ms > now)
        for start in range(0, len(wanted), _BATCH):
            some = assets.c.id.in_(wanted[start : start + _BATCH])
            with self.database.read() as connection:
                old = connection.execute(sa.select(assets.c.id).where(some, is_old)).scalars().all()
            if old:
                with self.database.write() as connection:
                    query = assets.update().where(assets.c.id.in_(old))
                    connection.execute(query.values(used_ms=now))
