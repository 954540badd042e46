"""Bearer tokens: made, listed and revoked in the database, where only their hashes are.

A token is ``rk_``, 36 random characters (214 bits) and a checksum of 6, all letters and digits.
The prefix lets secret scanners find it, and the checksum lets them, and this service, tell a
token from a mistyped one without asking anybody.  With that much randomness a plain SHA-256
cannot be searched backwards; slow hashes are for passwords that people think up.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
import string
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass

import sqlalchemy as sa

from raykiln_service.access import Caller, Limits, Scope
from raykiln_service.database import Database
from raykiln_service.errors import ConflictError, NotFoundError
from raykiln_service.store_base import now_ms
from raykiln_service.tables_access import tokens

PREFIX = "rk_"
_ALPHABET = string.digits + string.ascii_letters
_RANDOM = 36
_CHECK = 6
_SHAPE = re.compile(rf"{PREFIX}[0-9A-Za-z]{{{_RANDOM + _CHECK}}}")
_TRUSTED_S = 1.0
_CACHED = 4096
_USE_NOTED_MS = 60_000


@dataclass(frozen=True, slots=True)
class Token:
    """A token as it is known to the service: all but its text.  Times are Unix milliseconds."""

    id: str
    name: str
    scopes: frozenset[Scope]
    limits: Limits
    created_ms: int
    expires_ms: int | None = None
    last_used_ms: int | None = None
    revoked_ms: int | None = None

    def state(self, now: int) -> str:
        """Active, expired or revoked."""
        if self.revoked_ms is not None:
            return "revoked"
        return "expired" if self.expires_ms is not None and now >= self.expires_ms else "active"


def new_text() -> str:
    """A new random token."""
    body = "".join(secrets.choice(_ALPHABET) for _ in range(_RANDOM))
    return f"{PREFIX}{body}{_checksum(body)}"


def is_well_formed(text: str) -> bool:
    """Whether a text can be a token at all: shape and checksum."""
    if _SHAPE.fullmatch(text) is None:
        return False
    body = text[len(PREFIX) : -_CHECK]
    return hmac.compare_digest(_checksum(body), text[-_CHECK:])


def _checksum(body: str) -> str:
    number, digits = zlib.crc32(body.encode()), ""
    for _ in range(_CHECK):
        number, digit = divmod(number, len(_ALPHABET))
        digits = _ALPHABET[digit] + digits
    return digits


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class TokenStore:
    """The tokens of one database.  All methods may be called from any thread."""

    def __init__(
        self,
        database: Database,
        defaults: Limits | None = None,
        *,
        clock: Callable[[], int] = now_ms,
    ) -> None:
        self._database = database
        self._defaults = defaults or Limits()
        self._clock = clock
        self._lock = threading.Lock()
        self._known: OrderedDict[str, tuple[Token, float]] = OrderedDict()

    # For the command line

    def create(
        self,
        name: str,
        scopes: Iterable[Scope],
        *,
        limits: Limits | None = None,
        lifetime_ms: int | None = None,
    ) -> tuple[Token, str]:
        """A new token, and its text, which is not kept and cannot be had again.

        Raises
        ------
        ConflictError
            An active token has this name.
        """
        now, text = self._clock(), new_text()
        token = Token(
            id=f"tok-{secrets.token_hex(6)}",
            name=name,
            scopes=frozenset(scopes),
            limits=limits or Limits(),
            created_ms=now,
            expires_ms=None if lifetime_ms is None else now + lifetime_ms,
        )
        with self._database.write() as connection:
            same_name = self._select(connection, tokens.c.name == name)
            if any(other.state(now) == "active" for other in same_name):
                raise ConflictError(f"there is an active token of the name {name!r} already")
            connection.execute(
                tokens.insert().values(
                    id=token.id,
                    name=name,
                    digest=_digest(text),
                    scopes=" ".join(sorted(token.scopes)),
                    limits=json.dumps(asdict(token.limits)),
                    created_ms=now,
                    expires_ms=token.expires_ms,
                )
            )
        return token, text

    def all(self) -> list[Token]:
        """All tokens, the oldest first; revoked ones too."""
        with self._database.read() as connection:
            return self._select(connection, sa.true())

    def revoke(self, id_or_name: str) -> Token:
        """End a token for good; `NotFoundError` if no active one has this id or name."""
        now = self._clock()
        wanted = sa.or_(tokens.c.id == id_or_name, tokens.c.name == id_or_name)
        with self._database.write() as connection:
            found = [t for t in self._select(connection, wanted) if t.revoked_ms is None]
            if not found:
                raise NotFoundError(f"there is no token {id_or_name!r} that could be revoked")
            ids = [token.id for token in found]
            query = tokens.update().where(tokens.c.id.in_(ids)).values(revoked_ms=now)
            connection.execute(query)
        self.forget()
        return found[-1]

    # For the service

    def any_active(self) -> bool:
        """Whether there is a token that would be let in."""
        now = self._clock()
        return any(token.state(now) == "active" for token in self.all())

    def inactive(self, ids: Collection[str]) -> list[str]:
        """Those of the tokens with these ids that are no longer let in."""
        now = self._clock()
        with self._database.read() as connection:
            found = self._select(connection, tokens.c.id.in_(list(ids)))
        active = {token.id for token in found if token.state(now) == "active"}
        return [token_id for token_id in ids if token_id not in active]

    def recall(self, text: str) -> Caller | None:
        """Who has this token, if it was looked up just now; does not wait for the database."""
        with self._lock:
            token, until = self._known.get(_digest(text), (None, 0.0))
        if token is None or time.monotonic() > until or token.state(self._clock()) != "active":
            return None
        return self._caller(token)

    def find(self, text: str) -> Caller | None:
        """Who has this token; None if nobody has it, or no longer."""
        digest, asked = _digest(text), time.monotonic()
        with self._database.read() as connection:
            row = connection.execute(
                sa.select(tokens).where(tokens.c.digest == digest)
            ).one_or_none()
        if row is None or not hmac.compare_digest(row.digest, digest):
            return None
        token = _token_of(row)
        if token.state(self._clock()) != "active":
            return None
        with self._lock:
            self._known[digest] = (token, asked + _TRUSTED_S)
            self._known.move_to_end(digest)
            while len(self._known) > _CACHED:
                self._known.popitem(last=False)
        self._note_use(token)
        return self._caller(token)

    def forget(self) -> None:
        """Look every token up anew."""
        with self._lock:
            self._known.clear()

    def _note_use(self, token: Token) -> None:
        # Once a minute is enough: every write waits for the disk.
        now = self._clock()
        if token.last_used_ms is not None and now - token.last_used_ms < _USE_NOTED_MS:
            return
        query = tokens.update().where(tokens.c.id == token.id).values(last_used_ms=now)
        # A full disk must not keep anybody from looking at jobs.
        with suppress(sa.exc.SQLAlchemyError), self._database.write() as connection:
            connection.execute(query)

    def _caller(self, token: Token) -> Caller:
        limits = token.limits
        if Scope.ADMIN not in token.scopes:
            limits = limits.over(self._defaults)
        return Caller(token.id, token.name, token.scopes, limits)

    @staticmethod
    def _select(connection: sa.Connection, wanted: sa.ColumnElement[bool]) -> list[Token]:
        query = sa.select(tokens).where(wanted).order_by(tokens.c.created_ms, tokens.c.id)
        return [_token_of(row) for row in connection.execute(query)]


def _token_of(row: sa.Row[tuple[object, ...]]) -> Token:
    # A scope of a later version is a right that this one cannot grant.
    known = [Scope(name) for name in row.scopes.split() if name in set(Scope)]
    limits = {k: v for k, v in json.loads(row.limits).items() if k in Limits.__dataclass_fields__}
    return Token(
        id=row.id,
        name=row.name,
        scopes=frozenset(known),
        limits=Limits(**limits),
        created_ms=row.created_ms,
        expires_ms=row.expires_ms,
        last_used_ms=row.last_used_ms,
        revoked_ms=row.revoked_ms,
    )
