"""Uploading a file: not at all if it is there, else in pieces that outlive broken connections.

`upload_steps` says what to do next and is told what came of it, so that the blocking and the
asynchronous client share it.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import httpx

from raykiln_service.client.calls import RETRY_STATUS, Call, RetryPolicy, problem_of
from raykiln_service.client.models import Asset, ClientError, ServerError

SMALL_BYTES = 1 << 20
"""Smaller files are sent in one call without asking first."""
_TUS = {"Tus-Resumable": "1.0.0"}
_PIECE = "application/offset+octet-stream"
# The upload goes on elsewhere than thought, another request holds it, or it came too slowly.
_GOES_ON = RETRY_STATUS | {408, 409, 460}


@dataclass(frozen=True)
class Step:
    """One call; with `start`, the bytes of the file from there on are its body."""

    call: Call
    start: int | None = None
    pause_s: float = 0.0
    may_fail: bool = False
    """A refusal or a broken connection is an answer, not the end."""


Answer = httpx.Response | Exception
Steps = Generator[Step, Answer, Asset]


def upload_steps(path: Path, filename: str, policy: RetryPolicy) -> Steps:
    """What to do to have a file on the service; ends with its asset."""
    size = path.stat().st_size
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    known = yield from _known(digest, filename)
    if known is not None:
        return known
    place, offset = yield from _place(digest, size, filename)
    tried = 0
    while True:
        answer = yield _piece(place, offset, size)
        if isinstance(answer, httpx.Response):
            if asset_id := answer.headers.get("Raykiln-Asset"):
                return _asset_in((yield Step(Call("GET", f"/v1/assets/{asset_id}"))))
            answer = ClientError(f"{path}: the file changed while it was sent")
        tried += 1
        pause_s = _pause_s(answer, tried, policy)
        head = yield Step(Call("HEAD", place, headers=_TUS), None, pause_s, may_fail=True)
        if isinstance(head, httpx.Response):
            reached = int(head.headers.get("Upload-Offset", offset))
            # What moves on may be broken off as often as it likes.
            tried, offset = (0 if reached > offset else tried), reached
        elif isinstance(head, ServerError) and head.status in (404, 410):
            place, offset = yield from _place(digest, size, filename)


def answer_of(response: httpx.Response, server: str) -> Answer:
    """A reply, or the error that it stands for."""
    if not response.is_error:
        return response
    if response.request.method == "HEAD":
        # Such a reply has no body to tell more.
        return ServerError(response.status_code, {"title": f"HTTP status {response.status_code}"})
    return problem_of(response, server)


def _known(digest: str, filename: str) -> Generator[Step, Answer, Asset | None]:
    call = Call("POST", "/v1/assets/missing", json={"ids": [f"sha256:{digest}"]})
    if _document((yield Step(call)))["missing"]:
        return None
    asset = _asset_in((yield Step(Call("GET", f"/v1/assets/sha256:{digest}"))))
    # The name says the format: with another one the bytes are sent again, and the name with them.
    same = PurePath(asset.filename or "").suffix == PurePath(filename).suffix
    return asset if same else None


def _place(digest: str, size: int, filename: str) -> Generator[Step, Answer, tuple[str, int]]:
    """Where to send the bytes: an upload that was broken off, or a new one."""
    listing = Call("GET", "/v1/uploads", params={"sha256": digest})
    for item in _document((yield Step(listing)))["items"]:
        if item["length"] == size and item["filename"] == filename:
            head = yield Step(Call("HEAD", item["href"], headers=_TUS), may_fail=True)
            if isinstance(head, httpx.Response):
                return item["href"], int(head.headers["Upload-Offset"])
    values = {"filename": filename.encode(), "sha256": digest.encode()}
    pairs = (f"{name} {base64.b64encode(value).decode()}" for name, value in values.items())
    headers = {**_TUS, "Upload-Length": str(size), "Upload-Metadata": ",".join(pairs)}
    created = yield Step(Call("POST", "/v1/uploads", headers=headers))
    assert isinstance(created, httpx.Response)
    return created.headers["Location"], 0


def _piece(place: str, offset: int, size: int) -> Step:
    headers = {
        **_TUS,
        "Upload-Offset": str(offset),
        "Content-Type": _PIECE,
        "Content-Length": str(size - offset),
    }
    return Step(Call("PATCH", place, headers=headers), offset, may_fail=True)


def _pause_s(error: Exception, tried: int, policy: RetryPolicy) -> float:
    """The pause before asking how far it came; raises the error if that is of no use."""
    if isinstance(error, ServerError) and error.status not in _GOES_ON:
        raise error
    if not isinstance(error, ServerError | httpx.TransportError) or tried > policy.retries:
        raise error
    return min(policy.longest_s, policy.first_s * float(2 ** (tried - 1)))


def _document(answer: Answer) -> Mapping[str, Any]:
    assert isinstance(answer, httpx.Response)
    document: Mapping[str, Any] = answer.json()
    return document


def _asset_in(answer: Answer) -> Asset:
    return Asset.model_validate(_document(answer))
