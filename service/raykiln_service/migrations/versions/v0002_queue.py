"""State of the queue: ranks, a pause, expected work, cached results, last use of assets."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
_QUEUED = sa.text("state = 'queued'")
_SUCCEEDED = sa.text("state = 'succeeded' AND cache_key IS NOT NULL")


def upgrade() -> None:
    """Rank what waits as if it had come with this version."""
    for name, kind in (("queued_ms", _BIG), ("rank_ms", _BIG)):
        op.add_column("jobs", sa.Column(name, kind, nullable=False, server_default=sa.text("0")))
    op.add_column("jobs", sa.Column("limit_ms", _BIG))
    op.add_column("jobs", sa.Column("scene_key", sa.Text))
    op.add_column("jobs", sa.Column("cache_key", sa.Text))
    op.add_column(
        "jobs", sa.Column("use_cache", sa.Integer, nullable=False, server_default=sa.text("1"))
    )
    op.add_column("assets", sa.Column("used_ms", _BIG, nullable=False, server_default=sa.text("0")))
    op.execute("UPDATE jobs SET queued_ms = created_ms, rank_ms = created_ms - priority * 600000")
    op.execute("UPDATE assets SET used_ms = created_ms")
    op.drop_index("ix_jobs_queue", "jobs")
    op.create_index(
        "ix_jobs_queue",
        "jobs",
        ["state", "rank_ms", "seq"],
        sqlite_where=_QUEUED,
        postgresql_where=_QUEUED,
    )
    op.create_index(
        "ix_jobs_cache",
        "jobs",
        ["cache_key", "seq"],
        sqlite_where=_SUCCEEDED,
        postgresql_where=_SUCCEEDED,
    )
    op.create_index("ix_jobs_asset", "jobs", ["asset_id"])
    op.create_index("ix_jobs_finished", "jobs", ["finished_ms"])
    op.create_table(
        "queue",
        sa.Column("id", sa.Integer, sa.CheckConstraint("id = 1"), primary_key=True),
        sa.Column("paused_ms", _BIG),
        sa.Column("reason", sa.Text),
        sqlite_strict=True,
    )
    op.execute("INSERT INTO queue (id) VALUES (1)")


def downgrade() -> None:
    """Back to the first order."""
    op.drop_table("queue")
    for name in ("ix_jobs_finished", "ix_jobs_asset", "ix_jobs_cache", "ix_jobs_queue"):
        op.drop_index(name, "jobs")
    op.create_index(
        "ix_jobs_queue",
        "jobs",
        ["state", sa.text("priority DESC"), "seq"],
        sqlite_where=_QUEUED,
        postgresql_where=_QUEUED,
    )
    op.drop_column("assets", "used_ms")
    for name in ("use_cache", "cache_key", "scene_key", "limit_ms", "rank_ms", "queued_ms"):
        op.drop_column("jobs", name)
