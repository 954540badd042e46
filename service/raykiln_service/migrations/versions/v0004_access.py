"""Tokens, quotas and resumable uploads."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Say who owns what, and keep the replies to idempotent requests."""
    op.add_column("jobs", sa.Column("owner", sa.Text))
    op.add_column(
        "jobs", sa.Column("pixel_samples", _BIG, nullable=False, server_default=sa.text("0"))
    )
    op.create_index("ix_jobs_owner", "jobs", ["owner", "state", "seq"])
    _tokens()
    _usage()
    _uploads()
    _idempotency()


def downgrade() -> None:
    """Everything is everybody's again; the keys of the last day are forgotten."""
    for name in ("idempotency", "uploads", "usage", "asset_owners", "tokens"):
        op.drop_table(name)
    op.drop_index("ix_jobs_owner", "jobs")
    op.drop_column("jobs", "pixel_samples")
    op.drop_column("jobs", "owner")
    op.create_table(
        "idempotency",
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("digest", sa.Text, nullable=False),
        sa.Column("job_id", sa.Text, sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
        sa.Column("created_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_idempotency_created", "idempotency", ["created_ms"])


def _tokens() -> None:
    op.create_table(
        "tokens",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("digest", sa.Text, nullable=False, unique=True),
        sa.Column("scopes", sa.Text, nullable=False),
        sa.Column("limits", sa.Text, nullable=False),
        sa.Column("created_ms", _BIG, nullable=False),
        *(sa.Column(name, _BIG) for name in ("expires_ms", "last_used_ms", "revoked_ms")),
        sqlite_strict=True,
    )
    op.create_table(
        "asset_owners",
        sa.Column("owner", sa.Text, primary_key=True),
        sa.Column("asset_id", sa.Text, _asset(), primary_key=True),
        sa.Column("created_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_asset_owners_asset", "asset_owners", ["asset_id"])


def _usage() -> None:
    op.create_table(
        "usage",
        sa.Column("owner", sa.Text, primary_key=True),
        sa.Column("hour", _BIG, primary_key=True, autoincrement=False),
        sa.Column("samples", _BIG, nullable=False),
        sqlite_strict=True,
    )


def _uploads() -> None:
    op.create_table(
        "uploads",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("owner", sa.Text),
        sa.Column("length", _BIG, sa.CheckConstraint("length > 0"), nullable=False),
        sa.Column("filename", sa.Text),
        sa.Column("sha256", sa.Text),
        sa.Column("asset_id", sa.Text, _asset()),
        sa.Column("created_ms", _BIG, nullable=False),
        sa.Column("expires_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_uploads_expires", "uploads", ["expires_ms"])
    op.create_index("ix_uploads_owner", "uploads", ["owner"])


def _idempotency() -> None:
    # Under another name first: in PostgreSQL a key's index would clash with the old one's.
    op.create_table(
        "idempotency_kept",
        sa.Column("owner", sa.Text, primary_key=True),
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("digest", sa.Text, nullable=False),
        sa.Column("job_id", sa.Text, nullable=False),
        sa.Column("created_ms", _BIG, nullable=False),
        sqlite_strict=True,
    )
    op.execute(
        "INSERT INTO idempotency_kept (owner, key, digest, job_id, created_ms) "
        "SELECT '', key, digest, job_id, created_ms FROM idempotency"
    )
    op.drop_table("idempotency")
    op.rename_table("idempotency_kept", "idempotency")
    op.create_index("ix_idempotency_created", "idempotency", ["created_ms"])


def _asset() -> sa.ForeignKey:
    return sa.ForeignKey("assets.id", ondelete="CASCADE")
