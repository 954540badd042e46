"""Resumable uploads, by the tus protocol 1.0 (https://tus.io), which clients everywhere speak."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager, suppress
from datetime import UTC, datetime
from email.utils import format_datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from raykiln_service.errors import (
    InvalidAssetError,
    MalformedRequestError,
    MediaTypeError,
    ProtocolVersionError,
    TooLargeError,
    UploadConflictError,
)
from raykiln_service.routes.access import InCaller
from raykiln_service.routes.context import ERRORS, Context, InContext
from raykiln_service.routes.digests import (
    decoded,
    piece_checksum,
    sha256_in_hex,
    sha256_of_digest,
)
from raykiln_service.schemas import UploadListView, UploadView, timestamp
from raykiln_service.uploads import CHECKSUMS, Checksum, Piece, ResumableUpload

VERSION = "1.0.0"
_EXTENSIONS = "creation,creation-with-upload,expiration,checksum,termination"
_MEDIA_TYPE = "application/offset+octet-stream"
_NUMBER = re.compile(r"\d{1,18}")
_BASE = "/v1/uploads"
router = APIRouter(prefix=_BASE, tags=["uploads"], responses=ERRORS)

Version = Annotated[str, Header(alias="Tus-Resumable")]
Length = Annotated[str | None, Header(alias="Upload-Length")]
Offset = Annotated[str | None, Header(alias="Upload-Offset")]
PieceChecksum = Annotated[str | None, Header(alias="Upload-Checksum")]
Metadata = Annotated[str | None, Header(alias="Upload-Metadata")]
Digest = Annotated[str | None, Header(alias="Repr-Digest")]
_BYTES = {"schema": {"type": "string", "format": "binary"}}
_PIECE: dict[str, Any] = {"requestBody": {"required": False, "content": {_MEDIA_TYPE: _BYTES}}}


@router.options("", status_code=204, response_class=Response)
@router.options("/{upload_id}", status_code=204, response_class=Response, include_in_schema=False)
def describe_uploads(context: InContext) -> Response:
    """What this service can do of tus."""
    return Response(
        status_code=204,
        headers={
            "Tus-Resumable": VERSION,
            "Tus-Version": VERSION,
            "Tus-Extension": _EXTENSIONS,
            "Tus-Max-Size": str(context.settings.max_asset_bytes),
            "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
        },
    )


@router.post("", status_code=201, response_class=Response, openapi_extra=_PIECE)
async def create_upload(
    request: Request,
    context: InContext,
    caller: InCaller,
    tus_resumable: Version = "",
    upload_length: Length = None,
    upload_metadata: Metadata = None,
    upload_checksum: PieceChecksum = None,
    repr_digest: Digest = None,
) -> Response:
    """Begin an upload of `Upload-Length` bytes; a first piece may come along.

    `Upload-Metadata` may give `filename` and `sha256` (in hex); the hash may also come as
    `Repr-Digest`.  The upload is only kept if its bytes have this hash.
    """
    _check_version(tus_resumable)
    limit = context.settings.max_asset_bytes
    length = _number(upload_length, "Upload-Length")
    if length == 0:
        raise InvalidAssetError("the upload is empty", accepted="a file of at least one byte")
    if length > limit:
        raise TooLargeError("the upload is too large", accepted=f"at most {limit} bytes")
    filename, sha256 = _metadata(upload_metadata)
    sha256 = sha256_of_digest(repr_digest, "Repr-Digest") or sha256
    checksum = piece_checksum(upload_checksum)
    await run_in_threadpool(context.uploads.prune)
    upload = await run_in_threadpool(context.uploads.create, length, filename, sha256, caller)
    if _has_body(request):
        upload = await _receive(request, context, upload, 0, checksum)
    return _reply(201, upload, {"Location": f"{_BASE}/{upload.id}"})


@router.get("")
def list_uploads(
    context: InContext, caller: InCaller, sha256: Annotated[str | None, Query()] = None
) -> UploadListView:
    """One's own unfinished uploads, the latest first; of a file, if its hash is given in hex."""
    wanted = None if sha256 is None else sha256_in_hex(sha256, "?sha256")
    found = context.uploads.unfinished(wanted, caller)
    return UploadListView(items=[_view(upload) for upload in found])


@router.head("/{upload_id}", response_class=Response)
async def head_upload(
    upload_id: str, context: InContext, caller: InCaller, tus_resumable: Version = ""
) -> Response:
    """How much has arrived: `Upload-Offset` of `Upload-Length`.

    A connection that still writes to the upload is ended first, so that the number stays true.
    """
    _check_version(tus_resumable)
    upload = await run_in_threadpool(context.uploads.get, upload_id, caller)
    await _interrupt(upload_id)
    upload = await run_in_threadpool(context.uploads.get, upload_id, caller)
    if upload.offset == upload.length:
        # Killed between the last byte and the asset; or another request is at it right now.
        with suppress(UploadConflictError):
            upload = await run_in_threadpool(context.uploads.complete, upload, caller)
    return _reply(200, upload, {"Upload-Length": str(upload.length), "Cache-Control": "no-store"})


@router.get("/{upload_id}")
def get_upload(upload_id: str, context: InContext, caller: InCaller) -> UploadView:
    """An upload as it is now, without touching it."""
    return _view(context.uploads.get(upload_id, caller))


@router.patch("/{upload_id}", status_code=204, response_class=Response, openapi_extra=_PIECE)
async def continue_upload(
    upload_id: str,
    request: Request,
    context: InContext,
    caller: InCaller,
    tus_resumable: Version = "",
    upload_offset: Offset = None,
    upload_checksum: PieceChecksum = None,
) -> Response:
    """Send the next piece; what arrives of it is kept even if the connection breaks.

    When the last piece is there, `Raykiln-Asset` names the asset.  A piece with an
    `Upload-Checksum` (`sha256 BASE64`) counts only as a whole, and only if it matches.
    """
    _check_version(tus_resumable)
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind != _MEDIA_TYPE:
        raise MediaTypeError(found=kind[:100], accepted=_MEDIA_TYPE)
    offset = _number(upload_offset, "Upload-Offset")
    checksum = piece_checksum(upload_checksum)
    upload = await run_in_threadpool(context.uploads.get, upload_id, caller)
    if upload.asset_id is not None:
        raise UploadConflictError("the upload is complete", found=str(offset))
    await _interrupt(upload_id)
    return _reply(204, await _receive(request, context, upload, offset, checksum))


@router.delete("/{upload_id}", status_code=204, response_class=Response)
async def end_upload(
    upload_id: str, context: InContext, caller: InCaller, tus_resumable: Version = ""
) -> Response:
    """Drop an upload; the asset of a complete one stays."""
    _check_version(tus_resumable)
    upload = await run_in_threadpool(context.uploads.get, upload_id, caller)
    await _interrupt(upload_id)
    await run_in_threadpool(context.uploads.remove, upload)
    return Response(status_code=204, headers={"Tus-Resumable": VERSION})


class _Transfer:
    """A request that writes to an upload, until it is told to stop."""

    def __init__(self) -> None:
        self.stop = asyncio.Event()
        self.done = asyncio.Event()

    async def chunks(self, request: Request) -> AsyncIterator[bytes]:
        """The request's body; `UploadConflictError` when told to stop."""
        stream = aiter(request.stream())
        stop = asyncio.ensure_future(self.stop.wait())
        try:
            while True:
                chunk = asyncio.ensure_future(anext(stream, None))
                await asyncio.wait({chunk, stop}, return_when=asyncio.FIRST_COMPLETED)
                if stop.done():
                    chunk.cancel()
                    await asyncio.wait({chunk})
                    raise UploadConflictError("another request has taken over this upload")
                if (data := chunk.result()) is None:
                    return
                yield data
        finally:
            stop.cancel()


# Those of this process, by upload.  A client that comes back must not have to wait until the
# service notices that the connection before is dead.
_TRANSFERS: dict[str, _Transfer] = {}


async def _interrupt(upload_id: str) -> None:
    while (transfer := _TRANSFERS.get(upload_id)) is not None:
        transfer.stop.set()
        await transfer.done.wait()


async def _receive(
    request: Request,
    context: Context,
    upload: ResumableUpload,
    offset: int,
    checksum: Checksum | None,
) -> ResumableUpload:
    transfer = _TRANSFERS[upload.id] = _Transfer()
    try:
        place = context.uploads.piece(upload, offset, checksum)
        async with _in_threads(place) as piece:
            async for chunk in transfer.chunks(request):
                await run_in_threadpool(piece.write, chunk)
            await run_in_threadpool(piece.finish)
        done = await run_in_threadpool(context.uploads.complete, upload)
    finally:
        del _TRANSFERS[upload.id]
        transfer.done.set()
    if done.asset_id is not None:
        context.metrics.uploaded.inc(done.length)
    return done


@asynccontextmanager
async def _in_threads(place: AbstractContextManager[Piece]) -> AsyncIterator[Piece]:
    """A piece that is begun and settled without keeping the event loop waiting for the disk."""
    piece = await run_in_threadpool(place.__enter__)
    try:
        yield piece
    finally:
        await run_in_threadpool(place.__exit__, None, None, None)


def _check_version(given: str) -> None:
    if given != VERSION:
        raise ProtocolVersionError(
            "the Tus-Resumable header is missing"
            if not given
            else "this version of tus is not spoken here",
            found=given[:100] or None,
            accepted=VERSION,
            headers={"Tus-Version": VERSION},
        )


def _number(text: str | None, header: str) -> int:
    if text is None or _NUMBER.fullmatch(text) is None:
        raise MalformedRequestError(
            f"{header}: not a number of bytes" if text else f"the {header} header is missing",
            found=None if text is None else text[:100],
            accepted="digits",
        )
    return int(text)


def _metadata(header: str | None) -> tuple[str | None, str | None]:
    """The file name and the SHA-256 of the whole."""
    values: dict[str, bytes] = {}
    for item in (header or "").split(","):
        key, _, text = item.strip().partition(" ")
        if key:
            values[key] = decoded(text.strip(), f"Upload-Metadata {key[:50]}")
    name = values.get("filename", values.get("name"))
    digest = values.get("sha256")
    return (
        None if name is None else name.decode("utf-8", errors="replace"),
        None if digest is None else sha256_in_hex(digest.decode("latin-1"), "Upload-Metadata"),
    )


def _has_body(request: Request) -> bool:
    if request.headers.get("content-length", "0") == "0" and (
        "transfer-encoding" not in request.headers
    ):
        return False
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind != _MEDIA_TYPE:
        raise MediaTypeError(found=kind[:100], accepted=_MEDIA_TYPE)
    return True


def _reply(status: int, upload: ResumableUpload, further: dict[str, str] | None = None) -> Response:
    expires = datetime.fromtimestamp(upload.expires_ms // 1000, UTC)
    headers = {
        "Tus-Resumable": VERSION,
        "Upload-Offset": str(upload.offset),
        "Upload-Expires": format_datetime(expires, usegmt=True),
        **(further or {}),
    }
    if upload.asset_id is not None:
        headers["Raykiln-Asset"] = upload.asset_id
    return Response(status_code=status, headers=headers)


def _view(upload: ResumableUpload) -> UploadView:
    return UploadView(
        id=upload.id,
        href=f"{_BASE}/{upload.id}",
        length=upload.length,
        offset=upload.offset,
        filename=upload.filename,
        sha256=upload.sha256,
        asset=upload.asset_id,
        created_at=timestamp(upload.created_ms),
        expires_at=timestamp(upload.expires_ms),
    )
