"""The tables of webhooks: who is to hear of a job, and the outbox of what they are to hear.

Neither refers to the table of jobs: a job may be deleted before the news of its end is delivered.
"""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Column, ForeignKey, Index, Integer, Table, Text, text

from raykiln_service.tables import STRICT, BigInt, metadata

webhooks = Table(
    "webhooks",
    metadata,
    Column("job_id", Text, primary_key=True),
    Column("url", Text, nullable=False),
    Column("host", Text, nullable=False),
    Column("events", Text, nullable=False),
    Column("secret", Text),
    Column("disabled_ms", BigInt),
    **STRICT,
)

deliveries = Table(
    "deliveries",
    metadata,
    Column("seq", BigInt, primary_key=True, autoincrement=True),
    Column("id", Text, nullable=False, unique=True),
    Column("job_id", Text, ForeignKey("webhooks.job_id", ondelete="CASCADE"), nullable=False),
    Column("host", Text, nullable=False),
    Column("event", Text, nullable=False),
    Column("body", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("created_ms", BigInt, nullable=False),
    Column("next_ms", BigInt),
    Column("last_ms", BigInt),
    Column("status", Integer),
    Column("error", Text),
    CheckConstraint("state IN ('pending', 'delivered', 'failed')", name="delivery_state"),
    CheckConstraint("(state = 'pending') = (next_ms IS NOT NULL)", name="delivery_next"),
    CheckConstraint("attempts >= 0", name="delivery_attempts"),
    Index("ix_deliveries_job", "job_id", "seq"),
    Index(
        "ix_deliveries_due",
        "next_ms",
        sqlite_where=text("state = 'pending'"),
        postgresql_where=text("state = 'pending'"),
    ),
    sqlite_autoincrement=True,
    **STRICT,
)
