"""What was announced of resumable uploads, in the database."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from raykiln_service.access import Caller
from raykiln_service.database import Database
from raykiln_service.quotas import admit_bytes
from raykiln_service.tables_access import uploads

_LISTED = 100


@dataclass(frozen=True, slots=True)
class Announced:
    """An upload as it was announced, and what became of it.  Times are Unix milliseconds."""

    id: str
    owner: str | None
    length: int
    filename: str | None
    sha256: str | None
    asset_id: str | None
    created_ms: int
    expires_ms: int


class UploadRows:
    """The table of uploads.  All methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, row: Announced, caller: Caller) -> None:
        """Note a new upload; `QuotaError` if the caller's come to too much with it."""
        with self._database.write() as connection:
            admit_bytes(connection, caller, row.length)
            connection.execute(
                uploads.insert().values(
                    id=row.id,
                    owner=row.owner,
                    length=row.length,
                    filename=row.filename,
                    sha256=row.sha256,
                    created_ms=row.created_ms,
                    expires_ms=row.expires_ms,
                )
            )

    def get(self, upload_id: str) -> Announced | None:
        """One upload, if there is such a one."""
        found = self._select(sa.select(uploads).where(uploads.c.id == upload_id))
        return found[0] if found else None

    def ids(self) -> set[str]:
        """The ids of all uploads."""
        with self._database.read() as connection:
            return set(connection.execute(sa.select(uploads.c.id)).scalars())

    def unfinished(self, owner: str | None, sha256: str | None, now_ms: int) -> list[Announced]:
        """An owner's uploads under way, the latest first; only of these bytes, if so asked."""
        query = sa.select(uploads).where(
            uploads.c.owner.is_(None) if owner is None else uploads.c.owner == owner,
            uploads.c.asset_id.is_(None),
            uploads.c.expires_ms > now_ms,
        )
        if sha256 is not None:
            query = query.where(uploads.c.sha256 == sha256)
        order = (uploads.c.created_ms.desc(), uploads.c.id)
        return self._select(query.order_by(*order).limit(_LISTED))

    def expired(self, now_ms: int) -> list[str]:
        """The ids of those whose time is over."""
        query = sa.select(uploads.c.id).where(uploads.c.expires_ms <= now_ms)
        with self._database.read() as connection:
            return list(connection.execute(query).scalars())

    def change(self, upload_id: str, **values: Any) -> None:
        """Set columns of an upload."""
        with self._database.write() as connection:
            connection.execute(uploads.update().where(uploads.c.id == upload_id).values(**values))

    def delete(self, upload_id: str) -> None:
        """Forget an upload."""
        with self._database.write() as connection:
            connection.execute(uploads.delete().where(uploads.c.id == upload_id))

    def _select(self, query: sa.Select[Any]) -> list[Announced]:
        with self._database.read() as connection:
            return [Announced(**row) for row in connection.execute(query).mappings()]
