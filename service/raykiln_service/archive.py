"""All outputs of a job as one zip, written while it is sent: nothing is kept for it."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raykiln_service.schemas_frames import file_name_of
from raykiln_service.units import FrameRecord

_CHUNK = 1 << 20
# A fixed date: the same outputs give the same archive.
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Entry:
    """A file of an archive."""

    name: str
    path: Path
    tag: str
    """Changes with the content."""


def entries_of(
    folder: Path, result: Mapping[str, Any] | None, frames: Sequence[FrameRecord], log_name: str
) -> list[Entry]:
    """What the archive of a job holds; nothing if there is no output yet.

    Parameters
    ----------
    folder
        The job's folder.
    result
        Of the job.
    """
    entries = [
        Entry(file["name"], folder / result["dir"] / file["name"], file["sha256"])
        for file in (result or {}).get("files", ())
        if result is not None
    ]
    for record in frames:
        if record.result is None:
            continue
        place = folder / record.result["dir"]
        for file in record.result["files"]:
            name = file_name_of(record.frame.number, file["name"])
            entries.append(Entry(name, place / file["name"], file["sha256"]))
    log = folder / log_name
    if entries and log.is_file():
        entries.append(Entry(log_name, log, str(log.stat().st_size)))
    return entries


def tag_of(entries: Sequence[Entry]) -> str:
    """A hash of all that is in an archive."""
    lines = "".join(f"{entry.name}\n{entry.tag}\n" for entry in entries)
    return hashlib.sha256(lines.encode()).hexdigest()


def archive_of(entries: Sequence[Entry]) -> Iterator[bytes]:
    """The bytes of the archive, piece by piece.  Images are compressed already: stored as is."""
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_STORED) as archive:
        for entry in entries:
            info = zipfile.ZipInfo(entry.name, _DATE)
            info.external_attr = 0o100644 << 16
            with entry.path.open("rb") as source:
                info.file_size = entry.path.stat().st_size
                with archive.open(info, "w") as target:
                    while block := source.read(_CHUNK):
                        target.write(block)
                        yield pipe.taken()
    yield pipe.taken()


class _Pipe(io.RawIOBase):
    """What was written and not taken yet; cannot seek, so that the zip is written in one go."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._parts.append(bytes(data))
        return len(data)

    def taken(self) -> bytes:
        """What was written since the last call."""
        parts, self._parts = self._parts, []
        return b"".join(parts)
