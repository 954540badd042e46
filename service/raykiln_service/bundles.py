"""Zip bundles from strangers: looked over first, then unpacked into a read-only folder."""

from __future__ import annotations

import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from raykiln_service.errors import InvalidAssetError

_CHUNK = 1 << 20
# The longest record that one file of a bundle may take in the central directory, on average.
_RECORD_BYTES = 1024
_SMALL = 1 << 20
_MAX_DEPTH = 32


@dataclass(frozen=True, slots=True)
class BundleLimits:
    """What a bundle may unpack to."""

    total_bytes: int
    entries: int
    ratio: float


def is_zip(path: Path) -> bool:
    """Whether a file begins like a zip archive."""
    with path.open("rb") as file:
        return file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")


def unpack(archive: Path, folder: Path, limits: BundleLimits) -> None:
    """Unpack `archive` into the empty `folder`; `InvalidAssetError` names the first bad entry."""
    _check_directory_size(archive, limits)
    try:
        with zipfile.ZipFile(archive) as bundle:
            entries = list(_checked(bundle, limits, archive.stat().st_size))
            for info, name in entries:
                _extract(bundle, info, folder.joinpath(*name.parts))
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, ValueError) as error:
        raise InvalidAssetError(f"the zip bundle is damaged: {error}") from None
    except (NotImplementedError, RuntimeError) as error:
        raise InvalidAssetError(f"the zip bundle cannot be unpacked: {error}") from None
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise InvalidAssetError(
            f"the zip bundle has one name for a file and a folder: {_inside(error, folder)}"
        ) from None
    for path in sorted(folder.rglob("*"), reverse=True):
        path.chmod(0o555 if path.is_dir() else 0o444)


def _inside(error: OSError, folder: Path) -> str:
    return str(error.filename or "").removeprefix(f"{folder}/")


def _checked(
    bundle: zipfile.ZipFile, limits: BundleLimits, archive_bytes: int
) -> Iterator[tuple[zipfile.ZipInfo, PurePosixPath]]:
    infos = bundle.infolist()
    if len(infos) > limits.entries:
        raise InvalidAssetError(
            "the zip bundle has too many entries",
            found=str(len(infos)),
            accepted=f"at most {limits.entries}",
        )
    total = packed = 0
    seen = set()
    for info in infos:
        name = _checked_name(info)
        if info.is_dir():
            continue
        _check_entry(info, limits)
        total += info.file_size
        if total > limits.total_bytes:
            raise InvalidAssetError(
                "the zip bundle unpacks to too much",
                accepted=f"at most {limits.total_bytes} bytes",
            )
        packed += info.compress_size
        if packed > archive_bytes:
            # Entries that share their bytes make a bomb whose every part looks harmless.
            raise InvalidAssetError(
                "the zip bundle has entries that overlap", found=str(info.filename)
            )
        if name in seen:
            raise InvalidAssetError("the zip bundle has an entry twice", found=str(name))
        seen.add(name)
        yield info, name


def _checked_name(info: zipfile.ZipInfo) -> PurePosixPath:
    # What zipfile hands out ends at the first NUL.
    raw = info.orig_filename if "\0" in info.orig_filename else info.filename
    name = PurePosixPath(raw)
    parts = raw.rstrip("/").split("/")
    windows = "\\" in raw or parts[0][1:2] == ":"
    bad_part = any(p in ("", ".", "..") or len(p.encode()) > 255 for p in parts)
    if bad_part or windows or len(parts) > _MAX_DEPTH or not raw.isprintable():
        raise InvalidAssetError(
            "the zip bundle has an entry whose name is not accepted",
            found=repr(raw[:200]),
            accepted="relative paths with / and without . or .. parts",
        )
    return name


def _check_entry(info: zipfile.ZipInfo, limits: BundleLimits) -> None:
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG):
        raise InvalidAssetError(
            "the zip bundle has an entry that is not a plain file",
            found=info.filename,
            accepted="files and folders (no symbolic links)",
        )
    if info.flag_bits & 1:
        raise InvalidAssetError("the zip bundle is encrypted", found=info.filename)
    if info.file_size > _SMALL and info.file_size > limits.ratio * max(info.compress_size, 1):
        raise InvalidAssetError(
            "the zip bundle has an entry that unpacks to suspiciously much",
            found=f"{info.filename}: {info.compress_size} to {info.file_size} bytes",
            accepted=f"at most {limits.ratio:g} times its packed size",
        )


def _extract(bundle: zipfile.ZipFile, info: zipfile.ZipInfo, place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    left = info.file_size
    with bundle.open(info) as source, place.open("xb") as target:
        while chunk := source.read(_CHUNK):
            left -= len(chunk)
            if left < 0:
                raise InvalidAssetError(
                    "the zip bundle has an entry that is longer than it says", found=info.filename
                )
            target.write(chunk)


def _check_directory_size(archive: Path, limits: BundleLimits) -> None:
    # zipfile reads the whole central directory into memory before anything can be counted.
    size = archive.stat().st_size
    with archive.open("rb") as file:
        file.seek(max(0, size - (1 << 16) - 22))
        tail = file.read()
    end = tail.rfind(b"PK\x05\x06")
    if end < 0 or len(tail) < end + 22:
        raise InvalidAssetError("the zip bundle is damaged: it has no end record")
    directory_bytes = struct.unpack_from("<I", tail, end + 12)[0]
    if b"PK\x06\x07" in tail[max(0, end - 20) : end] and end >= 76:
        # Zip64: the end record that counts stands right before its locator.
        record = tail.rfind(b"PK\x06\x06", 0, end)
        if record < 0 or record + 56 > len(tail):
            raise InvalidAssetError("the zip bundle is damaged: its zip64 end record is missing")
        directory_bytes = struct.unpack_from("<Q", tail, record + 40)[0]
    if directory_bytes > limits.entries * _RECORD_BYTES:
        raise InvalidAssetError(
            "the zip bundle has too many entries", accepted=f"at most {limits.entries}"
        )
