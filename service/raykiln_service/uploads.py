"""Uploads that go on where a broken connection left them.

What has arrived of an upload is the length of its file, synced at the end of each piece; the table
holds what was announced.  So nothing can say that bytes are there which are not, whenever the
service dies.  A whole upload becomes an asset; only then its hash is known for certain.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from raykiln_service.access import LOCAL, Caller
from raykiln_service.assets import AssetStore, safe_filename
from raykiln_service.errors import (
    ChecksumError,
    GoneError,
    NotFoundError,
    TooLargeError,
    UploadConflictError,
)
from raykiln_service.files import sha256_of, sync_dir
from raykiln_service.upload_rows import Announced, UploadRows

CHECKSUMS = ("sha256", "sha1")
"""What a piece may be checked by; tus asks for SHA-1, which guards against accidents only."""


@dataclass(frozen=True, slots=True)
class ResumableUpload:
    """An upload as it is now.  Times are Unix milliseconds."""

    id: str
    owner: str | None
    length: int
    offset: int
    """Bytes that have arrived."""
    filename: str | None
    sha256: str | None
    """What the whole must hash to, in hex, if that was announced."""
    asset_id: str | None
    """The asset that it became."""
    created_ms: int
    expires_ms: int


@dataclass(frozen=True, slots=True)
class Checksum:
    """What a piece must hash to."""

    algorithm: str
    digest: bytes


def _owner_of(upload: ResumableUpload) -> Caller:
    # An admin may end the upload of a token, but the asset is the token's.
    return LOCAL if upload.owner is None else Caller(upload.owner, upload.owner, frozenset())


class Piece:
    """A part of an upload that is arriving; what came is kept, unless its checksum is wrong."""

    def __init__(self, file: BinaryIO, left: int, checksum: Checksum | None) -> None:
        self._file = file
        self._start = file.tell()
        self._left = left
        self._checksum = checksum
        self._hash = None if checksum is None else hashlib.new(checksum.algorithm)

    def write(self, chunk: bytes) -> None:
        """Take the next bytes; `TooLargeError` past the announced length."""
        if len(chunk) > self._left:
            raise TooLargeError(
                "the piece goes past the upload's length", accepted=f"{self._left} more bytes"
            )
        self._left -= len(chunk)
        self._file.write(chunk)
        if self._hash is not None:
            self._hash.update(chunk)

    def finish(self) -> None:
        """The piece is whole; `ChecksumError` if it is not what was announced."""
        if self._checksum is None or self._hash is None:
            return
        if not hmac.compare_digest(self._hash.digest(), self._checksum.digest):
            raise ChecksumError(found=f"{self._checksum.algorithm} {self._hash.hexdigest()}")
        self._checksum = None

    def settle(self) -> int:
        """Make what came durable; how many bytes of the upload are there now.

        Bytes that were to be checked and were not go away.
        """
        if self._checksum is not None:
            self._file.truncate(self._start)
            self._file.seek(self._start)
        self._file.flush()
        os.fsync(self._file.fileno())
        return self._file.tell()


class Uploads:
    """The uploads under way of one service.  All methods may be called from any thread."""

    def __init__(self, assets: AssetStore, expiry_s: float) -> None:
        self._assets = assets
        self._clock = assets.store.clock
        self._rows = UploadRows(assets.store.database)
        self._folder = assets.root / "uploads"
        self._expiry_ms = int(expiry_s * 1000)
        self._lock = threading.Lock()
        self._busy: set[str] = set()

    def prepare(self) -> None:
        """Make the folder, and drop what has expired or lost its row or its file."""
        self._folder.mkdir(exist_ok=True)
        self.prune()
        known = self._rows.ids()
        for path in self._folder.iterdir():
            if path.name not in known:
                path.unlink(missing_ok=True)

    def create(
        self, length: int, filename: str | None, sha256: str | None, caller: Caller = LOCAL
    ) -> ResumableUpload:
        """Begin an upload.

        Raises
        ------
        InvalidAssetError
            The file name is none.
        QuotaError
            The caller's uploads would come to too much.
        """
        name = None if filename is None else safe_filename(filename)
        upload_id = f"up-{secrets.token_hex(16)}"
        now = self._clock()
        expires = now + self._expiry_ms
        row = Announced(upload_id, caller.owner, length, name, sha256, None, now, expires)
        self._path(upload_id).touch(exist_ok=False)
        sync_dir(self._folder)
        try:
            self._rows.add(row, caller)
        except BaseException:
            self._path(upload_id).unlink(missing_ok=True)
            raise
        return self.get(upload_id, caller)

    def get(self, upload_id: str, caller: Caller = LOCAL) -> ResumableUpload:
        """One upload; `NotFoundError` if the caller has none of that id, `GoneError` if expired."""
        row = self._rows.get(upload_id)
        if row is None or not (caller.sees_all or row.owner == caller.owner):
            raise NotFoundError(f"there is no upload {upload_id!r}")
        found = self._upload_of(row)
        if found.asset_id is None and self._clock() >= found.expires_ms:
            raise GoneError(f"the upload {upload_id} has expired")
        return found

    def unfinished(self, sha256: str | None, caller: Caller = LOCAL) -> list[ResumableUpload]:
        """The caller's own uploads under way, the latest first; of these bytes, if so asked."""
        found = self._rows.unfinished(caller.owner, sha256, self._clock())
        return [self._upload_of(row) for row in found]

    @contextmanager
    def piece(
        self, upload: ResumableUpload, offset: int, checksum: Checksum | None
    ) -> Iterator[Piece]:
        """Take a piece that begins at `offset`; at the end, what came of it is durable.

        Raises
        ------
        UploadConflictError
            The upload does not go on there, or another request is writing to it.
        """
        with self._alone(upload.id), self._open(upload.id) as file:
            there = file.seek(0, os.SEEK_END)
            if offset != there:
                raise UploadConflictError(
                    found=str(offset), accepted=str(there), headers={"Upload-Offset": str(there)}
                )
            piece = Piece(file, upload.length - there, checksum)
            try:
                yield piece
            finally:
                piece.settle()
                self._touch(upload.id)

    def complete(self, upload: ResumableUpload, caller: Caller = LOCAL) -> ResumableUpload:
        """Make an asset of an upload that has wholly arrived; another one stays as it is.

        Raises
        ------
        ChecksumError
            It is not what was announced; the upload is dropped, for it can never be right.
        """
        with self._alone(upload.id):
            upload = self.get(upload.id, caller)
            if upload.asset_id is not None or upload.offset < upload.length:
                return upload
            path = self._path(upload.id)
            digest = sha256_of(path)
            if upload.sha256 is not None and digest != upload.sha256:
                self._drop(upload.id)
                raise ChecksumError(
                    "the whole upload does not match its checksum and was dropped",
                    found=digest,
                    accepted=upload.sha256,
                )
            owner = _owner_of(upload)
            asset = self._assets.keep_file(path, digest, upload.filename, owner, counted=True)
            self._rows.change(upload.id, asset_id=asset.id)
            path.unlink(missing_ok=True)
        return self.get(upload.id, caller)

    def remove(self, upload: ResumableUpload) -> None:
        """End an upload; an asset that it became stays."""
        with self._alone(upload.id):
            self._drop(upload.id)

    def prune(self) -> int:
        """Drop the uploads that have expired; how many there were."""
        dropped = 0
        for upload_id in self._rows.expired(self._clock()):
            with suppress(UploadConflictError), self._alone(upload_id):
                self._drop(upload_id)
                dropped += 1
        return dropped

    def _drop(self, upload_id: str) -> None:
        self._rows.delete(upload_id)
        self._path(upload_id).unlink(missing_ok=True)

    def _touch(self, upload_id: str) -> None:
        self._rows.change(upload_id, expires_ms=self._clock() + self._expiry_ms)

    def _path(self, upload_id: str) -> Path:
        return self._folder / upload_id

    def _open(self, upload_id: str) -> BinaryIO:
        try:
            return self._path(upload_id).open("r+b")
        except FileNotFoundError:
            raise UploadConflictError("the upload has ended") from None

    @contextmanager
    def _alone(self, upload_id: str) -> Iterator[None]:
        with self._lock:
            if upload_id in self._busy:
                raise UploadConflictError(
                    "another request is writing to this upload", headers={"Retry-After": "1"}
                )
            self._busy.add(upload_id)
        try:
            yield
        finally:
            with self._lock:
                self._busy.discard(upload_id)

    def _upload_of(self, row: Announced) -> ResumableUpload:
        try:
            offset = self._path(row.id).stat().st_size
        except FileNotFoundError:
            offset = row.length if row.asset_id is not None else 0
        return ResumableUpload(
            id=row.id,
            owner=row.owner,
            length=row.length,
            offset=row.length if row.asset_id is not None else offset,
            filename=row.filename,
            sha256=row.sha256,
            asset_id=row.asset_id,
            created_ms=row.created_ms,
            expires_ms=row.expires_ms,
        )
