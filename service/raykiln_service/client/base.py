"""What the blocking and the asynchronous client share."""

from __future__ import annotations

import os
from typing import Any

import httpx

from raykiln_service.client import calls
from raykiln_service.client.calls import DEFAULT_SERVER, Call, Reconnects, RetryPolicy
from raykiln_service.client.models import ServerError, ServerUnreachableError

CHUNK_BYTES = 1 << 20


class ClientBase:
    """What both clients know: the address, the token, the limits."""

    def __init__(
        self,
        server: str | None = None,
        token: str | None = None,
        *,
        timeout_s: float = 30.0,
        retries: int = 3,
    ) -> None:
        chosen = server or os.environ.get("RAYKILN_SERVER") or DEFAULT_SERVER
        self.server = calls.check_server(chosen)
        self._policy = RetryPolicy(retries)
        self._options: dict[str, Any] = {
            "base_url": self.server,
            "headers": calls.request_headers(token or os.environ.get("RAYKILN_TOKEN")),
            "timeout": httpx.Timeout(timeout_s, connect=min(timeout_s, 5.0)),
        }

    def _arguments(self, call: Call, content: Any = None) -> dict[str, Any]:
        arguments: dict[str, Any] = {
            "method": call.method,
            "url": call.path,
            "params": dict(call.params),
            "headers": dict(call.headers),
        }
        if call.json is not None:
            arguments["json"] = call.json
        if content is not None:
            arguments["content"] = content
        if call.timeout_s is not None:
            arguments["timeout"] = call.timeout_s
        return arguments

    def _pause_s(self, tried: int, error: Exception, call: Call) -> float:
        """The pause before the next try; raises what the caller is to see if there is none."""
        pause_s = self._policy.pause_s(tried, error, call)
        if pause_s is not None:
            return pause_s
        if isinstance(error, httpx.TransportError):
            raise calls.unreachable(self.server, error) from error
        raise error

    def _document(self, response: httpx.Response) -> Any:
        try:
            return response.json()
        except ValueError:
            kind = response.headers.get("content-type", "no content")
            raise ServerUnreachableError(
                f"no raykiln service answers at {self.server} (found {kind})"
            ) from None

    def _reconnect_pause_s(self, reconnects: Reconnects, error: Exception | None) -> float:
        """The pause before an event stream is taken up again; raises if it is not to be."""
        pause_s = reconnects.pause_s(error)
        if pause_s is not None:
            return pause_s
        if isinstance(error, ServerError):
            raise error
        raise calls.unreachable(self.server, error or ConnectionError("the stream ended"))
