"""The images and files that jobs leave."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from fastapi import APIRouter, Query, Request, Response
from raykiln.image import View, encode_png, read_exr_layers, to_png_pixels

from raykiln_service.errors import InvalidRequestError, NotFoundError
from raykiln_service.routes.context import ERRORS, Context, InContext, file_reply, matches
from raykiln_service.schemas import OutputView

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["outputs"], responses=ERRORS)
LOG_NAME = "log.txt"
# Views of large images take memory; more than this at once must wait.
_VIEWS_AT_ONCE = threading.BoundedSemaphore(2)


@router.head("/preview.png", include_in_schema=False)
@router.get("/preview.png", response_class=Response)
def get_preview(job_id: str, request: Request, context: InContext) -> Response:
    """The image so far, or a small one of the finished image."""
    context.store.job(job_id)
    path = context.assets.job_dir(job_id) / "preview.png"
    return file_reply(request, path, "image/png", fresh=True)


@router.get("/outputs")
def list_outputs(job_id: str, context: InContext) -> list[OutputView]:
    """The files of the result."""
    return context.view(context.store.job(job_id)).outputs


@router.head("/outputs/{name}", include_in_schema=False)
@router.get("/outputs/{name}", response_class=Response)
def get_output(
    job_id: str,
    name: str,
    request: Request,
    context: InContext,
    exposure: Annotated[float, Query(ge=-100, le=100, allow_inf_nan=False)] = 0.0,
    view: View = "srgb",
) -> Response:
    """One file: `image.exr`, `image.png`, `albedo.exr`, ..., `stats.json`, `log.txt`.

    `exposure` (stops) and `view` make another picture of a `.png` from its EXR.
    """
    job = context.store.job(job_id)
    if name == LOG_NAME:
        path = context.assets.job_dir(job_id) / LOG_NAME
        return file_reply(request, path, "text/plain; charset=utf-8", fresh=True)
    if not job.result:
        where = "" if job.spec.frames is None else "; its frames have, as they are finished"
        raise NotFoundError(f"job {job.id} is {job.state} and has no outputs{where}", found=name)
    return reply_with(request, context, job_id, job.result, name, exposure, view, f"job {job_id}")


def reply_with(
    request: Request,
    context: Context,
    job_id: str,
    result: Mapping[str, Any],
    name: str,
    exposure: float,
    view: str,
    what: str,
) -> Response:
    """The reply with a file of a result, or with a picture made of one for another view."""
    developed = exposure != 0.0 or view != "srgb"
    if developed and not name.endswith(".png"):
        raise InvalidRequestError(
            "exposure and view go with pictures only", found=name, accepted="image.png"
        )
    if not developed and (file := _file_of(result, name)) is not None:
        inner, media_type, digest = file
        place = context.assets.job_dir(job_id) / inner
        return file_reply(request, place, media_type, etag=f'"{digest}"')
    stem = name.removesuffix(".png")
    source = None if stem == name else _file_of(result, f"{stem}.exr")
    if source is None:
        names = [file["name"] for file in result.get("files", ())]
        raise NotFoundError(
            f"{what} has no such output", found=name, accepted=", ".join([*names, LOG_NAME])
        )
    return _developed(request, context, job_id, source, exposure, view)


def _file_of(result: Mapping[str, Any], name: str) -> tuple[str, str, str] | None:
    for file in result.get("files", ()):
        if file["name"] == name:
            return f"{result['dir']}/{name}", file["media_type"], file["sha256"]
    return None


def _developed(
    request: Request,
    context: Context,
    job_id: str,
    source: tuple[str, str, str],
    exposure: float,
    view: str,
) -> Response:
    path, _media_type, digest = source
    etag = '"' + hashlib.sha256(f"{digest} {exposure!r} {view}".encode()).hexdigest() + '"'
    headers = {"ETag": etag, "Cache-Control": "private, max-age=3600"}
    if matches(request, etag):
        return Response(status_code=304, headers=headers)
    with _VIEWS_AT_ONCE:
        layers = read_exr_layers(context.assets.job_dir(job_id) / path)
        pixels = _as_colour(layers.get("beauty", next(iter(layers.values()))))
        metadata: dict[str, str | int | float] = {"view": view, "exposure": exposure}
        picture = bytes(encode_png(to_png_pixels(pixels, view, exposure), metadata=metadata))
    return Response(picture, media_type="image/png", headers=headers)


def _as_colour(layer: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    if layer.ndim == 2:
        layer = layer[:, :, np.newaxis]
    return layer[:, :, :3] if layer.shape[2] >= 3 else np.repeat(layer[:, :, :1], 3, axis=2)
