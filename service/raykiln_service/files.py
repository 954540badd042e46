"""Files that must survive: written beside their place, synced, renamed, and the folder synced."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
from pathlib import Path
from typing import Any

# A folder that has no room for so much has none for an image either.
_PROBE_BYTES = 1 << 20


def sync_dir(folder: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_file(path: Path) -> None:
    """Make the content of a file durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_durably(path: Path, data: bytes) -> None:
    """Replace a file's content at once and for good."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_dir(path.parent)


def write_json(path: Path, value: Any) -> None:
    """`write_durably` of a value as indented JSON."""
    write_durably(path, json.dumps(value, indent=2, allow_nan=False).encode() + b"\n")


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def publish_folder(work: Path, place: Path) -> None:
    """Sync all files of the folder `work` and rename it to `place` (same parent)."""
    for path in work.iterdir():
        sync_file(path)
    sync_dir(work)
    work.replace(place)
    sync_dir(place.parent)


def remove_tree(folder: Path) -> None:
    """Remove a folder and all in it, as far as that is possible."""
    if not folder.exists():
        return
    for path, _folders, _files in os.walk(folder):
        with contextlib.suppress(OSError):
            Path(path).chmod(0o700)
    shutil.rmtree(folder, ignore_errors=True)


def storage_trouble(folder: Path) -> str | None:
    """Why nothing can be written to a folder just now; None if it can."""
    probe = folder / f".probe-{secrets.token_hex(4)}"
    try:
        with probe.open("wb") as file:
            file.write(os.urandom(_PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error.strerror or str(error)
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)
    return None
