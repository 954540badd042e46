"""The job store: the only truth about jobs, and the only place that changes their state.

Every change is one transaction that asks the table in `jobs.py`, updates the row only if state
and lease are still what they were (the fence), and adds an event with a durable number.  Listeners
hear of the event after the commit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from raykiln_service.access import LOCAL, Caller, Origin
from raykiln_service.errors import (
    ConflictError,
    GoneError,
    NotFoundError,
    QueueFullError,
)
from raykiln_service.idempotency import IDEMPOTENCY_MS, job_of_key, keep_key, prune_keys
from raykiln_service.jobs import Job, JobEvent, JobSpec, JobState
from raykiln_service.leases import LeaseStore
from raykiln_service.outbox import add_webhook
from raykiln_service.ownership import own_asset, owned_assets
from raykiln_service.quotas import admit_bytes, admit_job
from raykiln_service.rows import Asset, StateEvent, asset_of, dump, event_of, job_of
from raykiln_service.store_base import Change, now_ms
from raykiln_service.store_queue import NO_TRAITS, QueueStore, Traits
from raykiln_service.store_retention import RetentionStore
from raykiln_service.tables import IS_QUEUED, assets, events, job_labels, jobs
from raykiln_service.units import add_frames, reset_frames

__all__ = ["IDEMPOTENCY_MS", "Store", "now_ms"]


class Store(LeaseStore, QueueStore, RetentionStore):
    """Jobs, assets and events in a database.  All methods may be called from any thread."""

    # Assets

    def add_asset(
        self,
        asset_id: str,
        size_bytes: int,
        filename: str | None,
        caller: Caller = LOCAL,
        *,
        counted: bool = False,
    ) -> Asset:
        """Note an asset; the same id again changes at most its file name.

        Parameters
        ----------
        counted
            Its bytes are part of the caller's stored bytes already.

        Raises
        ------
        QuotaError
            It is new to the caller, whose uploads would come to too much.
        """
        insert = self._insert(assets).values(
            id=asset_id,
            size_bytes=size_bytes,
            filename=filename,
            created_ms=self.clock(),
            used_ms=self.clock(),
        )
        changed = {
            "filename": sa.func.coalesce(insert.excluded.filename, assets.c.filename),
            "used_ms": insert.excluded.used_ms,
        }
        with self.database.write() as connection:
            if not counted and not owned_assets(connection, caller, [asset_id]):
                admit_bytes(connection, caller, size_bytes)
            connection.execute(insert.on_conflict_do_update(index_elements=["id"], set_=changed))
            own_asset(connection, caller, asset_id, self.clock())
        return self.asset(asset_id)

    def asset(self, asset_id: str, caller: Caller = LOCAL) -> Asset:
        """One asset; `NotFoundError` if the caller has uploaded none of that id."""
        with self.database.read() as connection:
            query = sa.select(assets).where(assets.c.id == asset_id)
            row = connection.execute(query).mappings().one_or_none()
            if row is not None and not owned_assets(connection, caller, [asset_id]):
                row = None
        if row is None:
            raise NotFoundError(f"there is no asset {asset_id!r}")
        return asset_of(row)

    def check_room(self, caller: Caller, size_bytes: int, asset_id: str | None = None) -> None:
        """`QuotaError` if an upload of this size is too much for the caller."""
        with self.database.read() as connection:
            if asset_id is None or not owned_assets(connection, caller, [asset_id]):
                admit_bytes(connection, caller, size_bytes)

    def missing_assets(self, asset_ids: Sequence[str], caller: Caller = LOCAL) -> list[str]:
        """Those of the ids whose bytes the caller would have to upload, in their order."""
        with self.database.read() as connection:
            there = owned_assets(connection, caller, asset_ids)
        self.touch_assets(there)
        return [asset_id for asset_id in dict.fromkeys(asset_ids) if asset_id not in there]

    # Submission

    def create_job(
        self,
        job_id: str,
        spec: JobSpec,
        *,
        max_attempts: int = 3,
        max_queued: int = 1 << 30,
        key: str | None = None,
        digest: str = "",
        caller: Caller = LOCAL,
        pixel_samples: int = 0,
        traits: Traits = NO_TRAITS,
        answer: Mapping[str, Any] | None = None,
    ) -> tuple[Job, bool]:
        """Put a job into the queue.

        Parameters
        ----------
        max_queued
            `QueueFullError` if so many wait already.
        key, digest
            Idempotency key and hash of the request: the same key and digest return the job made
            then and False; another digest is an `IdempotencyMismatchError`.
        caller, pixel_samples
            Whose job it is, and what it counts for: `QuotaError` past the caller's limits.
        traits
            What its turn and the cache go by.
        answer
            The result, if it is there already: the job comes to be and succeeds in one step.
        """
        origin = Origin(caller, key, digest, pixel_samples)
        try:
            with self._change() as change:
                if known := self._replayed(change.connection, origin):
                    return known, False
                if answer is None:
                    self._admit(change.connection, origin, max_queued)
                self._insert_job(change, job_id, spec, origin, traits, max_attempts)
                if answer is not None:
                    self._answer(change, job_id, answer)
            return self.job(job_id), True
        except sa.exc.IntegrityError:
            # Another process took the key between the look and the insert.
            known = None if key is None else self.replayed(key, digest, caller)
            if known is None:
                raise
            return known, False

    def _admit(self, connection: sa.Connection, origin: Origin, max_queued: int) -> None:
        if self._count_queued(connection) >= max_queued:
            raise QueueFullError(
                f"{max_queued} jobs are waiting already", headers={"Retry-After": "30"}
            )
        admit_job(connection, origin.caller, origin.pixel_samples, self.clock())

    def _insert_job(
        self,
        change: Change,
        job_id: str,
        spec: JobSpec,
        origin: Origin,
        traits: Traits,
        max_attempts: int,
    ) -> None:
        now = self.clock()
        counts = ("attempts", "failures", "interruptions", "stalls", "cancel_requested")
        change.connection.execute(
            jobs.insert().values(
                id=job_id,
                owner=origin.caller.owner,
                pixel_samples=origin.pixel_samples,
                state=JobState.QUEUED,
                priority=spec.priority,
                scene=dump(dict(spec.scene)),
                settings=dump(dict(spec.settings)),
                outputs=dump(list(spec.outputs)),
                labels=dump(dict(spec.labels)),
                warnings=dump(list(spec.warnings)),
                frames=None if spec.frames is None else dump(dict(spec.frames)),
                trace=spec.trace,
                limits=dump(spec.limits) if spec.limits else None,
                asset_id=spec.scene.get("asset"),
                created_ms=now,
                updated_ms=now,
                not_before_ms=0,
                max_attempts=max_attempts,
                limit_ms=traits.limit_ms,
                scene_key=traits.scene_key,
                cache_key=traits.cache_key,
                use_cache=int(traits.use_cache),
                **dict.fromkeys(counts, 0),
                **self._place(change.connection, spec.priority),
            )
        )
        self._add_details(change.connection, job_id, spec, origin)
        self._note(change, job_id, JobState.QUEUED, 0, None)

    def _answer(self, change: Change, job_id: str, answer: Mapping[str, Any]) -> None:
        job = self._job(change.connection, job_id)
        done = {"result": dump(dict(answer)), "started_ms": job.created_ms}
        self._move(change, job, JobEvent.ANSWER, **done)

    def _add_details(
        self, connection: sa.Connection, job_id: str, spec: JobSpec, origin: Origin
    ) -> None:
        add_frames(connection, job_id, spec.planned, self.clock())
        if spec.webhook is not None:
            add_webhook(connection, job_id, spec.webhook)
        if spec.labels:
            rows = [{"job_id": job_id, "key": k, "value": v} for k, v in spec.labels.items()]
            connection.execute(job_labels.insert(), rows)
        if origin.key is not None:
            now = self.clock()
            prune_keys(connection, now)
            owner = origin.caller.owner
            keep_key(connection, owner, origin.key, origin.digest, job_id, now)

    def replayed(self, key: str, digest: str, caller: Caller = LOCAL) -> Job | None:
        """The job made by an earlier request with this idempotency key, if there is one.

        Raises
        ------
        IdempotencyMismatchError
            That request was another one.
        GoneError
            The job has been deleted since.
        """
        with self.database.read() as connection:
            return self._replayed(connection, Origin(caller, key, digest))

    def _replayed(self, connection: sa.Connection, origin: Origin) -> Job | None:
        if origin.key is None:
            return None
        owner, now = origin.caller.owner, self.clock()
        job_id = job_of_key(connection, owner, origin.key, origin.digest, now)
        if job_id is None:
            return None
        try:
            return self._job(connection, job_id)
        except NotFoundError:
            raise GoneError(f"job {job_id}, which this request made, has been deleted") from None

    def prune_keys(self) -> int:
        """Forget the idempotency keys of more than a day ago; how many there were."""
        with self.database.write() as connection:
            return prune_keys(connection, self.clock())

    def owner_of(self, job_id: str) -> str | None:
        """The token that submitted a job; `NotFoundError` if there is no such job."""
        with self.database.read() as connection:
            query = sa.select(jobs.c.owner).where(jobs.c.id == job_id)
            row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFoundError(f"there is no job {job_id!r}")
        return None if row.owner is None else str(row.owner)

    # Looking

    def list_jobs(
        self,
        *,
        states: Sequence[JobState] = (),
        labels: Mapping[str, str | None] | None = None,
        limit: int = 50,
        before_seq: int | None = None,
        owner: str | None = None,
    ) -> list[Job]:
        """Jobs, newest first, of one owner or of all; a label's value None means any value."""
        query = sa.select(jobs).order_by(jobs.c.seq.desc()).limit(limit)
        if owner is not None:
            query = query.where(jobs.c.owner == owner)
        if before_seq is not None:
            query = query.where(jobs.c.seq < before_seq)
        for key, value in (labels or {}).items():
            owners = sa.select(job_labels.c.job_id).where(job_labels.c.key == key)
            if value is not None:
                owners = owners.where(job_labels.c.value == value)
            query = query.where(jobs.c.id.in_(owners))
        # The jobs of one state are in order in an index, those of several are not.
        wanted = states or (JobState if owner is not None else ())
        parts = [query.where(jobs.c.state == state) for state in dict.fromkeys(wanted)]
        if len(parts) == 1:
            query = parts[0]
        elif parts:
            merged = sa.union_all(*(sa.select(part.subquery()) for part in parts)).subquery()
            query = sa.select(merged).order_by(merged.c.seq.desc()).limit(limit)
        with self.database.read() as connection:
            return [job_of(row) for row in connection.execute(query).mappings()]

    def queue_positions(self, found: Sequence[Job]) -> dict[str, int]:
        """How many jobs go before each of the queued ones among `found`, by id."""
        queued = [job for job in found if job.state is JobState.QUEUED]
        if not queued:
            return {}
        if len(queued) == 1:
            return {queued[0].id: self._count_before(queued[0])}
        wanted = [job.id for job in queued]
        place = sa.func.row_number().over(order_by=(jobs.c.rank_ms, jobs.c.seq))
        queue = sa.select(jobs.c.id, (place - 1).label("place")).where(IS_QUEUED).subquery()
        query = sa.select(queue.c.id, queue.c.place).where(queue.c.id.in_(wanted))
        with self.database.read() as connection:
            return {job_id: int(number) for job_id, number in connection.execute(query)}

    def _count_before(self, job: Job) -> int:
        # Cheaper than numbering the whole queue.
        rank = sa.select(jobs.c.rank_ms).where(jobs.c.id == job.id).scalar_subquery()
        before = sa.or_(
            jobs.c.rank_ms < rank, sa.and_(jobs.c.rank_ms == rank, jobs.c.seq < job.seq)
        )
        query = sa.select(sa.func.count()).where(IS_QUEUED, before)
        with self.database.read() as connection:
            return int(connection.execute(query).scalar_one())

    def count_by_state(self) -> dict[JobState, int]:
        """How many jobs are in each state."""
        query = sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)
        with self.database.read() as connection:
            found = {JobState(state): count for state, count in connection.execute(query)}
        return {state: found.get(state, 0) for state in JobState}

    def events_after(self, job_id: str, seq: int) -> list[StateEvent]:
        """The changes of a job's state after number `seq`, in order."""
        query = sa.select(events).where(events.c.job_id == job_id, events.c.seq > seq)
        with self.database.read() as connection:
            rows = connection.execute(query.order_by(events.c.seq)).mappings()
            return [event_of(row) for row in rows]

    def job_ids(self) -> set[str]:
        """The ids of all jobs."""
        with self.database.read() as connection:
            return set(connection.execute(sa.select(jobs.c.id)).scalars())

    # What users may do to a job

    def cancel(self, job_id: str) -> Job:
        """End a queued job now, or ask for the end of a running one; a cancelled one stays so."""
        with self._change() as change:
            job = self._locked_job(change.connection, job_id)
            if job.state is JobState.CANCELLED:
                return job
            self._allowed(job, JobEvent.CANCEL)
            if job.state is JobState.RUNNING:
                values = {"cancel_requested": 1, "updated_ms": self.clock()}
                change.connection.execute(jobs.update().where(jobs.c.id == job_id).values(**values))
            else:
                self._move(change, job, JobEvent.CANCEL)
        return self.job(job_id)

    def retry(self, job_id: str) -> Job:
        """Put a failed or cancelled job back into the queue, with a fresh budget of attempts."""
        with self._change() as change:
            job = self._locked_job(change.connection, job_id)
            self._allowed(job, JobEvent.RETRY)
            reset_frames(change.connection, job_id)
            fresh = {"failures": 0, "stalls": 0, "cancel_requested": 0, "not_before_ms": 0}
            fresh["used_ms"] = 0
            fresh |= self._place(change.connection, job.spec.priority)
            self._move(change, job, JobEvent.RETRY, error=None, result=None, **fresh)
        return self.job(job_id)

    def delete(self, job_id: str) -> None:
        """Forget an ended job."""
        with self.database.write() as connection:
            job = self._locked_job(connection, job_id)
            if not job.state.is_final:
                raise ConflictError(f"job {job_id} is {job.state}; cancel it first")
            connection.execute(jobs.delete().where(jobs.c.id == job_id))

    # Inside

    @staticmethod
    def _count_queued(connection: sa.Connection) -> int:
        query = sa.select(sa.func.count()).where(IS_QUEUED)
        return int(connection.execute(query).scalar_one())

    def _insert(self, table: sa.Table) -> Any:
        return sqlite.insert(table) if self.database.is_sqlite else postgresql.insert(table)
