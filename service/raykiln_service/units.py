"""The frames of jobs, as the store keeps them: each one counts exactly once.

A frame ends under the lease of its job's attempt, so an attempt that was lost changes nothing,
and a frame that succeeded is never touched again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import RowMapping

from raykiln_service.errors import NotFoundError
from raykiln_service.jobs import FrameState, Lease
from raykiln_service.planner import Frame
from raykiln_service.rows import dump
from raykiln_service.store_base import StoreBase, fence
from raykiln_service.tables import jobs
from raykiln_service.tables_frames import frames


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame of a job, as it was at one moment."""

    frame: Frame
    state: FrameState
    failures: int
    """Tries that broke, since submission or the last retry."""
    error: Mapping[str, Any] | None = None
    """Why it failed; of a queued frame, why its last try broke."""
    result: Mapping[str, Any] | None = None


class UnitStore(StoreBase):
    """Frames in the database."""

    def frames(
        self, job_id: str, *, states: Sequence[FrameState] = (), after: int = 0, limit: int = -1
    ) -> list[FrameRecord]:
        """Frames of a job with numbers above `after`, in order; `limit` -1 = all."""
        query = sa.select(frames).where(frames.c.job_id == job_id, frames.c.number > after)
        if states:
            query = query.where(frames.c.state.in_(list(states)))
        if limit >= 0:
            query = query.limit(limit)
        with self.database.read() as connection:
            rows = connection.execute(query.order_by(frames.c.number)).mappings()
            return [_record_of(row) for row in rows]

    def frame(self, job_id: str, number: int) -> FrameRecord:
        """One frame; `NotFoundError` if the job has none of that number."""
        found = self.frames(job_id, after=number - 1, limit=1)
        if not found or found[0].frame.number != number:
            raise NotFoundError(f"job {job_id} has no frame {number}")
        return found[0]

    def frame_counts(self, job_ids: Sequence[str]) -> dict[str, dict[FrameState, int]]:
        """How many frames of each job are in each state."""
        counts = {job_id: dict.fromkeys(FrameState, 0) for job_id in job_ids}
        if not counts:
            return counts
        query = (
            sa.select(frames.c.job_id, frames.c.state, sa.func.count())
            .where(frames.c.job_id.in_(list(counts)))
            .group_by(frames.c.job_id, frames.c.state)
        )
        with self.database.read() as connection:
            for job_id, state, count in connection.execute(query):
                counts[job_id][FrameState(state)] = count
        return counts

    def end_frame(
        self,
        lease: Lease,
        number: int,
        state: FrameState,
        *,
        result: Mapping[str, Any] | None = None,
        error: Mapping[str, Any] | None = None,
    ) -> None:
        """Commit how a try at a frame ended; `LeaseLostError` if the lease is lost.

        With an error the try counts as a failure; `queued` means that it is to be tried again.
        """
        values: dict[str, Any] = {
            "state": state,
            "updated_ms": self.clock(),
            "result": None if result is None else dump(dict(result)),
            "error": None if error is None else dump(dict(error)),
        }
        if error is not None:
            values["failures"] = frames.c.failures + 1
        is_open = frames.c.state != FrameState.SUCCEEDED
        with self.database.write() as connection:
            self._held_job(connection, lease)
            query = frames.update().where(
                frames.c.job_id == lease.job_id, frames.c.number == number, is_open
            )
            connection.execute(query.values(**values))
            # The job has come on: what interrupted it before does not count any more.
            connection.execute(jobs.update().where(*fence(lease)).values(stalls=0))


def add_frames(
    connection: sa.Connection, job_id: str, planned: Sequence[Frame], now_ms: int
) -> None:
    """Note the frames of a new job."""
    rows = [
        {
            "job_id": job_id,
            "number": frame.number,
            "spec": dump(
                {
                    "settings": dict(frame.settings),
                    "camera": frame.camera,
                    "time_s": frame.time_s,
                }
            ),
            "state": FrameState.QUEUED,
            "failures": 0,
            "updated_ms": now_ms,
        }
        for frame in planned
    ]
    if rows:
        connection.execute(frames.insert(), rows)


def reset_frames(connection: sa.Connection, job_id: str) -> None:
    """Queue the frames that did not succeed again, as the job is retried."""
    query = frames.update().where(frames.c.job_id == job_id, frames.c.state != FrameState.SUCCEEDED)
    fresh = {"state": FrameState.QUEUED, "failures": 0, "error": None, "result": None}
    connection.execute(query.values(**fresh))


def unfinished_frames(connection: sa.Connection, job_id: str) -> int:
    """How many frames of a job have not succeeded."""
    query = sa.select(sa.func.count()).where(
        frames.c.job_id == job_id, frames.c.state != FrameState.SUCCEEDED
    )
    return int(connection.execute(query).scalar_one())


def _record_of(row: RowMapping) -> FrameRecord:
    spec = json.loads(row["spec"])
    return FrameRecord(
        frame=Frame(row["number"], **spec),
        state=FrameState(row["state"]),
        failures=row["failures"],
        error=None if row["error"] is None else json.loads(row["error"]),
        result=None if row["result"] is None else json.loads(row["result"]),
    )
