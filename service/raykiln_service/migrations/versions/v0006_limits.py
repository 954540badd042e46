"""Limits of single jobs, and the time they have used."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Note what a job may take, and how long it has been on a slot, over all attempts."""
    op.add_column("jobs", sa.Column("limits", sa.Text))
    op.add_column("jobs", sa.Column("used_ms", _BIG, nullable=False, server_default=sa.text("0")))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("jobs", "used_ms")
    op.drop_column("jobs", "limits")
