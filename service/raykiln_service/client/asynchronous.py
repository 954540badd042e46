"""The client of a raykiln service for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from functools import wraps
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, get_args, get_type_hints

import httpx

from raykiln_service.client import calls, requests
from raykiln_service.client.base import CHUNK_BYTES, ClientBase
from raykiln_service.client.calls import Call, Reconnects
from raykiln_service.client.downloads import Download
from raykiln_service.client.models import Asset, Event, EventDecoder, Frame, Job, ServerError
from raykiln_service.client.requests import Ask, signed_like
from raykiln_service.client.uploads import (
    SMALL_BYTES,
    Answer,
    Step,
    Steps,
    answer_of,
    upload_steps,
)

P = ParamSpec("P")
T = TypeVar("T")


async def _blocks(file: Path, start: int = 0) -> AsyncIterator[bytes]:
    with file.open("rb") as stream:
        stream.seek(start)
        while block := stream.read(CHUNK_BYTES):
            yield block


def _awaited(
    maker: Callable[P, Ask[T]],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]]:
    """The method of a client that carries out what `maker` asks."""

    @wraps(maker)
    async def method(self: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        ask = maker(*args, **kwargs)
        return ask.read(await self._send(ask.call))

    answer = get_type_hints(maker)["return"]
    signed_like(method, maker, get_args(answer)[0])
    return method


class AsyncClient(ClientBase):
    """A client for asyncio; its calls are those of `Client`.

    Parameters
    ----------
    server
        Base URL; None = `RAYKILN_SERVER`, else http://127.0.0.1:8000.
    token
        Bearer token; None = `RAYKILN_TOKEN`.
    timeout_s
        Longest silence in a call.
    retries
        How often a repeatable call is tried again.

    Raises
    ------
    ServerUnreachableError
        From every call, if no service answers.
    ServerError
        From every call that the service refuses; carries the problem document.
    """

    def __init__(
        self,
        server: str | None = None,
        token: str | None = None,
        *,
        timeout_s: float = 30.0,
        retries: int = 3,
    ) -> None:
        super().__init__(server, token, timeout_s=timeout_s, retries=retries)
        self._http = httpx.AsyncClient(**self._options)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def _reply(
        self, call: Call, content: Callable[[], AsyncIterator[bytes]] | None = None
    ) -> httpx.Response:
        """Carry out a call, again if that is allowed and helps."""
        tried = 0
        while True:
            tried += 1
            try:
                body = None if content is None else content()
                response = await self._http.request(**self._arguments(call, body))
                if response.is_error:
                    raise calls.problem_of(response, self.server)
                return response
            except (httpx.TransportError, ServerError) as error:
                await asyncio.sleep(self._pause_s(tried, error, call))

    async def _send(
        self, call: Call, content: Callable[[], AsyncIterator[bytes]] | None = None
    ) -> Any:
        """Carry out a call; gives its JSON document, or None for an empty reply."""
        response = await self._reply(call, content)
        return self._document(response) if response.content else None

    version = _awaited(requests.version)
    queue = _awaited(requests.queue)
    pause_queue = _awaited(requests.pause_queue)
    resume_queue = _awaited(requests.resume_queue)
    scenes = _awaited(requests.scenes)
    submit = _awaited(requests.submit)
    job = _awaited(requests.job)
    jobs = _awaited(requests.jobs)
    cancel = _awaited(requests.cancel)
    retry = _awaited(requests.retry)
    delete = _awaited(requests.delete)
    deliveries = _awaited(requests.deliveries)
    redeliver = _awaited(requests.redeliver)

    async def upload_asset(self, path: str | Path, *, filename: str | None = None) -> Asset:
        """Upload a scene file, or a zip bundle of a scene and the files beside it.

        A large file is not sent if it is there already, and goes on where an earlier upload of
        it was broken off, be it by this client or another with the same token.
        """
        file = Path(path)
        name = filename or file.name
        if file.stat().st_size > SMALL_BYTES:
            return await self._carry_out(upload_steps(file, name, self._policy), file)
        call = calls.upload_call(file, name)
        return Asset.model_validate(await self._send(call, lambda: _blocks(file)))

    async def _carry_out(self, steps: Steps, file: Path) -> Asset:
        # The first step hashes the file.
        step = await asyncio.to_thread(next, steps)
        try:
            while True:
                await asyncio.sleep(step.pause_s)
                step = steps.send(await self._answer(step, file))
        except StopIteration as end:
            asset: Asset = end.value
            return asset
        except httpx.TransportError as error:
            raise calls.unreachable(self.server, error) from error

    async def _answer(self, step: Step, file: Path) -> Answer:
        if not step.may_fail:
            return await self._reply(step.call)
        body = None if step.start is None else _blocks(file, step.start)
        try:
            response = await self._http.request(**self._arguments(step.call, body))
        except httpx.TransportError as error:
            return error
        return answer_of(response, self.server)

    async def frames(self, job_id: str, *, state: str | None = None) -> list[Frame]:
        """The frames of a job by number, or those in one state; none for a job of one image."""
        found: list[Frame] = []
        cursor: str | None = None
        while True:
            page = await self._send(calls.frames_call(job_id, state, cursor))
            found += [Frame.model_validate(item) for item in page["items"]]
            cursor = page["next_cursor"]
            if cursor is None:
                return found

    async def events(
        self,
        job_id: str,
        *,
        last_event_id: str | None = None,
        timeout_s: float | None = None,
        patience_s: float = 60.0,
    ) -> AsyncIterator[Event]:
        """The events of a job until it ends, across lost connections.

        Parameters
        ----------
        last_event_id
            Start after this event.
        timeout_s
            Raise `TimeoutError` after this time.
        patience_s
            How long a service that went away may stay away.
        """
        decoder = EventDecoder(last_event_id)
        reconnects = Reconnects(patience_s, timeout_s)
        while True:
            failure: Exception | None = None
            try:
                call = calls.events_call(job_id, decoder.last_id)
                arguments = self._arguments(call) | {"timeout": reconnects.timeout()}
                async with self._http.stream(**arguments) as response:
                    if response.is_error:
                        await response.aread()
                        raise calls.problem_of(response, self.server)
                    async for text in response.aiter_text():
                        reconnects.heard()
                        for event in decoder.feed(text):
                            yield event
                            if calls.ends_stream(event):
                                return
                        reconnects.check()
            except (httpx.TransportError, ServerError) as error:
                failure = error
            decoder.reset()
            await asyncio.sleep(self._reconnect_pause_s(reconnects, failure))

    async def wait(
        self,
        job_id: str,
        *,
        timeout_s: float | None = None,
        on_event: Callable[[Event], None] | None = None,
    ) -> Job:
        """Wait until a job has ended; `TimeoutError` after `timeout_s`."""
        async for event in self.events(job_id, timeout_s=timeout_s):
            if on_event is not None:
                on_event(event)
        return await self.job(job_id)

    async def download(
        self,
        job_id: str,
        name: str,
        path: str | Path,
        *,
        frame: int | None = None,
        exposure: float | None = None,
        view: str | None = None,
    ) -> Path:
        """Download an output (`image.exr`, `image.png`, `stats.json`, …); the file appears whole.

        `frame` is the number of a frame of the job. A broken download goes on where it broke.
        """
        return await self._fetch(calls.output_call(job_id, name, exposure, view, frame), path)

    async def download_archive(self, job_id: str, path: str | Path) -> Path:
        """Download all outputs as one zip; frames are in it as `image.0001.exr` and so on."""
        return await self._fetch(calls.archive_call(job_id), path)

    async def _fetch(self, call: Call, path: str | Path) -> Path:
        with Download(Path(path)) as download:
            tried = 0
            while True:
                tried += 1
                arguments = self._arguments(call)
                arguments["headers"] |= download.headers()
                try:
                    async with self._http.stream(**arguments) as response:
                        if response.is_error:
                            await response.aread()
                            raise calls.problem_of(response, self.server)
                        download.start(response)
                        async for block in response.aiter_bytes():
                            download.write(block)
                    return download.finish()
                except (httpx.TransportError, ServerError) as error:
                    await asyncio.sleep(self._pause_s(tried, error, call))

    async def preview(self, job_id: str) -> bytes:
        """The image so far, as the bytes of a PNG file."""
        response = await self._reply(calls.preview_call(job_id))
        return response.content
