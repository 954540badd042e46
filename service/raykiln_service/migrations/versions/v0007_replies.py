"""The replies that repeated requests are answered with."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Keep the reply beside the key of its request, from when it was given."""
    op.add_column("idempotency", sa.Column("reply", sa.Text))


def downgrade() -> None:
    """Forget them."""
    op.drop_column("idempotency", "reply")
