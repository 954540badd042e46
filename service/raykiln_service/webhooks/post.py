"""One POST to a checked address: a time limit over all of it, no redirect, no endless answer."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import asynccontextmanager

import h11

from raykiln_service.webhooks.addresses import Target, resolve

_CHUNK = 8192
_MAX_ANSWER_BYTES = 64 << 10
_LINGER_S = 1.0
_MAX_ADDRESSES = 4


class DeliveryError(Exception):
    """The receiver did not answer as HTTP has it."""


async def post(
    target: Target,
    headers: Mapping[str, str],
    body: bytes,
    *,
    timeout_s: float,
    allow_private: bool,
    resolver: Executor,
    tls: ssl.SSLContext,
) -> tuple[int, Mapping[str, str]]:
    """Send a body; the status and the headers of the answer.

    Parameters
    ----------
    timeout_s
        For everything: the look-up of the name, the connection, and the head of the answer.

    Raises
    ------
    ForbiddenTargetError
        The name leads to an address that must not be reached.
    TimeoutError, OSError, DeliveryError
        It could not be delivered.
    """
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(timeout_s):
        addresses = await loop.run_in_executor(
            resolver, lambda: resolve(target, allow_private=allow_private)
        )
        async with _connected(addresses[:_MAX_ADDRESSES], target, tls) as (reader, writer):
            connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=_MAX_ANSWER_BYTES)
            writer.write(_request(connection, target, headers, body))
            await writer.drain()
            answer = await _head_of(connection, reader)
            # The receiver should not find its answer cut off, but neither may it hold us.
            with contextlib.suppress(TimeoutError, OSError, DeliveryError):
                async with asyncio.timeout(_LINGER_S):
                    await _drain(connection, reader)
    return answer


def _request(
    connection: h11.Connection, target: Target, headers: Mapping[str, str], body: bytes
) -> bytes:
    head = {"Host": target.authority, "Connection": "close", "Content-Length": str(len(body))}
    request = h11.Request(
        method="POST", target=target.path, headers=list({**head, **headers}.items())
    )
    parts = [connection.send(event) for event in (request, h11.Data(body), h11.EndOfMessage())]
    return b"".join(part or b"" for part in parts)


@asynccontextmanager
async def _connected(
    addresses: Sequence[str], target: Target, tls: ssl.SSLContext
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    secured = target.scheme == "https"
    for number, address in enumerate(addresses, 1):
        try:
            reader, writer = await asyncio.open_connection(
                address,
                target.port,
                ssl=tls if secured else None,
                server_hostname=target.host if secured else None,
            )
            break
        except OSError:
            if number == len(addresses):
                raise
    try:
        yield reader, writer
    finally:
        # Not waited for: a farewell of TLS may take as long as the receiver likes.
        writer.transport.abort()


async def _head_of(
    connection: h11.Connection, reader: asyncio.StreamReader
) -> tuple[int, Mapping[str, str]]:
    received = 0
    while True:
        event = _next_event(connection)
        if isinstance(event, h11.Response):
            names = {
                name.decode("latin-1"): value.decode("latin-1") for name, value in event.headers
            }
            return event.status_code, names
        if event is h11.NEED_DATA:
            data = await reader.read(_CHUNK)
            received += len(data)
            if received > _MAX_ANSWER_BYTES:
                raise DeliveryError("the answer has no end")
            connection.receive_data(data)
        elif not isinstance(event, h11.InformationalResponse):
            raise DeliveryError("the receiver hung up without an answer")


async def _drain(connection: h11.Connection, reader: asyncio.StreamReader) -> None:
    received = 0
    while received <= _MAX_ANSWER_BYTES:
        event = _next_event(connection)
        if event is h11.NEED_DATA:
            data = await reader.read(_CHUNK)
            received += len(data)
            connection.receive_data(data)
        elif not isinstance(event, h11.Data):
            return


def _next_event(connection: h11.Connection) -> object:
    try:
        return connection.next_event()
    except h11.RemoteProtocolError as error:
        raise DeliveryError(f"the answer is not HTTP: {error}") from None
