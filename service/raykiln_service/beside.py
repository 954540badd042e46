"""Opening a service's database from a command, beside the service or without one."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from raykiln_service.database import Database
from raykiln_service.errors import StartupError


@contextmanager
def open_database(data_dir: Path, url: str | None) -> Iterator[Database]:
    """The database of a service; the folder and the tables are made if there are none yet.

    Raises
    ------
    StartupError
        The folder or the database cannot be used, or a service of another version has it.
    """
    lock = _try_lock(data_dir)
    try:
        database = Database(url or Database.sqlite_url(data_dir / "raykiln.db"))
        try:
            # While a service runs the tables are its own to change.
            if lock is not None or url is not None:
                database.migrate()
            yield database
        finally:
            database.close()
    finally:
        if lock is not None:
            lock.close()


def _try_lock(data_dir: Path) -> BinaryIO | None:
    """The lock of the data folder, or None if a service has it."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        lock = (data_dir / "lock").open("ab")
    except OSError as error:
        raise StartupError(
            f"the data folder {data_dir} cannot be used: {error.strerror or error}"
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        return None
    return lock
