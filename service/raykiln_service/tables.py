"""The tables, as SQLAlchemy sees them; the migrations make them, a test compares the two.

Times are Unix milliseconds.  Structured values are JSON text: the service alone reads them.
SQLite tables are STRICT; the CHECK constraints keep a job's columns and its state in step.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    Table,
    Text,
    literal_column,
    text,
)

metadata = MetaData()

BigInt = BigInteger().with_variant(Integer(), "sqlite")
STRICT: dict[str, Any] = {"sqlite_strict": True}

assets = Table(
    "assets",
    metadata,
    Column("id", Text, primary_key=True),
    Column("size_bytes", BigInt, CheckConstraint("size_bytes >= 0"), nullable=False),
    Column("filename", Text),
    Column("created_ms", BigInt, nullable=False),
    **STRICT,
)

jobs = Table(
    "jobs",
    metadata,
    Column("seq", BigInt, primary_key=True, autoincrement=True),
    Column("id", Text, nullable=False, unique=True),
    Column("state", Text, nullable=False),
    Column("priority", Integer, nullable=False),
    Column("scene", Text, nullable=False),
    Column("settings", Text, nullable=False),
    Column("outputs", Text, nullable=False),
    Column("labels", Text, nullable=False),
    Column("warnings", Text, nullable=False),
    Column("asset_id", Text, ForeignKey("assets.id")),
    Column("created_ms", BigInt, nullable=False),
    Column("updated_ms", BigInt, nullable=False),
    Column("started_ms", BigInt),
    Column("finished_ms", BigInt),
    Column("not_before_ms", BigInt, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("failures", Integer, nullable=False),
    Column("interruptions", Integer, nullable=False),
    Column("stalls", Integer, nullable=False),
    Column("max_attempts", Integer, nullable=False),
    Column("cancel_requested", Integer, nullable=False),
    Column("lease_owner", Text),
    Column("lease_token", Text, unique=True),
    Column("lease_expires_ms", BigInt),
    Column("progress", Text),
    Column("error", Text),
    Column("result", Text),
    CheckConstraint(
        "state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')", name="job_state"
    ),
    CheckConstraint(
        "(state = 'running') = (lease_token IS NOT NULL) "
        "AND (lease_token IS NULL) = (lease_owner IS NULL) "
        "AND (lease_token IS NULL) = (lease_expires_ms IS NULL)",
        name="job_lease",
    ),
    CheckConstraint(
        "(state IN ('succeeded', 'failed', 'cancelled')) = (finished_ms IS NOT NULL)",
        name="job_finished",
    ),
    CheckConstraint("state <> 'succeeded' OR result IS NOT NULL", name="job_result"),
    CheckConstraint("(state = 'failed') = (error IS NOT NULL)", name="job_error"),
    CheckConstraint("cancel_requested IN (0, 1)", name="job_cancel"),
    CheckConstraint(
        "attempts >= 0 AND failures >= 0 AND interruptions >= 0 AND stalls >= 0 "
        "AND max_attempts >= 1",
        name="job_counts",
    ),
    Index(
        "ix_jobs_queue",
        "state",
        text("priority DESC"),
        "seq",
        sqlite_where=text("state = 'queued'"),
        postgresql_where=text("state = 'queued'"),
    ),
    Index(
        "ix_jobs_running",
        "lease_expires_ms",
        sqlite_where=text("state = 'running'"),
        postgresql_where=text("state = 'running'"),
    ),
    Index("ix_jobs_state", "state", "seq"),
    sqlite_autoincrement=True,
    **STRICT,
)

# Spelt out, not bound: SQLite uses a partial index only where it sees its condition.
IS_QUEUED = jobs.c.state == literal_column("'queued'")
IS_RUNNING = jobs.c.state == literal_column("'running'")

job_labels = Table(
    "job_labels",
    metadata,
    Column("job_id", Text, ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("key", Text, primary_key=True),
    Column("value", Text, nullable=False),
    Index("ix_job_labels_value", "key", "value"),
    **STRICT,
)

events = Table(
    "events",
    metadata,
    Column("seq", BigInt, primary_key=True, autoincrement=True),
    Column("job_id", Text, ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    Column("at_ms", BigInt, nullable=False),
    Column("data", Text, nullable=False),
    Index("ix_events_job", "job_id", "seq"),
    sqlite_autoincrement=True,
    **STRICT,
)

idempotency = Table(
    "idempotency",
    metadata,
    Column("key", Text, primary_key=True),
    Column("digest", Text, nullable=False),
    Column("job_id", Text, ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    Column("created_ms", BigInt, nullable=False),
    Index("ix_idempotency_created", "created_ms"),
    **STRICT,
)
