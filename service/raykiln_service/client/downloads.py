"""Receiving one file: whole or not at all, going on where a broken connection left it."""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx

from raykiln_service.client.models import ClientError
from raykiln_service.files import sync_dir


class Download:
    """A file that is being received beside its final place."""

    def __init__(self, path: Path) -> None:
        if path.exists() and not path.is_file():
            # Taking the name of a device or a pipe would remove it for everybody.
            raise ClientError(f"{path}: is not a regular file")
        self._path = path
        self._temp = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
        self._file = self._temp.open("xb")
        self._etag: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        self._temp.unlink(missing_ok=True)

    def headers(self) -> dict[str, str]:
        """What to ask for: the rest, if a part of the same file is here."""
        size = self._file.tell()
        # A compressed transfer would count other bytes than those of the file.
        headers = {"Accept-Encoding": "identity"}
        if size > 0 and self._etag is not None:
            headers |= {"Range": f"bytes={size}-", "If-Range": self._etag}
        return headers

    def start(self, response: httpx.Response) -> None:
        """Take up the body of `response`: the rest after what is here, or the whole anew."""
        etag = response.headers.get("ETag")
        size = self._file.tell()
        if response.status_code != httpx.codes.PARTIAL_CONTENT:
            self._file.seek(0)
            self._file.truncate()
        elif not response.headers.get("Content-Range", "").startswith(f"bytes {size}-"):
            raise ClientError(f"{self._path}: the service sent another part than asked for")
        # A weak tag does not promise the same bytes, so it cannot join two parts.
        self._etag = etag if etag and not etag.startswith("W/") else None

    def write(self, block: bytes) -> None:
        """Append received bytes."""
        self._file.write(block)

    def finish(self) -> Path:
        """Put the whole file into its place."""
        self._file.flush()
        os.fsync(self._file.fileno())
        os.replace(self._temp, self._path)
        sync_dir(self._path.parent)
        return self._path
