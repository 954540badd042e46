"""Ports that a server can leave and come back to."""

from __future__ import annotations

import random
import socket

# Below those that the system gives to whoever connects, so that nobody gets the port of a server
# that is away for a moment; not even a client that knocks at it, which would talk to itself.
_RANGE = range(20_000, 32_000)


def free_port() -> int:
    """A port of this machine at which nobody listens."""
    for port in random.SystemRandom().sample(_RANGE, 100):
        with socket.socket() as probe:
            # As servers do: what an earlier test left closing is no hindrance.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise AssertionError("all ports are taken")
