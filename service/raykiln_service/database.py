"""Opening the database: SQLite by default, PostgreSQL by URL, and bringing it up to date.

SQLite 3.7.0 to 3.51.2 (but not 3.50.7 and later 3.50, nor 3.44.6 and later 3.44) can lose a
write-ahead log that several connections write or checkpoint at the same time.  Debian 12 links
3.40.1, so this module keeps to what is safe with every version: one connection at a time writes
and checkpoints.  A process has one such connection; its other ones are `query_only`, never
checkpoint, and are closed first.  The service and a command beside it (`raykiln token`) take turns
by a lock on a file beside the database.
"""

from __future__ import annotations

import fcntl
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, OperationalError, SQLAlchemyError
from sqlalchemy.pool import QueuePool, StaticPool

from raykiln_service.errors import StartupError

_BUSY_TIMEOUT_S = 10.0
_TURN_POLL_S = 0.005


def has_wal_reset_bug(version: tuple[int, ...]) -> bool:
    """Whether an SQLite of this version needs the one-writer rule for its safety."""
    if version >= (3, 51, 3) or version < (3, 7, 0):
        return False
    return not (version[:2] == (3, 50) and version >= (3, 50, 7)) and not (
        version[:2] == (3, 44) and version >= (3, 44, 6)
    )


class Database:
    """A write connection (or pool) and a read pool of one database."""

    def __init__(self, url: str) -> None:
        try:
            self.url = make_url(url)
            self.is_sqlite = self.url.get_backend_name() == "sqlite"
            self._writer, self._reader = self._open_sqlite() if self.is_sqlite else self._open()
        except (ArgumentError, NoSuchModuleError, ImportError) as error:
            raise StartupError(f"the database URL cannot be used: {error}") from None
        self._write_lock = threading.RLock()
        self._turn = _Turn(self.url.database) if self.is_sqlite else None

    @staticmethod
    def sqlite_url(path: Path) -> str:
        """The URL of an SQLite file."""
        return f"sqlite:///{path.resolve()}"

    def _open_sqlite(self) -> tuple[Engine, Engine]:
        arguments = {"check_same_thread": False, "timeout": _BUSY_TIMEOUT_S}
        writer = create_engine(
            self.url, poolclass=StaticPool, connect_args=arguments, hide_parameters=True
        )
        reader = create_engine(
            self.url,
            poolclass=QueuePool,
            pool_size=4,
            max_overflow=28,
            connect_args=arguments,
            hide_parameters=True,
        )
        _prepare_sqlite(writer, "BEGIN IMMEDIATE", _WRITER_PRAGMAS)
        _prepare_sqlite(reader, "BEGIN", _READER_PRAGMAS)
        return writer, reader

    def _open(self) -> tuple[Engine, Engine]:
        engine = create_engine(
            self.url, pool_size=8, max_overflow=24, pool_pre_ping=True, hide_parameters=True
        )
        return engine, engine

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """One transaction that may write; committed at the end, rolled back on an error."""
        if not self.is_sqlite:
            with self._writer.begin() as connection:
                yield connection
            return
        assert self._turn is not None
        with self._write_lock, self._turn.taken(), self._writer.begin() as connection:
            yield connection

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """One transaction that only reads."""
        with self._reader.begin() as connection:
            yield connection

    def migrate(self) -> None:
        """Bring the tables up to date; `StartupError` if that cannot be."""
        try:
            with self.write() as connection:
                config = Config()
                config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
                config.attributes["connection"] = connection
                command.upgrade(config, "head")
        except OperationalError as error:
            raise StartupError(f"the database cannot be used: {error.orig}") from None
        except (SQLAlchemyError, sqlite3.Error) as error:
            raise StartupError(f"the database cannot be brought up to date: {error}") from None

    def close(self) -> None:
        """Close all connections, the writer last: it makes the final checkpoint."""
        self._reader.dispose()
        if self._turn is None:
            self._writer.dispose()
            return
        # Without a turn the log stays as it is, and the next service reads it.
        with suppress(OperationalError), self._write_lock, self._turn.taken():
            self._writer.dispose()


class _Turn:
    """Keeps other processes from writing to an SQLite file meanwhile."""

    def __init__(self, database: str | None) -> None:
        self._path = None if database in (None, "", ":memory:") else f"{database}-turn"

    @contextmanager
    def taken(self) -> Iterator[None]:
        """While this lasts, no other process has its turn; `OperationalError` if none ends."""
        if self._path is None:
            yield
            return
        with _opened(self._path) as file:
            deadline = time.monotonic() + _BUSY_TIMEOUT_S
            while not self._try(file):
                if time.monotonic() > deadline:
                    error = TimeoutError("database is locked by another process")
                    raise OperationalError(None, None, error)
                time.sleep(_TURN_POLL_S)
            yield

    @staticmethod
    def _try(file: BinaryIO) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def _opened(path: str) -> BinaryIO:
    try:
        return Path(path).open("ab")
    except OSError as error:
        raise OperationalError(None, None, error) from None


_WRITER_PRAGMAS = (
    "journal_mode=WAL",
    "synchronous=FULL",
    "foreign_keys=ON",
    "wal_autocheckpoint=1000",
)
_READER_PRAGMAS = ("query_only=ON", "wal_autocheckpoint=0")


def _prepare_sqlite(engine: Engine, begin: str, pragmas: tuple[str, ...]) -> None:
    @event.listens_for(engine, "connect")
    def _connect(connection: Any, _record: Any) -> None:
        # The driver must not open transactions of its own: `begin` below does.
        connection.isolation_level = None
        cursor = connection.cursor()
        for pragma in pragmas:
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql(begin)
