"""The event stream of a job."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Header, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from raykiln_service.access import Caller
from raykiln_service.errors import InvalidRequestError, NotFoundError
from raykiln_service.jobs import JobState
from raykiln_service.routes.access import InCaller
from raykiln_service.routes.context import ERRORS, Context, InContext
from raykiln_service.schemas import timestamp

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], responses=ERRORS)
_QUIET_S = 15.0
# News that come within it go out together.
_FEED_PAUSE_S = 0.1


@router.get(
    "/{job_id}/events",
    response_class=StreamingResponse,
    responses={
        200: {"content": {"text/event-stream": {}}, "description": "Server-sent events"},
        204: {"description": "The job has ended and all was told"},
    },
)
async def job_events(
    job_id: str,
    context: InContext,
    caller: InCaller,
    last_event_id: Annotated[str | None, Header()] = None,
) -> Response:
    """`state`, `progress` and `preview` events until the job ends.

    States have ids and are durable: after a reconnect with `Last-Event-ID` none is missing.
    Progress and previews are news of the moment; a slow reader gets the latest.
    """
    last = _number(last_event_id)
    job = await run_in_threadpool(context.store.job, job_id)
    if job.state.is_final and last_event_id is not None:
        untold = await run_in_threadpool(context.store.events_after, job_id, last)
        if not untold:
            return Response(status_code=204)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(
        _stream(context, caller, job_id, last), media_type="text/event-stream", headers=headers
    )


feed_router = APIRouter(prefix="/v1/events", tags=["jobs"], responses=ERRORS)


@feed_router.get(
    "",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {}}, "description": "Server-sent events"}},
)
async def all_events(context: InContext, caller: InCaller) -> Response:
    """News of all jobs in one stream: `state`, `progress`, `preview` and `deleted` events.

    Each names its `job`.  It is news of the moment: after a reconnect, or a `reload` event, read
    the list of jobs.  A slow reader gets the latest of each job.
    """
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(
        _feed(context, caller), media_type="text/event-stream", headers=headers
    )


async def _feed(context: Context, caller: Caller) -> AsyncIterator[str]:
    visible: dict[str, bool] = {"": True}
    with context.hub.subscribe_to_all(caller.owner) as feed:
        yield "retry: 1000\n\n"
        while not feed.closed:
            news = await feed.take(_QUIET_S)
            if not news:
                yield ": quiet\n\n"
                continue
            if not caller.sees_all:
                for job in {job for job, _kind, _data in news} - visible.keys():
                    visible[job] = await run_in_threadpool(_is_own, context, caller, job)
                news = [item for item in news if visible[item[0]]]
            yield "".join(_event(kind, {"job": job, **data}) for job, kind, data in news)
            await asyncio.sleep(_FEED_PAUSE_S)


def _is_own(context: Context, caller: Caller, job_id: str) -> bool:
    try:
        return context.store.owner_of(job_id) == caller.owner
    except NotFoundError:
        return False


async def _stream(context: Context, caller: Caller, job_id: str, last: int) -> AsyncIterator[str]:
    with context.hub.subscribe(job_id, caller.owner) as news:
        yield "retry: 1000\n\n"
        news.state_changed = True
        news.progress = context.hub.latest_progress(job_id)
        while not news.closed:
            if news.take_state():
                state = None
                for event in await run_in_threadpool(context.store.events_after, job_id, last):
                    last, state = event.seq, JobState(event.data["state"])
                    data = {**event.data, "at": timestamp(event.at_ms).isoformat()}
                    yield _event("state", data, event.seq)
                if state is not None and state.is_final:
                    return
            if (preview := news.take_preview()) is not None:
                yield _event("preview", {**preview, "href": f"/v1/jobs/{job_id}/preview.png"})
            if (progress := news.take_progress()) is not None:
                yield _event("progress", progress)
            if not await news.wait(_QUIET_S):
                yield ": quiet\n\n"


def _event(name: str, data: Mapping[str, Any], number: int | None = None) -> str:
    head = "" if number is None else f"id: {number}\n"
    return f"{head}event: {name}\ndata: {json.dumps(data, default=str)}\n\n"


def _number(last_event_id: str | None) -> int:
    if not last_event_id:
        return 0
    if not (last_event_id.isascii() and last_event_id.isdigit() and len(last_event_id) < 19):
        raise InvalidRequestError(
            "this is no event id", found=last_event_id[:50], accepted="the id of an earlier event"
        )
    return int(last_event_id)
