"""uvicorn's HTTP/1.1 protocol with an end to its patience, and to how many it serves at once.

A thousand requests that come in one moment would be begun in one turn of the event loop, and
whoever asks for the service's health would wait for all of them.  So each turn begins a few, the
others wait in line, and questions of health pass the line.
"""

from __future__ import annotations

import asyncio
import json
import resource
from collections import deque
from typing import Any, ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from raykiln_service.errors import UnavailableError

_OWN_FILES = 512
"""Files and pipes of the service itself: database, renders, uploads."""
_BEGUN_PER_TURN = 8
_MOST_HELD = 1 << 16
_PROBES = tuple(
    f"{method} {path}{end}".encode()
    for method in ("GET", "HEAD")
    for path in ("/healthz", "/readyz")
    for end in " ?"
)


class Line:
    """The connections whose requests wait to be begun."""

    def __init__(self) -> None:
        self._waiting: deque[PatientProtocol] = deque()
        self._begun = 0
        self._turns = False

    def has_room(self, loop: asyncio.AbstractEventLoop) -> bool:
        """Whether a request may begin in this turn of the event loop; counts it if so."""
        if not self._turns:
            self._turns = True
            loop.call_soon(self._turn, loop)
        if self._waiting or self._begun >= _BEGUN_PER_TURN:
            return False
        self._begun += 1
        return True

    def append(self, connection: PatientProtocol) -> None:
        """Let a connection wait for its turn; only after `has_room` said no."""
        self._waiting.append(connection)

    def _turn(self, loop: asyncio.AbstractEventLoop) -> None:
        self._begun = 0
        while self._waiting and self._begun < _BEGUN_PER_TURN:
            self._begun += 1
            self._waiting.popleft().begin()
        self._turns = self._begun > 0
        if self._turns:
            loop.call_soon(self._turn, loop)


class PatientProtocol(H11Protocol):
    """Closes a connection whose head takes too long, or that does not read what it asked for.

    uvicorn itself waits for ever, so that a few slow clients could hold all its connections.
    """

    patience_s = 30.0
    max_connections = 4096
    _head_timer: asyncio.TimerHandle | None = None
    _read_timer: asyncio.TimerHandle | None = None
    _unread = 0
    _is_counted = False
    _held = b""
    # Of all connections of the service, which has one event loop.
    _count: ClassVar[list[int]] = [0]
    _line: ClassVar[Line] = Line()

    def connection_made(self, transport: Any) -> None:
        """A client has connected."""
        super().connection_made(transport)
        if self._count[0] >= self.max_connections:
            transport.write(_TOO_MANY)
            transport.close()
            return
        self._count[0] += 1
        self._is_counted = True
        self._expect_head()

    def data_received(self, data: bytes) -> None:
        """Bytes have come."""
        if self._held:
            self._held += data
            if len(self._held) > _MOST_HELD:
                self.transport.pause_reading()
            return
        is_new = self.conn.their_state is h11.IDLE and not data.startswith(_PROBES)
        if is_new and not self._line.has_room(self.loop):
            self._held = data
            self._drop_timer()
            self._line.append(self)
            return
        self._take(data)

    def begin(self) -> None:
        """Its turn has come."""
        held, self._held = self._held, b""
        if len(held) > _MOST_HELD:
            self.transport.resume_reading()
        self._take(held)

    def _take(self, data: bytes) -> None:
        if self.transport.is_closing():
            return
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._drop_timer()
        elif self._head_timer is None and self.conn.trailing_data[0]:
            # The first part of a further request on a kept connection.
            self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._drop_timer()
        self._stop_watching()
        if self._is_counted:
            self._count[0] -= 1
            self._is_counted = False
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The client does not keep up with what it is sent."""
        super().pause_writing()
        self._unread = self.transport.get_write_buffer_size()
        self._read_timer = self.loop.call_later(self.patience_s, self._check_reading)

    def resume_writing(self) -> None:
        """It does again."""
        self._stop_watching()
        super().resume_writing()

    def _check_reading(self) -> None:
        unread = self.transport.get_write_buffer_size()
        if unread >= self._unread:
            # Nothing was taken all this time.
            self.transport.abort()
            return
        self._unread = unread
        self._read_timer = self.loop.call_later(self.patience_s, self._check_reading)

    def _stop_watching(self) -> None:
        if self._read_timer is not None:
            self._read_timer.cancel()
            self._read_timer = None

    def _expect_head(self) -> None:
        self._head_timer = self.loop.call_later(self.patience_s, self._give_up)

    def _give_up(self) -> None:
        self._head_timer = None
        if not self.transport.is_closing():
            self.transport.close()

    def _drop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


def patient_protocol(timeout_s: float, max_connections: int) -> type[PatientProtocol]:
    """The protocol with these limits (uvicorn makes it without arguments)."""
    limits = {"patience_s": timeout_s, "max_connections": max_connections}
    return type("PatientProtocol", (PatientProtocol,), {**limits, "_count": [0], "_line": Line()})


def connections_allowed(wanted: int) -> int:
    """Raise the process's limit of open files as far as it goes; how many connections it bears."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = wanted + _OWN_FILES
    if soft != resource.RLIM_INFINITY and soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(hard, needed)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if soft == resource.RLIM_INFINITY:
        return wanted
    # A reply from a file takes a second descriptor, so not all may be connections.
    return max(16, min(wanted, soft - min(_OWN_FILES, soft // 2)))


def _too_many() -> bytes:
    error = UnavailableError("the service has too many connections", headers={"Retry-After": "5"})
    body = json.dumps(error.problem()).encode()
    head = (
        "HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/problem+json\r\n"
        f"Retry-After: 5\r\nConnection: close\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body


_TOO_MANY = _too_many()
