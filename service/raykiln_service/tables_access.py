"""The tables of access: tokens, owners, use, uploads under way, idempotency keys."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Column, ForeignKey, Index, Table, Text

from raykiln_service.tables import STRICT, BigInt, metadata

tokens = Table(
    "tokens",
    metadata,
    Column("id", Text, primary_key=True),
    Column("name", Text, nullable=False),
    Column("digest", Text, nullable=False, unique=True),
    Column("scopes", Text, nullable=False),
    Column("limits", Text, nullable=False),
    Column("created_ms", BigInt, nullable=False),
    Column("expires_ms", BigInt),
    Column("last_used_ms", BigInt),
    Column("revoked_ms", BigInt),
    **STRICT,
)

asset_owners = Table(
    "asset_owners",
    metadata,
    Column("owner", Text, primary_key=True),
    Column("asset_id", Text, ForeignKey("assets.id", ondelete="CASCADE"), primary_key=True),
    Column("created_ms", BigInt, nullable=False),
    Index("ix_asset_owners_asset", "asset_id"),
    **STRICT,
)

# Submitted pixel samples by the hour, so that deleting a job does not give its samples back.
usage = Table(
    "usage",
    metadata,
    Column("owner", Text, primary_key=True),
    Column("hour", BigInt, primary_key=True, autoincrement=False),
    Column("samples", BigInt, nullable=False),
    **STRICT,
)

# How much of an upload has arrived is the length of its file, and is written nowhere else.
uploads = Table(
    "uploads",
    metadata,
    Column("id", Text, primary_key=True),
    Column("owner", Text),
    Column("length", BigInt, CheckConstraint("length > 0"), nullable=False),
    Column("filename", Text),
    Column("sha256", Text),
    Column("asset_id", Text, ForeignKey("assets.id", ondelete="CASCADE")),
    Column("created_ms", BigInt, nullable=False),
    Column("expires_ms", BigInt, nullable=False),
    Index("ix_uploads_expires", "expires_ms"),
    Index("ix_uploads_owner", "owner"),
    **STRICT,
)

# A key outlives its job: the repeat of a request must not make a deleted job anew.
idempotency = Table(
    "idempotency",
    metadata,
    Column("owner", Text, primary_key=True),
    Column("key", Text, primary_key=True),
    Column("digest", Text, nullable=False),
    Column("job_id", Text, nullable=False),
    Column("created_ms", BigInt, nullable=False),
    Column("reply", Text),
    Index("ix_idempotency_created", "created_ms"),
    **STRICT,
)
