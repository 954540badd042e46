"""Webhooks and the outbox of their deliveries."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
_PENDING = sa.text("state = 'pending'")


def upgrade() -> None:
    """Make room for who is to hear of jobs, and of what."""
    op.create_table(
        "webhooks",
        sa.Column("job_id", sa.Text, primary_key=True),
        *(sa.Column(name, sa.Text, nullable=False) for name in ("url", "host", "events")),
        sa.Column("secret", sa.Text),
        sa.Column("disabled_ms", _BIG),
        sqlite_strict=True,
    )
    _deliveries()
    op.create_index("ix_deliveries_job", "deliveries", ["job_id", "seq"])
    op.create_index(
        "ix_deliveries_due",
        "deliveries",
        ["next_ms"],
        sqlite_where=_PENDING,
        postgresql_where=_PENDING,
    )
    # The context of the trace that the submission was part of.
    op.add_column("jobs", sa.Column("trace", sa.Text))


def downgrade() -> None:
    """Tell nobody any more."""
    op.drop_column("jobs", "trace")
    op.drop_table("deliveries")
    op.drop_table("webhooks")


def _deliveries() -> None:
    op.create_table(
        "deliveries",
        sa.Column("seq", _BIG, primary_key=True, autoincrement=True),
        sa.Column("id", sa.Text, nullable=False, unique=True),
        sa.Column(
            "job_id",
            sa.Text,
            sa.ForeignKey("webhooks.job_id", ondelete="CASCADE"),
            nullable=False,
        ),
        *(sa.Column(name, sa.Text, nullable=False) for name in ("host", "event", "body", "state")),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("created_ms", _BIG, nullable=False),
        *(sa.Column(name, _BIG) for name in ("next_ms", "last_ms")),
        sa.Column("status", sa.Integer),
        sa.Column("error", sa.Text),
        sa.CheckConstraint("state IN ('pending', 'delivered', 'failed')", name="delivery_state"),
        sa.CheckConstraint("(state = 'pending') = (next_ms IS NOT NULL)", name="delivery_next"),
        sa.CheckConstraint("attempts >= 0", name="delivery_attempts"),
        sqlite_autoincrement=True,
        sqlite_strict=True,
    )
