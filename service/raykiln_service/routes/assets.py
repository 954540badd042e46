"""Uploads."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from typing import Annotated, Any
from urllib.parse import unquote

from fastapi import APIRouter, Header, Query, Request
from fastapi.concurrency import run_in_threadpool
from pydantic import ValidationError
from python_multipart.multipart import MultipartParser, parse_options_header

from raykiln_service.access import Caller
from raykiln_service.assets import Upload
from raykiln_service.errors import MalformedRequestError
from raykiln_service.routes.access import InCaller
from raykiln_service.routes.context import ERRORS, Context, InContext, read_json
from raykiln_service.routes.digests import sha256_of_digest
from raykiln_service.rows import Asset
from raykiln_service.schemas import AssetView, MissingRequest, MissingView, timestamp
from raykiln_service.submission import request_error_of

router = APIRouter(prefix="/v1/assets", tags=["assets"], responses=ERRORS)
_FILENAME_STAR = re.compile(r"filename\*=UTF-8''([^;\s]+)", re.IGNORECASE)
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_MISSING = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": MissingRequest.model_json_schema()}},
    }
}
_FORM = {
    "schema": {
        "type": "object",
        "properties": {"file": {"type": "string", "format": "binary"}},
        "required": ["file"],
    }
}


@router.post(
    "",
    status_code=201,
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/octet-stream": _BINARY, "multipart/form-data": _FORM},
        }
    },
)
async def upload_asset(
    request: Request,
    context: InContext,
    caller: InCaller,
    filename: Annotated[str | None, Query()] = None,
    repr_digest: Annotated[str | None, Header(alias="Repr-Digest")] = None,
    content_digest: Annotated[str | None, Header(alias="Content-Digest")] = None,
) -> AssetView:
    """Store a scene file or a zip bundle: the raw bytes, or the first file of a form.

    The file's name (`filename`, `Content-Disposition`, or the form's) says its format.  The same
    bytes are stored once.  With a SHA-256 in `Repr-Digest` (of the file) or `Content-Digest` (of
    a body that is the file), only those bytes are stored.
    """
    sha256 = sha256_of_digest(repr_digest, "Repr-Digest")
    if sha256 is None and not _is_form(request):
        sha256 = sha256_of_digest(content_digest, "Content-Digest")
    await run_in_threadpool(_check_room, request, context, caller, sha256)
    upload = await run_in_threadpool(
        context.assets.upload, context.settings.max_asset_bytes, caller
    )
    try:
        if _is_form(request):
            form = _FormFile(request.headers["content-type"])
            async for chunk in form.chunks(request.stream()):
                await run_in_threadpool(upload.write, chunk)
            name = filename or form.filename
        else:
            async for chunk in request.stream():
                await run_in_threadpool(upload.write, chunk)
            name = filename or _disposition_name(request.headers.get("content-disposition"))
        asset = await run_in_threadpool(_keep, context, upload, name, sha256)
    finally:
        await run_in_threadpool(upload.close)
    return asset_view(asset)


@router.post("/missing", openapi_extra=_MISSING)
async def missing_assets(request: Request, context: InContext, caller: InCaller) -> MissingView:
    """Which of these files would have to be uploaded: ask before sending what is there."""
    try:
        wanted = MissingRequest.model_validate(await read_json(request))
    except ValidationError as error:
        raise request_error_of(error, None) from None
    ids = [f"sha256:{text.removeprefix('sha256:')}" for text in wanted.ids]
    missing = await run_in_threadpool(context.store.missing_assets, ids, caller)
    return MissingView(missing=missing)


@router.head("/{asset_id}", include_in_schema=False)
@router.get("/{asset_id}")
def get_asset(asset_id: str, context: InContext, caller: InCaller) -> AssetView:
    """An upload that is there already need not be sent again."""
    return asset_view(context.store.asset(asset_id, caller))


def asset_view(asset: Asset) -> AssetView:
    """An asset as clients see it."""
    return AssetView(
        id=asset.id,
        size_bytes=asset.size_bytes,
        filename=asset.filename,
        created_at=timestamp(asset.created_ms),
    )


def _is_form(request: Request) -> bool:
    return request.headers.get("content-type", "").lower().startswith("multipart/form-data")


def _check_room(request: Request, context: Context, caller: Caller, sha256: str | None) -> None:
    # Refused before it is sent, where the hash tells that it is new to the caller; else after.
    length = request.headers.get("content-length", "")
    if sha256 is not None and length.isdigit() and not _is_form(request):
        context.store.check_room(caller, int(length), f"sha256:{sha256}")


def _keep(context: Context, upload: Upload, name: str | None, sha256: str | None) -> Asset:
    asset = upload.finish(name, sha256)
    context.metrics.uploaded.inc(asset.size_bytes)
    return asset


def _disposition_name(header: str | None) -> str | None:
    if header is None:
        return None
    if (star := _FILENAME_STAR.search(header)) is not None:
        return unquote(star.group(1))
    _kind, options = parse_options_header(header)
    name = options.get(b"filename")
    return None if name is None else name.decode("utf-8", errors="replace")


class _FormFile:
    """The first file of a form, passed on while it arrives."""

    def __init__(self, content_type: str) -> None:
        _kind, options = parse_options_header(content_type)
        boundary = options.get(b"boundary")
        if not boundary:
            raise MalformedRequestError("the form has no boundary")
        self.filename: str | None = None
        self._seen = False
        self._inside = False
        self._header = (b"", b"")
        self._ready: list[bytes] = []
        callbacks: Any = {
            "on_header_field": self._on_field,
            "on_header_value": self._on_value,
            "on_header_end": self._on_header,
            "on_part_data": self._on_data,
            "on_part_end": self._on_part_end,
        }
        self._parser = MultipartParser(boundary, callbacks)

    async def chunks(self, stream: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
        """The bytes of the file."""
        try:
            async for piece in stream:
                self._parser.write(piece)
                ready, self._ready = self._ready, []
                for chunk in ready:
                    yield chunk
            self._parser.finalize()
        except ValueError as error:
            raise MalformedRequestError(f"the form could not be read: {error}") from None
        if not self._seen:
            raise MalformedRequestError("the form has no file", accepted="a part with a filename")

    def _on_field(self, data: bytes, start: int, end: int) -> None:
        self._header = (self._header[0] + data[start:end], b"")

    def _on_value(self, data: bytes, start: int, end: int) -> None:
        self._header = (self._header[0], self._header[1] + data[start:end])

    def _on_header(self) -> None:
        name, value = self._header
        self._header = (b"", b"")
        if name.lower() == b"content-disposition" and not self._seen:
            # As a header's text comes: its bytes one by one, which are the UTF-8 of the name.
            filename = _disposition_name(value.decode("latin-1"))
            if filename is not None:
                self.filename, self._seen, self._inside = filename, True, True

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        if self._inside:
            self._ready.append(data[start:end])

    def _on_part_end(self) -> None:
        self._inside = False
