"""What can be asked for, and how the service is."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import raykiln as rk
from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Response
from fastapi.responses import FileResponse, JSONResponse
from raykiln.settings import RenderSettings

from raykiln_service.errors import NotFoundError
from raykiln_service.routes.context import InContext
from raykiln_service.schemas import SceneView, VersionView

router = APIRouter()
_PROBING = CapacityLimiter(2)
_WEB = Path(__file__).parent.parent / "web"
_PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob:; connect-src 'self'; worker-src 'self'; form-action 'none'; "
    "base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_MEDIA_TYPES = {
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".webp": "image/webp",
}
_WEB_FILES = {
    path.name: _MEDIA_TYPES[path.suffix] for path in _WEB.iterdir() if path.suffix in _MEDIA_TYPES
}


@router.get("/v1/scenes", tags=["about"])
def list_scenes() -> list[SceneView]:
    """The bundled scenes."""
    return [_scene_view(name, path) for name, path in sorted(rk.bundled_scenes().items())]


@router.get("/v1/settings/schema", tags=["about"])
def settings_schema() -> dict[str, Any]:
    """The render settings, as JSON Schema."""
    return RenderSettings.model_json_schema()


@router.get("/v1/version", tags=["about"])
def version(context: InContext) -> VersionView:
    """What runs here."""
    settings = context.settings
    return VersionView(
        version=rk.__version__,
        api="v1",
        executor=settings.executor,
        slots=settings.slots,
        sandbox=dict(context.sandbox),
    )


@router.get("/healthz", tags=["health"])
async def healthz() -> dict[str, str]:
    """Whether the process answers."""
    return {"status": "ok"}


@router.get("/readyz", tags=["health"])
async def readyz(context: InContext) -> Response:
    """Whether jobs can be taken and rendered: the database and the executor."""
    # In threads of its own, for which no other call queues.
    parts = await to_thread.run_sync(context.readiness, limiter=_PROBING)
    ready = all(state == "ok" for state in parts.values())
    body = {"status": "ok" if ready else "unavailable", **parts}
    return JSONResponse(body, status_code=200 if ready else 503)


@router.get("/metrics", tags=["health"], response_class=Response)
def metrics(context: InContext) -> Response:
    """For Prometheus."""
    context.metrics.webhooks_waiting.set(context.outbox.waiting())
    context.metrics.readers.set(context.hub.reader_count())
    return Response(context.metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get("/", include_in_schema=False)
def page() -> FileResponse:
    """The job page."""
    return FileResponse(_WEB / "index.html", headers=_PAGE_HEADERS)


@router.get("/docs", include_in_schema=False)
def docs() -> FileResponse:
    """The API, for people."""
    return FileResponse(_WEB / "docs.html", headers=_PAGE_HEADERS)


@router.get("/web/{name}", include_in_schema=False)
def web_file(name: str) -> FileResponse:
    """A file of the pages."""
    if name not in _WEB_FILES:
        raise NotFoundError(f"there is no page file {name!r}")
    return FileResponse(_WEB / name, media_type=_WEB_FILES[name], headers=_PAGE_HEADERS)


@cache
def _scene_view(name: str, path: Path) -> SceneView:
    scene = rk.load_scene(path)
    picture = f"scene-{name}.webp"
    return SceneView(
        name=name,
        title=scene.name,
        description=scene.description,
        settings=scene.settings,
        cameras=[camera.name for camera in scene.cameras],
        thumbnail=f"/web/{picture}" if picture in _WEB_FILES else None,
    )
