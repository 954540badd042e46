"""The frames of a job, and all that a job leaves as one archive."""

from __future__ import annotations

import re
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse
from raykiln.image import View

from raykiln_service.archive import archive_of, entries_of, tag_of
from raykiln_service.errors import NotFoundError
from raykiln_service.jobs import FrameState, Job
from raykiln_service.routes.context import (
    ERRORS,
    Context,
    InContext,
    bad_cursor,
    matches,
    states_of,
)
from raykiln_service.routes.outputs import LOG_NAME, reply_with
from raykiln_service.schemas_frames import FramePageView, FrameView, frame_view
from raykiln_service.units import FrameRecord

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["frames"], responses=ERRORS)
_NUMBER = re.compile(r"[0-9]{1,9}")
_SAFE = re.compile(r"[^A-Za-z0-9._-]+")


@router.get("/frames")
def list_frames(
    job_id: str,
    context: InContext,
    state: Annotated[list[str] | None, Query()] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    cursor: Annotated[str | None, Query()] = None,
) -> FramePageView:
    """The frames of a job, by number; none for a job of one image.

    `state` (repeatable, or comma-separated) filters; `next_cursor` of a page asks for the next.
    """
    job = context.store.job(job_id)
    after = 0 if cursor is None else _number(cursor)
    records = context.store.frames(
        job_id, states=states_of(FrameState, state or []), after=after, limit=limit + 1
    )
    page, more = records[:limit], len(records) > limit
    rendering = _rendering(context, job)
    return FramePageView(
        items=[frame_view(job, record, rendering) for record in page],
        next_cursor=str(page[-1].frame.number) if more else None,
    )


@router.get("/frames/{number}")
def get_frame(job_id: str, number: str, context: InContext) -> FrameView:
    """One frame; `1` and `0001` are the same."""
    job = context.store.job(job_id)
    return frame_view(job, _record(context, job, number), _rendering(context, job))


@router.head("/frames/{number}/{name}", include_in_schema=False)
@router.get("/frames/{number}/{name}", response_class=Response)
def get_frame_output(
    job_id: str,
    number: str,
    name: str,
    request: Request,
    context: InContext,
    exposure: Annotated[float, Query(ge=-100, le=100, allow_inf_nan=False)] = 0.0,
    view: View = "srgb",
) -> Response:
    """One file of a frame: `image.exr`, `image.png`, ..., `stats.json`.

    `exposure` (stops) and `view` make another picture of a `.png` from its EXR.
    """
    job = context.store.job(job_id)
    record = _record(context, job, number)
    what = f"frame {record.frame.name} of job {job_id}"
    if not record.result:
        raise NotFoundError(f"{what} has no outputs yet (found state {record.state})", found=name)
    return reply_with(request, context, job_id, record.result, name, exposure, view, what)


@router.head("/outputs.zip", include_in_schema=False)
@router.get("/outputs.zip", response_class=StreamingResponse)
def get_archive(job_id: str, request: Request, context: InContext) -> Response:
    """All outputs as one zip, made while it is sent; frames as `image.0001.exr` and so on."""
    job = context.store.job(job_id)
    folder = context.assets.job_dir(job_id)
    entries = entries_of(folder, job.result, context.store.frames(job_id), LOG_NAME)
    if not entries:
        raise NotFoundError(f"job {job_id} is {job.state} and has no outputs", found="outputs.zip")
    headers = {
        "ETag": f'"{tag_of(entries)}"',
        "Cache-Control": "no-cache",
        "Content-Disposition": f'attachment; filename="{_SAFE.sub("-", job_id)}.zip"',
    }
    if matches(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    body = iter(()) if request.method == "HEAD" else archive_of(entries)
    return StreamingResponse(body, media_type="application/zip", headers=headers)


def _record(context: Context, job: Job, number: str) -> FrameRecord:
    if job.spec.frames is None:
        raise NotFoundError(f"job {job.id} has one image and no frames")
    if not _NUMBER.fullmatch(number):
        raise NotFoundError(f"job {job.id} has no such frame", found=number[:50])
    return context.store.frame(job.id, int(number))


def _rendering(context: Context, job: Job) -> int | None:
    known = context.hub.latest_progress(job.id) or job.progress or {}
    return known.get("frame")


def _number(cursor: str) -> int:
    if not _NUMBER.fullmatch(cursor):
        raise bad_cursor(cursor)
    return int(cursor)
