"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path


def write_atomically(path: str | os.PathLike[str], data: bytes | memoryview) -> Path:
    """Write `data` to `path` so that a crash leaves the old file or the new one, never a part.

    The bytes go to a temporary file in the same folder, are synced, and take the name at once.
    Raises `OSError` where the file cannot be written, or something else than a file has the name.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        # Taking the name of a device or a pipe would remove it for everybody.
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    with _temporary_beside(path) as temporary:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    _sync_folder(path.parent)
    return path


@contextlib.contextmanager
def _temporary_beside(path: Path) -> Iterator[Path]:
    temporary = path.with_name(f".{path.name[:64]}.{secrets.token_hex(6)}.tmp")
    try:
        yield temporary
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
