"""What is looked at before a handler runs: who asks, from where, and how much they send."""

from __future__ import annotations

import asyncio
import hmac
import time
from urllib.parse import urlsplit

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from raykiln_service.access import LOCAL, NOBODY, STATIC, Caller
from raykiln_service.errors import (
    ForbiddenError,
    MalformedRequestError,
    RequestTimeoutError,
    ServiceError,
    TooLargeError,
    UnauthorizedError,
)
from raykiln_service.quotas import RateLimiter
from raykiln_service.routes.access import is_open
from raykiln_service.settings import ServiceSettings
from raykiln_service.tokens import TokenStore, is_well_formed

_MIN_BYTES_PER_S = 16_384
_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})
_MAX_TOKEN = 4096


def problem_reply(error: ServiceError) -> JSONResponse:
    """An error as the reply that clients see."""
    return JSONResponse(
        error.problem(),
        status_code=error.status,
        headers=error.headers,
        media_type="application/problem+json",
    )


class Guard:
    """Says who asks, and refuses requests from foreign pages, or too many, large or slow ones."""

    def __init__(self, app: ASGIApp, settings: ServiceSettings, tokens: TokenStore) -> None:
        self._app = app
        self._settings = settings
        self._tokens = tokens
        self._rates = RateLimiter()
        self._static = None if settings.token is None else settings.token.get_secret_value()
        self._hosts = _LOOPBACK_NAMES | set(settings.allowed_hosts) | {settings.host}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection, as ASGI has it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        limit = self._limit_bytes(scope["path"])
        try:
            if "\0" in scope["path"] or b"%00" in scope.get("query_string", b""):
                # No name has it, and not every database can even look for it.
                raise MalformedRequestError("the URL has a NUL character")
            caller = await self._caller(scope["path"], headers)
            self._rates.check(caller)
            if caller in (LOCAL, NOBODY):
                self._check_origin(headers)
            _check_length(headers, limit)
        except ServiceError as error:
            await problem_reply(error)(scope, receive, send)
            return
        scope.setdefault("state", {})["caller"] = caller
        body = _Body(receive, limit, self._settings.request_timeout_s)
        await self._app(scope, body.receive, send)

    def _limit_bytes(self, path: str) -> int:
        settings = self._settings
        # A form adds its own lines to the file in it; the upload counts the file's bytes.
        if path == "/v1/assets" or path.startswith("/v1/uploads"):
            return settings.max_asset_bytes + (1 << 16)
        return settings.max_json_bytes

    async def _caller(self, path: str, headers: Headers) -> Caller:
        given = headers.getlist("authorization")
        if not given or is_open(path):
            if not self._settings.asks_for_token:
                return LOCAL
            if is_open(path):
                return NOBODY
            raise UnauthorizedError
        scheme, _, text = given[0].partition(" ")
        text = text.strip()
        if len(given) > 1 or scheme.lower() != "bearer" or not 0 < len(text) <= _MAX_TOKEN:
            raise UnauthorizedError("the Authorization header is not 'Bearer TOKEN'")
        if self._static is not None and hmac.compare_digest(text.encode(), self._static.encode()):
            return STATIC
        # The checksum sorts out what cannot be a token before the database is asked.
        caller = self._tokens.recall(text)
        if caller is None and is_well_formed(text):
            caller = await run_in_threadpool(self._tokens.find, text)
        if caller is None:
            raise UnauthorizedError("the token is not known here, has expired or was revoked")
        return caller

    def _check_origin(self, headers: Headers) -> None:
        # Without a token a web page elsewhere must not reach a service on this machine, neither
        # by a name that it points here nor by a request across sites.
        if self._settings.asks_for_token or not self._settings.is_loopback:
            return
        host = headers.get("host", "")
        name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
        if name not in self._hosts:
            raise ForbiddenError(
                f"the service does not answer to the name {name[:100]!r}",
                accepted="localhost, 127.0.0.1, [::1], or a name of allowed_hosts",
            )
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            raise ForbiddenError("the request comes from a page of another site", found=origin)


def _check_length(headers: Headers, limit: int) -> None:
    length = headers.get("content-length", "")
    if length and "transfer-encoding" in headers:
        # A proxy before the service might take the other one for the body's end.
        raise MalformedRequestError(
            "the request has both Content-Length and Transfer-Encoding",
            headers={"Connection": "close"},
        )
    if length.isdigit() and int(length) > limit:
        raise TooLargeError(found=f"{length} bytes", accepted=f"at most {limit} bytes")


class _Body:
    """Counts and times a request's body while it arrives.

    A body may neither be silent for `timeout_s`, nor take longer than that in all but for the
    time that its length allows at `_MIN_BYTES_PER_S`.
    """

    def __init__(self, receive: Receive, limit: int, timeout_s: float) -> None:
        self._receive = receive
        self._left = limit
        self._limit = limit
        self._timeout_s = timeout_s
        self._complete = False
        self._deadline = time.monotonic() + timeout_s

    async def receive(self) -> Message:
        """The next message of the connection."""
        if self._complete:
            return await self._receive()
        try:
            left_s = max(0.0, self._deadline - time.monotonic())
            message = await asyncio.wait_for(self._receive(), min(left_s, self._timeout_s))
        except TimeoutError:
            raise RequestTimeoutError(
                f"a body must not be silent for {self._timeout_s:g} s, and one that takes longer "
                f"must come with at least {_MIN_BYTES_PER_S} bytes a second",
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.request":
            size = len(message.get("body", b""))
            self._left -= size
            self._deadline += size / _MIN_BYTES_PER_S
            self._complete = not message.get("more_body", False)
            if self._left < 0:
                raise TooLargeError(accepted=f"at most {self._limit} bytes")
        return message
