"""What is measured and traced of every request."""

from __future__ import annotations

import time

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from raykiln_service.metrics import Metrics
from raykiln_service.telemetry import Tracing

# Streams last as long as their readers like, and probes are of no interest.
_NOT_TIMED = ("/events",)
_NOT_TRACED = ("/events", "/metrics", "/healthz", "/readyz")
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class Observer:
    """Times and traces requests by their routes, of which there are few, not by their paths."""

    def __init__(self, app: ASGIApp, metrics: Metrics, tracing: Tracing) -> None:
        self._app = app
        self._metrics = metrics
        self._tracing = tracing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection, as ASGI has it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        status = 500

        async def observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        method = scope["method"] if scope["method"] in _METHODS else "other"
        try:
            if not self._tracing.is_on or scope["path"].endswith(_NOT_TRACED):
                await self._app(scope, receive, observed)
                return
            with self._tracing.request(method, Headers(scope=scope)) as trace:
                try:
                    await self._app(scope, receive, observed)
                finally:
                    trace.ended(_route_of(scope), status)
        finally:
            route = _route_of(scope)
            if not route.endswith(_NOT_TIMED):
                self._metrics.note_request(method, route, status, time.perf_counter() - began)


def _route_of(scope: Scope) -> str:
    return str(getattr(scope.get("route"), "path", "other"))
