"""The queue as a whole: how it stands, pausing and resuming it."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from pydantic import ValidationError

from raykiln_service.routes.context import ERRORS, Context, InContext, read_json
from raykiln_service.schemas import PauseRequest, QueueStateView, timestamp
from raykiln_service.submission import request_error_of

router = APIRouter(prefix="/v1/queue", tags=["queue"], responses=ERRORS)
_PAUSE_BODY = {
    "requestBody": {
        "required": False,
        "content": {
            "application/json": {
                "schema": PauseRequest.model_json_schema(),
                "example": {"reason": "maintenance"},
            }
        },
    }
}


@router.get("")
def get_queue(context: InContext) -> QueueStateView:
    """How many jobs wait and run, and how long that will take."""
    return _view(context)


@router.post("/pause", openapi_extra=_PAUSE_BODY)
async def pause_queue(request: Request, context: InContext) -> QueueStateView:
    """Begin no further jobs, also after a restart; those that run go on, and new ones wait."""
    body = await read_json(request) if await request.body() else {}
    try:
        given = PauseRequest.model_validate(body)
    except ValidationError as error:
        raise request_error_of(error, body) from None
    await run_in_threadpool(context.store.pause, given.reason)
    return await run_in_threadpool(_view, context)


@router.post("/resume")
def resume_queue(context: InContext) -> QueueStateView:
    """Begin jobs again."""
    context.store.resume()
    return _view(context)


def _view(context: Context) -> QueueStateView:
    queue = context.queue.look()
    oldest = context.store.oldest_queued_ms()
    # Read anew: the look may be older than the pause that this call has made.
    pause = context.store.paused()
    return QueueStateView(
        paused=pause is not None,
        paused_at=None if pause is None else timestamp(pause.since_ms),
        pause_reason=None if pause is None else pause.reason,
        queued=queue.waiting,
        running=queue.running,
        slots=context.settings.slots,
        oldest_queued_at=None if oldest is None else timestamp(oldest),
        drained_in_s=queue.drained_s,
        samples_per_s=queue.samples_per_s,
    )
