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
    Column("used_ms", BigInt, nullable=False, server_default=text("0")),
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
    Column("frames", Text),
    Column("queued_ms", BigInt, nullable=False, server_default=text("0")),
    Column("rank_ms", BigInt, nullable=False, server_default=text("0")),
    Column("limit_ms", BigInt),
    Column("scene_key", Text),
    Column("cache_key", Text),
    Column("use_cache", Integer, nullable=False, server_default=text("1")),
    Column("owner", Text),
    Column("pixel_samples", BigInt, nullable=False, server_default=text("0")),
    Column("trace", Text),
    Column("limits", Text),
    Column("used_ms", BigInt, nullable=False, server_default=text("0")),
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
        "rank_ms",
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
    Index("ix_jobs_owner", "owner", "state", "seq"),
    Index(
        "ix_jobs_cache",
        "cache_key",
        "seq",
        sqlite_where=text("state = 'succeeded' AND cache_key IS NOT NULL"),
        postgresql_where=text("state = 'succeeded' AND cache_key IS NOT NULL"),
    ),
    Index("ix_jobs_asset", "asset_id"),
    Index("ix_jobs_finished", "finished_ms"),
    sqlite_autoincrement=True,
    **STRICT,
)

# Spelt out, not bound: SQLite uses a partial index only where it sees its condition.
IS_QUEUED = jobs.c.state == literal_column("'queued'")
IS_RUNNING = jobs.c.state == literal_column("'running'")
IS_SUCCEEDED = jobs.c.state == literal_column("'succeeded'")

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

# One row, for all services that share the database.
queue = Table(
    "queue",
    metadata,
    Column("id", Integer, CheckConstraint("id = 1"), primary_key=True),
    Column("paused_ms", BigInt),
    Column("reason", Text),
    **STRICT,
)
