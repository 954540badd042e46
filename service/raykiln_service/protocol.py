"""uvicorn's HTTP/1.1 protocol with a deadline for the head of a request."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol


class PatientProtocol(H11Protocol):
    """Closes a connection whose request line and headers take too long to arrive.

    uvicorn itself waits for ever, so that a few slow clients could hold all its connections.
    """

    head_timeout_s = 30.0
    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """A client has connected."""
        super().connection_made(transport)
        self._expect_head()

    def data_received(self, data: bytes) -> None:
        """Bytes have come."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._drop_timer()
        elif self._head_timer is None and self.conn.trailing_data[0]:
            # The first part of a further request on a kept connection.
            self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._drop_timer()
        super().connection_lost(exc)

    def _expect_head(self) -> None:
        self._head_timer = self.loop.call_later(self.head_timeout_s, self._give_up)

    def _give_up(self) -> None:
        self._head_timer = None
        if not self.transport.is_closing():
            self.transport.close()

    def _drop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


def patient_protocol(timeout_s: float) -> type[PatientProtocol]:
    """The protocol with a deadline of so many seconds (uvicorn makes it without arguments)."""
    return type("PatientProtocol", (PatientProtocol,), {"head_timeout_s": timeout_s})
