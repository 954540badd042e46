"""What handlers work with, and the small things that several of them do."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request, Response
from fastapi.responses import FileResponse
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from raykiln_service.assets import AssetStore
from raykiln_service.errors import (
    InvalidRequestError,
    MalformedRequestError,
    MediaTypeError,
    NotFoundError,
    error_of_status,
)
from raykiln_service.events import EventHub
from raykiln_service.jobs import Job, JobState
from raykiln_service.metrics import Metrics
from raykiln_service.outbox import Outbox
from raykiln_service.queueing import QueueWatch, Turn
from raykiln_service.replies import Replies
from raykiln_service.schemas import EtaView, JobView, Problem, job_view
from raykiln_service.schemas_frames import frames_view
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.submission import Submissions
from raykiln_service.uploads import Uploads

State = TypeVar("State", bound=StrEnum)
_SIZE = "content-range"
_ETAG = re.compile(r'(?:W/)?("[^"]*")')
ERRORS: dict[int | str, dict[str, Any]] = {
    "4XX": {
        "description": "What was wrong, and where",
        "content": {"application/problem+json": {"schema": Problem.model_json_schema()}},
    }
}


@dataclass(frozen=True, slots=True)
class Context:
    """The service, as far as handlers may know it."""

    settings: ServiceSettings
    store: Store
    assets: AssetStore
    uploads: Uploads
    hub: EventHub
    outbox: Outbox
    replies: Replies
    wake_sender: Callable[[], None]
    """Deliver at once what waits in the outbox."""
    metrics: Metrics
    submissions: Submissions
    queue: QueueWatch
    readiness: Callable[[], dict[str, str]]
    """"ok" or what is wrong, by part."""
    sandbox: Mapping[str, str]
    """What confines the processes that read scenes, by layer; empty = they are not confined."""

    def view(self, job: Job) -> JobView:
        """A job as clients see it."""
        return self.views([job])[0]

    def views(self, jobs: list[Job]) -> list[JobView]:
        """Several of them."""
        live = any(not job.state.is_final for job in jobs)
        turns = self.queue.look().turns if live else {}
        now = self.store.clock()
        counts = self.store.frame_counts([job.id for job in jobs if job.spec.frames is not None])
        return [
            job_view(
                job,
                *self._turn(job, turns.get(job.id)),
                self.hub.latest_progress(job.id),
                now,
                frames_view(job, counts.get(job.id, {})),
            )
            for job in jobs
        ]

    def _turn(self, job: Job, turn: Turn | None) -> tuple[int | None, EtaView | None]:
        if job.state.is_final:
            return None, None
        if turn is None:
            # The view of a long queue may be older than the job.
            return self.store.queue_positions([job]).get(job.id), None
        eta = EtaView(start_s=turn.start_s, end_s=turn.end_s, basis=turn.basis)
        return turn.position if job.state is JobState.QUEUED else None, eta


async def _context(request: Request) -> Context:
    context: Context = request.app.state.context
    return context


InContext = Annotated[Context, Depends(_context)]


async def read_json(request: Request) -> Any:
    """The decoded body; `MediaTypeError` or `MalformedRequestError` if it is no JSON."""
    kind = request.headers.get("content-type", "application/json").split(";")[0].strip().lower()
    if kind != "application/json" and not kind.endswith("+json"):
        raise MediaTypeError(found=kind[:100], accepted="application/json")
    body = await request.body()
    try:
        value = json.loads(body)
        # Lone surrogates pass as JSON but cannot be stored as text.
        json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise MalformedRequestError("the JSON of the body is nested too deeply") from None
    except UnicodeEncodeError:
        raise MalformedRequestError("the body has a lone surrogate in a text") from None
    except ValueError as error:
        raise MalformedRequestError(f"the body is not JSON: {error}") from None
    return value


def states_of(kind: type[State], values: Sequence[str]) -> list[State]:
    """The states that a query names, several with commas or several times."""
    names = [name for value in values for name in value.split(",") if name]
    try:
        return [kind(name) for name in names]
    except ValueError:
        raise InvalidRequestError(
            "there is no such state",
            pointer="?state",
            found=", ".join(names)[:200],
            accepted=", ".join(kind),
        ) from None


def bad_cursor(cursor: str) -> InvalidRequestError:
    """The error for a cursor that no page has given."""
    return InvalidRequestError(
        "this is no cursor",
        pointer="?cursor",
        found=cursor[:100],
        accepted="the next_cursor of an earlier page",
    )


def matches(request: Request, etag: str) -> bool:
    """Whether the client has this version already (`If-None-Match`)."""
    known = request.headers.get("if-none-match", "")
    return known.strip() == "*" or etag in _ETAG.findall(known)


def file_reply(
    request: Request, path: Path, media_type: str, *, etag: str | None = None, fresh: bool = False
) -> Response:
    """A file, with Range and conditional requests; `fresh` = ask again each time."""
    try:
        stat = path.stat()
    except FileNotFoundError:
        raise NotFoundError(f"there is no {path.name} of this job") from None
    etag = etag or f'"{stat.st_mtime_ns:x}-{stat.st_size:x}"'
    headers = {"ETag": etag, "Cache-Control": "no-cache" if fresh else "private, max-age=3600"}
    if matches(request, etag):
        return Response(status_code=304, headers=headers)
    return _File(path, media_type=media_type, headers=headers, stat_result=stat)


class _File(FileResponse):
    """A file whose refusals of a range are problems, as all refusals are."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def checked(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                size = {k: v for k, v in Headers(raw=message["headers"]).items() if k == _SIZE}
                detail = "the range is not in the file" if size else "this is no range of bytes"
                raise error_of_status(message["status"], detail, size)
            await send(message)

        await super().__call__(scope, receive, checked)
