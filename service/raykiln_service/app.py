"""The HTTP application, and serving it."""

from __future__ import annotations

import asyncio
import errno
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import FrameType

import raykiln as rk
import uvicorn
from anyio import to_thread
from fastapi import Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from raykiln.errors import pointer_of, shorten
from sqlalchemy.exc import OperationalError, SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match, Route

from raykiln_service import logs
from raykiln_service.errors import (
    InvalidRequestError,
    ServiceError,
    StartupError,
    StorageFullError,
    UnavailableError,
    error_of_status,
)
from raykiln_service.middleware import Guard, problem_reply
from raykiln_service.observing import Observer
from raykiln_service.openapi import describe, operation_id
from raykiln_service.protocol import connections_allowed, patient_protocol
from raykiln_service.routes import (
    about,
    assets,
    deliveries,
    events,
    frames,
    jobs,
    outputs,
    queue,
    uploads,
)
from raykiln_service.routes.access import authorize
from raykiln_service.service import Service
from raykiln_service.settings import ServiceSettings

_DRAIN_S = 2
_UPKEEP_S = 600.0
_REVOKED_S = 1.0
_REPLIES_S = 0.5
_THREADS = 16
_SWITCH_S = 0.001
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


def create_app(service: Service) -> FastAPI:
    """The application around a service; it starts and closes the service with itself."""

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        # More threads than this only take turns with the event loop, which must stay quick.
        to_thread.current_default_thread_limiter().total_tokens = _THREADS
        await run_in_threadpool(service.start)
        tasks = [asyncio.create_task(work(service)) for work in _CHORES]
        yield
        for task in tasks:
            task.cancel()
        await run_in_threadpool(service.close)

    app = FastAPI(
        title="raykiln",
        version=rk.__version__,
        summary="Render jobs over HTTP.",
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=operation_id,
    )
    app.state.context = service.context
    parts = (jobs, events, frames, deliveries, outputs, assets, uploads, queue, about)
    routers = [*(part.router for part in parts), events.feed_router]
    for router in routers:
        app.include_router(router, dependencies=[Depends(authorize)])
    app.state.routes = [route for router in routers for route in router.routes]
    _add_error_handlers(app)
    app.add_middleware(Guard, settings=service.settings, tokens=service.tokens)
    # Added last, so that it sees what the guard refuses too.
    app.add_middleware(Observer, metrics=service.metrics, tracing=service.tracing)
    app.openapi = lambda: describe(app, service.settings.asks_for_token)  # type: ignore[method-assign]
    return app


async def _keep_up(service: Service) -> None:
    """Forget what has expired, from time to time."""
    while True:
        await asyncio.sleep(_UPKEEP_S)
        try:
            await run_in_threadpool(service.uploads.prune)
            await run_in_threadpool(service.store.prune_keys)
        except (ServiceError, SQLAlchemyError, OSError) as error:
            logs.get_logger().warning("clean-up did not work", exc_info=error)


async def _write_replies(service: Service) -> None:
    """Write down what requests were answered with, many at a time."""
    while True:
        await asyncio.sleep(_REPLIES_S)
        try:
            await run_in_threadpool(service.replies.write)
        except SQLAlchemyError as error:
            logs.get_logger().warning("replies not written", error=str(error))


async def _end_revoked(service: Service) -> None:
    """End the streams of tokens that are let in no longer; one look for all that are open."""
    while True:
        await asyncio.sleep(_REVOKED_S)
        try:
            if owners := service.hub.owners():
                ended = await run_in_threadpool(service.tokens.inactive, owners)
                if ended:
                    # First, so that nobody whose stream has ended is let in once more.
                    service.tokens.forget()
                for owner in ended:
                    service.hub.end_of(owner)
        except SQLAlchemyError as error:
            logs.get_logger().warning("tokens not looked at", error=str(error))


_CHORES = (_keep_up, _end_revoked, _write_replies)


def serve(settings: ServiceSettings) -> None:
    """Run the service until SIGTERM or SIGINT.

    Prints ``raykiln serving on http://host:port`` when it is ready.

    Raises
    ------
    StartupError
        A used port, a data folder in use, no token for a public address.
    """
    logs.configure(settings.log_format)
    sys.setswitchinterval(_SWITCH_S)
    listener = _bind(settings.host, settings.port)
    with listener:
        service = Service(settings)
        try:
            settings.check_exposure(service.tokens.any_active())
        except StartupError:
            service.close()
            raise
        config = uvicorn.Config(
            create_app(service),
            http=patient_protocol(
                settings.request_timeout_s, connections_allowed(settings.max_connections)
            ),
            ws="none",
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=_DRAIN_S,
        )
        _Server(config, service).run(sockets=[listener])


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started and sockets:
            host, port = sockets[0].getsockname()[:2]
            shown = f"[{host}]" if ":" in host else host
            print(f"raykiln serving on http://{shown}:{port}", flush=True)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        # Called between any two instructions of the event loop, which may hold the very locks
        # that stopping needs: another thread takes them.
        threading.Thread(target=self._service.begin_stop).start()
        self.force_exit = self.should_exit and sig == signal.SIGINT
        self.should_exit = True


def _bind(host: str, port: int) -> socket.socket:
    try:
        found = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM)
        family, kind, protocol, _name, address = found[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        reason = "in use" if error.errno == errno.EADDRINUSE else f"not usable: {error.strerror}"
        raise StartupError(f"port {port} of {host} is {reason}") from None
    return listener


def _add_error_handlers(app: FastAPI) -> None:
    @app.exception_handler(ServiceError)
    async def _service_error(_request: Request, error: ServiceError) -> Response:
        return problem_reply(error)

    @app.exception_handler(HTTPException)
    async def _http_error(request: Request, error: HTTPException) -> Response:
        detail = error.detail
        headers = dict(error.headers or {})
        if error.status_code == 404:
            detail = f"there is nothing at {request.url.path}"
        elif error.status_code == 405:
            detail = f"{request.method} is not allowed at {request.url.path}"
            # The framework names only the methods of the first route of this path.
            headers["Allow"] = ", ".join(_methods_at(request))
        return problem_reply(error_of_status(error.status_code, detail, headers))

    @app.exception_handler(RequestValidationError)
    async def _invalid(_request: Request, error: RequestValidationError) -> Response:
        return problem_reply(_parameter_error(error))

    @app.exception_handler(ClientDisconnect)
    async def _gone(_request: Request, _error: ClientDisconnect) -> Response:
        # Nobody reads this any more.
        return Response(status_code=400)

    async def _unexpected(request: Request, error: Exception) -> Response:
        return problem_reply(_as_service_error(request, error))

    for kind in (OSError, SQLAlchemyError, Exception):
        app.add_exception_handler(kind, _unexpected)


def _methods_at(request: Request) -> list[str]:
    found = [
        route
        for route in request.app.state.routes
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE
    ]
    # `/v1/assets/missing` comes before `/v1/assets/{asset_id}`, which also fits.
    same = [route.methods or set() for route in found if route.path == found[0].path]
    return sorted(set().union(*same))


def _parameter_error(error: RequestValidationError) -> InvalidRequestError:
    first = error.errors()[0]
    source, *rest = first["loc"]
    name = "/".join(map(str, rest))
    pointer = f"?{name}" if source == "query" else f"{source}: {name}"
    if source == "body":
        pointer = pointer_of(tuple(rest))
    return InvalidRequestError(first["msg"], pointer=pointer, found=shorten(first.get("input")))


def _as_service_error(request: Request, error: Exception) -> ServiceError:
    if isinstance(error, OSError) and error.errno in _NO_SPACE:
        return StorageFullError()
    if isinstance(error, OperationalError):
        if "full" in str(error.orig):
            return StorageFullError()
        return UnavailableError("the database does not answer", headers={"Retry-After": "5"})
    logs.get_logger().error(
        "request broke",
        path=request.url.path,
        job=request.path_params.get("job_id"),
        exc_info=error,
    )
    return ServiceError()
