"""The table of the frames of jobs that render several pictures."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Column, ForeignKey, Index, Integer, Table, Text

from raykiln_service.tables import STRICT, BigInt, metadata

frames = Table(
    "frames",
    metadata,
    Column("job_id", Text, ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("spec", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("failures", Integer, nullable=False),
    Column("updated_ms", BigInt, nullable=False),
    Column("error", Text),
    Column("result", Text),
    Index("ix_frames_state", "job_id", "state"),
    CheckConstraint("number >= 1 AND failures >= 0", name="frame_counts"),
    CheckConstraint("state IN ('queued', 'succeeded', 'failed', 'cancelled')", name="frame_state"),
    CheckConstraint("state <> 'succeeded' OR result IS NOT NULL", name="frame_result"),
    CheckConstraint("state <> 'failed' OR error IS NOT NULL", name="frame_error"),
    **STRICT,
)
