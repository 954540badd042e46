"""Opening the database: SQLite by default, PostgreSQL by URL, and bringing it up to date.

SQLite 3.7.0 to 3.51.2 (but not 3.50.7 and later 3.50, nor 3.44.6 and later 3.44) can lose a
write-ahead log that several connections write or checkpoint at the same time.  Debian 12 links
3.40.1, so this module keeps to what is safe with every version: one process (the data folder is
locked), and in it one connection that writes and checkpoints.  The other connections are
`query_only`, never checkpoint, and are closed first.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, OperationalError, SQLAlchemyError
from sqlalchemy.pool import QueuePool, StaticPool

from raykiln_service.errors import StartupError

_BUSY_TIMEOUT_S = 10.0


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

    @staticmethod
    def sqlite_url(path: Path) -> str:
        """The URL of an SQLite file."""
        return f"sqlite:///{path.resolve()}"

    def _open_sqlite(self) -> tuple[Engine, Engine]:
        arguments = {"check_same_thread": False, "timeout": _BUSY_TIMEOUT_S}
        writer = create_engine(self.url, poolclass=StaticPool, connect_args=arguments)
        reader = create_engine(
            self.url, poolclass=QueuePool, pool_size=4, max_overflow=28, connect_args=arguments
        )
        _prepare_sqlite(writer, "BEGIN IMMEDIATE", _WRITER_PRAGMAS)
        _prepare_sqlite(reader, "BEGIN", _READER_PRAGMAS)
        return writer, reader

    def _open(self) -> tuple[Engine, Engine]:
        engine = create_engine(self.url, pool_size=8, max_overflow=24, pool_pre_ping=True)
        return engine, engine

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """One transaction that may write; committed at the end, rolled back on an error."""
        if not self.is_sqlite:
            with self._writer.begin() as connection:
                yield connection
            return
        with self._write_lock, self._writer.begin() as connection:
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
        self._writer.dispose()


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
