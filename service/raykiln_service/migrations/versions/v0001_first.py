"""Assets, jobs, labels, events and idempotency keys."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Make the first tables."""
    _assets()
    _jobs()
    _job_indexes()
    _job_details()


def downgrade() -> None:
    """Drop them."""
    for name in ("idempotency", "events", "job_labels", "jobs", "assets"):
        op.drop_table(name)


def _assets() -> None:
    op.create_table(
        "assets",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("size_bytes", _BIG, sa.CheckConstraint("size_bytes >= 0"), nullable=False),
        sa.Column("filename", sa.Text),
        sa.Column("created_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )


def _jobs() -> None:
    op.create_table(
        "jobs",
        sa.Column("seq", _BIG, primary_key=True, autoincrement=True),
        sa.Column("id", sa.Text, nullable=False, unique=True),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("priority", sa.Integer, nullable=False),
        *(
            sa.Column(name, sa.Text, nullable=False)
            for name in ("scene", "settings", "outputs", "labels", "warnings")
        ),
        sa.Column("asset_id", sa.Text, sa.ForeignKey("assets.id")),
        sa.Column("created_ms", _BIG, nullable=False),
        sa.Column("updated_ms", _BIG, nullable=False),
        sa.Column("started_ms", _BIG),
        sa.Column("finished_ms", _BIG),
        sa.Column("not_before_ms", _BIG, nullable=False),
        *(
            sa.Column(name, sa.Integer, nullable=False)
            for name in ("attempts", "failures", "interruptions", "stalls", "max_attempts")
        ),
        sa.Column("cancel_requested", sa.Integer, nullable=False),
        sa.Column("lease_owner", sa.Text),
        sa.Column("lease_token", sa.Text, unique=True),
        sa.Column("lease_expires_ms", _BIG),
        sa.Column("progress", sa.Text),
        sa.Column("error", sa.Text),
        sa.Column("result", sa.Text),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')",
            name="job_state",
        ),
        sa.CheckConstraint(
            "(state = 'running') = (lease_token IS NOT NULL) "
            "AND (lease_token IS NULL) = (lease_owner IS NULL) "
            "AND (lease_token IS NULL) = (lease_expires_ms IS NULL)",
            name="job_lease",
        ),
        sa.CheckConstraint(
            "(state IN ('succeeded', 'failed', 'cancelled')) = (finished_ms IS NOT NULL)",
            name="job_finished",
        ),
        sa.CheckConstraint("state <> 'succeeded' OR result IS NOT NULL", name="job_result"),
        sa.CheckConstraint("(state = 'failed') = (error IS NOT NULL)", name="job_error"),
        sa.CheckConstraint("cancel_requested IN (0, 1)", name="job_cancel"),
        sa.CheckConstraint(
            "attempts >= 0 AND failures >= 0 AND interruptions >= 0 AND stalls >= 0 "
            "AND max_attempts >= 1",
            name="job_counts",
        ),
        sqlite_autoincrement=True,
        sqlite_strict=True,
    )


def _job_indexes() -> None:
    queued, running = sa.text("state = 'queued'"), sa.text("state = 'running'")
    op.create_index(
        "ix_jobs_queue",
        "jobs",
        ["state", sa.text("priority DESC"), "seq"],
        sqlite_where=queued,
        postgresql_where=queued,
    )
    op.create_index(
        "ix_jobs_running",
        "jobs",
        ["lease_expires_ms"],
        sqlite_where=running,
        postgresql_where=running,
    )
    op.create_index("ix_jobs_state", "jobs", ["state", "seq"])


def _job_details() -> None:
    op.create_table(
        "job_labels",
        sa.Column("job_id", sa.Text, _job(), primary_key=True),
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("value", sa.Text, nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_job_labels_value", "job_labels", ["key", "value"])
    op.create_table(
        "events",
        sa.Column("seq", _BIG, primary_key=True, autoincrement=True),
        sa.Column("job_id", sa.Text, _job(), nullable=False),
        sa.Column("at_ms", _BIG, nullable=False),
        sa.Column("data", sa.Text, nullable=False),
        sqlite_autoincrement=True,
        sqlite_strict=True,
    )
    op.create_index("ix_events_job", "events", ["job_id", "seq"])
    op.create_table(
        "idempotency",
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("digest", sa.Text, nullable=False),
        sa.Column("job_id", sa.Text, _job(), nullable=False),
        sa.Column("created_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_idempotency_created", "idempotency", ["created_ms"])


def _job() -> sa.ForeignKey:
    return sa.ForeignKey("jobs.id", ondelete="CASCADE")
