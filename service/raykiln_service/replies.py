"""The replies to requests with an idempotency key, which answer the repeats.

A reply is known from the moment it is given, and written to the database with others a little
later, so that nobody waits for a disk on its account.  A kill in between loses it, not the job:
the next repeat is then answered with the job as it is, and that is the reply from there on.
"""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import sqlalchemy as sa

from raykiln_service.database import Database
from raykiln_service.tables_access import idempotency

_REMEMBERED = 1000
Place = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Reply:
    """What a request was answered with."""

    status: int
    headers: Mapping[str, str]
    body: str


class Replies:
    """The replies of one database.  All methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._unwritten: dict[Place, Reply] = {}
        self._written: OrderedDict[Place, Reply] = OrderedDict()

    def keep(self, owner: str | None, key: str, reply: Reply) -> Reply:
        """Note the reply to a request; the one that counts, which is the first."""
        place = (owner or "", key)
        with self._lock:
            return self._written.get(place) or self._unwritten.setdefault(place, reply)

    def find(self, owner: str | None, key: str) -> Reply | None:
        """The reply that was given, if there is one; the request has been found to be the same."""
        place = (owner or "", key)
        with self._lock:
            known = self._unwritten.get(place) or self._written.get(place)
        if known is not None:
            return known
        query = sa.select(idempotency.c.reply).where(*_is_at(place))
        with self._database.read() as connection:
            text = connection.execute(query).scalar_one_or_none()
        return None if text is None else Reply(**json.loads(text))

    def forget(self, owner: str | None, key: str) -> None:
        """A key begins anew: what it was answered with before does not count."""
        place = (owner or "", key)
        with self._lock:
            self._unwritten.pop(place, None)
            self._written.pop(place, None)

    def write(self) -> int:
        """Write what is not in the database yet; how many there were."""
        with self._lock:
            pending = dict(self._unwritten)
        if not pending:
            return 0
        with self._database.write() as connection:
            for place, reply in pending.items():
                fields = {"status": reply.status, "headers": dict(reply.headers)}
                text = json.dumps({**fields, "body": reply.body})
                query = idempotency.update().where(*_is_at(place), idempotency.c.reply.is_(None))
                connection.execute(query.values(reply=text))
        with self._lock:
            for place, reply in pending.items():
                if self._unwritten.get(place) is reply:
                    del self._unwritten[place]
                    self._written[place] = reply
            while len(self._written) > _REMEMBERED:
                self._written.popitem(last=False)
        return len(pending)


def _is_at(place: Place) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    return idempotency.c.owner == place[0], idempotency.c.key == place[1]
