"""Submitting jobs, looking at them, ending them."""

from __future__ import annotations

import asyncio
import base64
import binascii
import re
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from raykiln_service.access import Caller
from raykiln_service.errors import InvalidRequestError, ServiceError
from raykiln_service.jobs import Job, JobState
from raykiln_service.logs import get_logger
from raykiln_service.replies import Reply
from raykiln_service.routes.access import InCaller
from raykiln_service.routes.context import (
    ERRORS,
    Context,
    InContext,
    bad_cursor,
    read_json,
    states_of,
)
from raykiln_service.schemas import JobPageView, JobRequest, JobView

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], responses=ERRORS)
_WAIT = re.compile(r"(?:^|[,;\s])wait\s*=\s*(\d{1,9})")
_MAX_WAIT_S = 120
_MAX_KEY = 255
# Checks of scenes may take long: they must not use up the threads that all other calls need.
_SUBMITTING = CapacityLimiter(16)
_REQUEST_BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/JobRequest"}}},
    }
}
EXTRA_SCHEMAS = {"JobRequest": JobRequest}


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    openapi_extra=_REQUEST_BODY,
    responses={200: {"model": JobView, "description": "Finished within the time to wait"}},
)
async def create_job(
    request: Request,
    context: InContext,
    caller: InCaller,
    idempotency_key: Annotated[str | None, Header()] = None,
    prefer: Annotated[str | None, Header()] = None,
) -> Response:
    """Queue a job.

    The scene and the settings are checked first: what cannot be rendered is refused here.  The
    same `Idempotency-Key` and body get the same reply again.  `Prefer: wait=30` answers 200 with
    the finished job if it ends in that many seconds.
    """
    _check_key(idempotency_key)
    body = await read_json(request)
    try:
        submit = partial(context.submissions.submit, body, idempotency_key, caller)
        job, created = await to_thread.run_sync(submit, limiter=_SUBMITTING)
    except ServiceError as error:
        context.metrics.rejected.labels(error.slug).inc()
        raise
    if created:
        context.metrics.submitted.inc()
        get_logger().info("job accepted", job=job.id, attempt=0, token=caller.name)
        if job.attempts == 0 and job.state is JobState.SUCCEEDED:
            context.metrics.note_answer()
    wait_s = _wait_s(prefer)
    if idempotency_key is None:
        return _sent(await _answer(context, caller, job, wait_s))
    reply = None
    if not created:
        reply = await run_in_threadpool(context.replies.find, caller.owner, idempotency_key)
    else:
        context.replies.forget(caller.owner, idempotency_key)
    if reply is None:
        reply = await _answer(context, caller, job, wait_s)
        reply = context.replies.keep(caller.owner, idempotency_key, reply)
    elif wait_s and reply.status == 202:
        # Whoever asks to wait wants to know how the job ended, not that it was once accepted.
        reply = await _answer(context, caller, job, wait_s)
    return _sent(reply, {} if created else {"Idempotent-Replayed": "true"})


async def _answer(context: Context, caller: Caller, job: Job, wait_s: int) -> Reply:
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if wait_s:
        job = await _wait_for_end(context, caller, job.id, wait_s)
        headers["Preference-Applied"] = f"wait={wait_s}"
    view = await run_in_threadpool(context.view, job)
    status = 200 if wait_s and job.state.is_final else 202
    return Reply(status, headers, view.model_dump_json(by_alias=True))


def _sent(reply: Reply, more: Mapping[str, str] | None = None) -> Response:
    headers = {**reply.headers, **(more or {})}
    return Response(reply.body, reply.status, headers, media_type="application/json")


@router.get("")
def list_jobs(
    context: InContext,
    caller: InCaller,
    state: Annotated[list[str] | None, Query()] = None,
    label: Annotated[list[str] | None, Query()] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query()] = None,
) -> JobPageView:
    """Jobs, newest first.

    `state` (repeatable, or comma-separated) and `label` (`name=value` or `name`, repeatable)
    filter; `next_cursor` of a page asks for the next one.
    """
    jobs = context.store.list_jobs(
        states=states_of(JobState, state or []),
        labels=_labels(label or []),
        limit=limit + 1,
        before_seq=None if cursor is None else _seq_of(cursor),
        owner=None if caller.sees_all else caller.owner,
    )
    page = jobs[:limit]
    more = len(jobs) > limit
    return JobPageView(
        items=context.views(page), next_cursor=_cursor_of(page[-1].seq) if more else None
    )


@router.get("/{job_id}")
def get_job(job_id: str, context: InContext) -> JobView:
    """One job, as it is now."""
    return context.view(context.store.job(job_id))


@router.post("/{job_id}/cancel")
def cancel_job(job_id: str, context: InContext) -> JobView:
    """Ask for a job's end; a running one keeps its partial image and is `cancelled` soon."""
    return context.view(context.store.cancel(job_id))


@router.post("/{job_id}/retry", status_code=202)
def retry_job(job_id: str, context: InContext) -> JobView:
    """Queue a failed or cancelled job again; it goes on from its last checkpoint."""
    return context.view(context.store.retry(job_id))


@router.delete("/{job_id}", status_code=204)
def delete_job(job_id: str, context: InContext) -> None:
    """Forget an ended job, and remove its outputs."""
    context.store.delete(job_id)
    context.hub.forget(job_id)
    context.assets.remove_job(job_id)


async def _wait_for_end(context: Context, caller: Caller, job_id: str, wait_s: int) -> Job:
    loop = asyncio.get_running_loop()
    deadline = loop.time() + wait_s
    with context.hub.subscribe(job_id, caller.owner) as news:
        while True:
            job = await run_in_threadpool(context.store.job, job_id)
            left = deadline - loop.time()
            if job.state.is_final or left <= 0 or news.closed:
                return job
            while not (news.take_state() or news.closed):
                if not await news.wait(max(0.0, deadline - loop.time())):
                    break


def _wait_s(prefer: str | None) -> int:
    found = _WAIT.search(prefer or "")
    return 0 if found is None else min(_MAX_WAIT_S, int(found.group(1)))


def _check_key(key: str | None) -> None:
    if key is not None and not (0 < len(key) <= _MAX_KEY and key.isprintable()):
        raise InvalidRequestError(
            "the Idempotency-Key is not accepted", accepted=f"1 to {_MAX_KEY} printable characters"
        )


def _labels(values: list[str]) -> dict[str, str | None]:
    labels: dict[str, str | None] = {}
    for value in values:
        name, equals, wanted = value.partition("=")
        if not name:
            raise InvalidRequestError(
                "this is no label",
                pointer="?label",
                found=value[:200],
                accepted="name=value, or a name for any value",
            )
        labels[name] = wanted if equals else None
    return labels


def _cursor_of(seq: int) -> str:
    return base64.urlsafe_b64encode(f"before:{seq}".encode()).decode().rstrip("=")


def _seq_of(cursor: str) -> int:
    try:
        text = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode("ascii")
        number = re.fullmatch(r"before:(\d{1,18})", text)
    except (binascii.Error, ValueError):
        number = None
    if number is None:
        raise bad_cursor(cursor)
    return int(number.group(1))


def describe_extra() -> dict[str, Any]:
    """Schemas that handlers read by themselves, for the OpenAPI document."""
    found: dict[str, Any] = {}
    for name, model in EXTRA_SCHEMAS.items():
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        found |= schema.pop("$defs", {})
        found[name] = schema
    return found
