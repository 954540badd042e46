"""Which uploads are whose.  The bytes of an asset are stored once, whoever uploads them.

A token knows an asset only if it has uploaded those bytes itself: a hash that leaked into a log
must not give the scene away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from raykiln_service.access import Caller
from raykiln_service.tables import assets
from raykiln_service.tables_access import asset_owners

_AT_ONCE = 500


def owned_assets(connection: sa.Connection, caller: Caller, ids: Sequence[str]) -> set[str]:
    """Those of the ids that are stored and that the caller may use."""
    found: set[str] = set()
    for start in range(0, len(ids), _AT_ONCE):
        query = sa.select(assets.c.id).where(assets.c.id.in_(ids[start : start + _AT_ONCE]))
        if not caller.sees_all:
            owned = asset_owners.c.asset_id == assets.c.id
            query = query.join(asset_owners, owned).where(asset_owners.c.owner == caller.owner)
        found |= set(connection.execute(query).scalars())
    return found


def own_asset(connection: sa.Connection, caller: Caller, asset_id: str, now_ms: int) -> None:
    """Note that the caller has uploaded an asset."""
    if caller.owner is None:
        return
    insert: Any = postgresql.insert if connection.dialect.name == "postgresql" else sqlite.insert
    row = insert(asset_owners).values(owner=caller.owner, asset_id=asset_id, created_ms=now_ms)
    connection.execute(row.on_conflict_do_nothing())
