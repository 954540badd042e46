"""Frames: the units of jobs that render several pictures."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Note what frames a job asks for, and how each of them stands."""
    op.add_column("jobs", sa.Column("frames", sa.Text))
    op.create_table(
        "frames",
        sa.Column(
            "job_id", sa.Text, sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("spec", sa.Text, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("failures", sa.Integer, nullable=False),
        sa.Column("updated_ms", _BIG, nullable=False),
        sa.Column("error", sa.Text),
        sa.Column("result", sa.Text),
        sa.CheckConstraint("number >= 1 AND failures >= 0", name="frame_counts"),
        sa.CheckConstraint(
            "state IN ('queued', 'succeeded', 'failed', 'cancelled')", name="frame_state"
        ),
        sa.CheckConstraint("state <> 'succeeded' OR result IS NOT NULL", name="frame_result"),
        sa.CheckConstraint("state <> 'failed' OR error IS NOT NULL", name="frame_error"),
        sqlite_strict=True,
    )
    op.create_index("ix_frames_state", "frames", ["job_id", "state"])


def downgrade() -> None:
    """Forget them."""
    op.drop_table("frames")
    op.drop_column("jobs", "frames")
