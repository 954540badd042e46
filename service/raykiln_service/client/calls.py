"""The calls of the HTTP API as values, and the rules that both clients follow."""

from __future__ import annotations

import email.utils
import random
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx

from raykiln_service.client.models import (
    Event,
    ServerError,
    ServerUnreachableError,
    is_final,
)

DEFAULT_SERVER = "http://127.0.0.1:8000"
RETRY_STATUS = frozenset({429, 502, 503, 504})
MAX_RETRY_AFTER_S = 30.0
_IN_FLIGHT = "urn:raykiln:problem:idempotency-in-flight"
READ_TIMEOUT_S = 60.0
"""An event stream that is silent for longer is taken up anew."""


@dataclass(frozen=True)
class Call:
    """One request; `repeatable` says that sending it twice does no harm."""

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    repeatable: bool = True
    timeout_s: float | None = None


@dataclass(frozen=True)
class RetryPolicy:
    """How often, and after what pause, a call is tried again."""

    retries: int = 3
    first_s: float = 0.1
    longest_s: float = 5.0

    def pause_s(self, tried: int, error: Exception, call: Call) -> float | None:
        """The pause before the next try after `tried` of them, or None to give up."""
        if tried > self.retries or not may_retry(error, call):
            return None
        backoff = min(self.longest_s, self.first_s * float(2 ** (tried - 1)))
        asked = error.retry_after_s if isinstance(error, ServerError) else None
        if asked is not None:
            return asked if asked <= MAX_RETRY_AFTER_S else None
        return float(backoff * random.uniform(0.75, 1.25))


def may_retry(error: Exception, call: Call) -> bool:
    """Whether `call` can be sent again after `error`."""
    if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
        return True
    if isinstance(error, ServerError):
        # The first try of this very request may still be under way.
        in_flight = error.problem.get("type") == _IN_FLIGHT
        return call.repeatable and (error.status in RETRY_STATUS or in_flight)
    return call.repeatable and isinstance(error, httpx.TransportError)


def frames_call(job_id: str, state: str | None, cursor: str | None) -> Call:
    """One page of the frames of a job."""
    given = {"state": state, "limit": 1000, "cursor": cursor}
    params = {name: value for name, value in given.items() if value is not None}
    return Call("GET", job_path(job_id) + "/frames", params=params)


def output_call(
    job_id: str, name: str, exposure: float | None, view: str | None, frame: int | None = None
) -> Call:
    """One output file, of the job or of a frame of it."""
    given = {"exposure": exposure, "view": view}
    params = {key: value for key, value in given.items() if value is not None}
    place = "outputs" if frame is None else f"frames/{frame}"
    return Call("GET", f"{job_path(job_id)}/{place}/{quote(name, safe='')}", params=params)


def archive_call(job_id: str) -> Call:
    """All outputs as one zip."""
    return Call("GET", job_path(job_id) + "/outputs.zip")


def preview_call(job_id: str) -> Call:
    """The image so far, as PNG."""
    return Call("GET", job_path(job_id) + "/preview.png")


def events_call(job_id: str, last_event_id: str | None) -> Call:
    """The event stream of a job."""
    headers = {"Accept": "text/event-stream"}
    if last_event_id is not None:
        headers["Last-Event-ID"] = last_event_id
    return Call("GET", job_path(job_id) + "/events", headers=headers)


def upload_call(path: Path, filename: str) -> Call:
    """Upload one file; its bytes go along separately. The same bytes are stored once."""
    kind = "application/zip" if path.suffix == ".zip" else "application/octet-stream"
    headers = {"Content-Type": kind, "Content-Length": str(path.stat().st_size)}
    return Call("POST", "/v1/assets", params={"filename": filename}, headers=headers)


def job_path(job_id: str) -> str:
    """Where a job is."""
    return "/v1/jobs/" + quote(job_id, safe="")


def check_server(server: str) -> str:
    """The base URL without its last slash; `ServerUnreachableError` if it is no http URL."""
    try:
        url = httpx.URL(server)
    except httpx.InvalidURL as error:
        raise ServerUnreachableError(f"{server}: not a URL: {error}") from None
    if url.scheme not in ("http", "https") or not url.host:
        raise ServerUnreachableError(
            f"{server}: not the URL of a service; accepted: http://HOST:PORT or https://HOST"
        )
    return server.rstrip("/")


def request_headers(token: str | None) -> dict[str, str]:
    """What every request carries."""
    headers = {"User-Agent": "raykiln-client"}
    if token:
        headers["Authorization"] = f"Bearer {token}"
    return headers


def problem_of(response: httpx.Response, server: str) -> Exception:
    """The error that a reply of 4xx or 5xx stands for; its body must have been read."""
    try:
        problem = response.json()
    except ValueError:
        problem = None
    if not isinstance(problem, dict):
        if response.status_code in RETRY_STATUS:
            problem = {"title": f"HTTP status {response.status_code}"}
        else:
            kind = response.headers.get("content-type", "no content")
            return ServerUnreachableError(
                f"no raykiln service answers at {server} (found status {response.status_code}, "
                f"{kind})"
            )
    return ServerError(response.status_code, problem, _retry_after_s(response))


def unreachable(server: str, error: Exception) -> ServerUnreachableError:
    """The error for a connection that could not be made or broke."""
    reason = str(error) or type(error).__name__
    return ServerUnreachableError(f"no raykiln service answers at {server} ({reason})")


def _retry_after_s(response: httpx.Response) -> float | None:
    text = response.headers.get("Retry-After", "").strip()
    if text.isdigit():
        return float(text)
    try:
        moment: float = email.utils.parsedate_to_datetime(text).timestamp()
        return max(0.0, moment - time.time())
    except (ValueError, TypeError):
        return None


def ends_stream(event: Event) -> bool:
    """Whether an event tells that its job has ended."""
    return (
        event.type == "state"
        and isinstance(event.data, dict)
        and is_final(str(event.data.get("state")))
    )


class Reconnects:
    """Decides how long a lost event stream is taken up again."""

    def __init__(self, patience_s: float, timeout_s: float | None) -> None:
        self._patience_s = patience_s
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s
        self._last_heard = time.monotonic()
        self._tries = 0

    def heard(self) -> None:
        """The service sent something."""
        self._last_heard = time.monotonic()
        self._tries = 0

    def timeout(self) -> httpx.Timeout:
        """Limits for the next connection; `TimeoutError` if there is no time left."""
        self.check()
        left = READ_TIMEOUT_S
        if self._deadline is not None:
            left = min(left, max(0.01, self._deadline - time.monotonic()))
        return httpx.Timeout(10.0, read=left)

    def check(self) -> None:
        """Raise `TimeoutError` once the time is over."""
        if self._deadline is not None and time.monotonic() >= self._deadline:
            raise TimeoutError("the job did not end in time")

    def pause_s(self, error: Exception | None) -> float | None:
        """The pause before the next connection; None to give up."""
        self.check()
        if isinstance(error, ServerError) and error.status not in RETRY_STATUS:
            return None
        if time.monotonic() - self._last_heard > self._patience_s:
            return None
        self._tries += 1
        return min(2.0, 0.1 * 2.0 ** min(self._tries, 8))
