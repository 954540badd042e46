"""Between the rows of the tables and the values of `jobs.py`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import RowMapping

from raykiln_service.jobs import Job, JobSpec, JobState, Lease


@dataclass(frozen=True, slots=True)
class Asset:
    """An uploaded file.  `id` is "sha256:" and its hash in hex."""

    id: str
    size_bytes: int
    filename: str | None
    created_ms: int


@dataclass(frozen=True, slots=True)
class StateEvent:
    """A change of a job's state, with its place in the order of all changes."""

    seq: int
    job_id: str
    at_ms: int
    data: Mapping[str, Any]


def dump(value: Any) -> str:
    """`value` as compact JSON with sorted keys."""
    return json.dumps(value, separators=(",", ":"), sort_keys=True, ensure_ascii=False)


def job_of(row: RowMapping) -> Job:
    """The job in a row of the table `jobs`."""
    spec = JobSpec(
        scene=json.loads(row["scene"]),
        settings=json.loads(row["settings"]),
        outputs=tuple(json.loads(row["outputs"])),
        priority=row["priority"],
        labels=json.loads(row["labels"]),
        warnings=tuple(json.loads(row["warnings"])),
        frames=_load(row["frames"]),
        trace=row["trace"],
        **(_load(row["limits"]) or {}),
    )
    token = row["lease_token"]
    same = ("id", "seq", "created_ms", "updated_ms", "started_ms", "finished_ms", "attempts")
    counts = ("failures", "interruptions", "stalls", "max_attempts", "used_ms")
    return Job(
        spec=spec,
        state=JobState(row["state"]),
        cancel_requested=bool(row["cancel_requested"]),
        lease=None if token is None else Lease(row["id"], token, row["attempts"]),
        **{name: row[name] for name in (*same, *counts)},
        **{name: _load(row[name]) for name in ("progress", "error", "result")},
    )


def event_of(row: RowMapping) -> StateEvent:
    """The event in a row of the table `events`."""
    return StateEvent(row["seq"], row["job_id"], row["at_ms"], json.loads(row["data"]))


def asset_of(row: RowMapping) -> Asset:
    """The asset in a row of the table `assets`."""
    return Asset(row["id"], row["size_bytes"], row["filename"], row["created_ms"])


def _load(value: str | None) -> Any:
    return None if value is None else json.loads(value)
