"""May this caller make this call?  Asked once for every route, so that none can forget to ask."""

from __future__ import annotations

from typing import Annotated, Any, get_args, get_origin

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from raykiln_service.access import LOCAL, Caller, Scope
from raykiln_service.errors import InvalidRequestError, NotFoundError, ScopeError, UnauthorizedError
from raykiln_service.routes.context import InContext

_OPEN_PATHS = frozenset({"/", "/healthz", "/readyz", "/docs", "/openapi.json"})
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
# Looking things up with a body.
_READS = frozenset({"/v1/assets/missing"})
_SUBMITS = frozenset({"/v1/jobs", "/v1/assets", "/v1/uploads", "/v1/uploads/{upload_id}"})


async def caller_of(request: Request) -> Caller:
    """Who sent the request.

    Asynchronous, as all dependencies are: others would each wait for a thread, in every call.
    """
    caller: Caller = getattr(request.state, "caller", LOCAL)
    return caller


InCaller = Annotated[Caller, Depends(caller_of)]


def is_open(path: str) -> bool:
    """Whether a path is one of the pages and of health, which tell nothing about jobs."""
    return path in _OPEN_PATHS or path.startswith("/web/")


def scope_of(method: str, path: str) -> Scope | None:
    """The right that a route needs, None for an open one; what nobody thought of needs `admin`."""
    if is_open(path):
        return None
    if method in _SAFE or path in _READS:
        return Scope.READ
    if path in _SUBMITS and method in ("POST", "PATCH"):
        return Scope.SUBMIT
    if path.startswith(("/v1/jobs/{job_id}", "/v1/uploads/{upload_id}")):
        return Scope.MANAGE
    return Scope.ADMIN


async def authorize(request: Request, caller: InCaller, context: InContext) -> None:
    """Refuse a call without the right, for a job of somebody else, or with unknown parameters.

    The job of somebody else looks the same as one that does not exist.
    """
    route = request.scope["route"]
    scope = scope_of(request.method, route.path)
    if scope is not None and not caller.may(scope):
        if not caller.scopes:
            raise UnauthorizedError
        raise ScopeError(scope)
    if isinstance(route, APIRoute) and scope is not None:
        _check_parameters(request, route)
    job_id = request.path_params.get("job_id")
    if job_id is not None and not caller.sees_all:
        owner = await run_in_threadpool(context.store.owner_of, job_id)
        if owner != caller.owner:
            raise NotFoundError(f"there is no job {job_id!r}")


def _check_parameters(request: Request, route: APIRoute) -> None:
    known = _query_fields(route.dependant)
    for name in request.query_params:
        if name not in known:
            raise InvalidRequestError(
                "there is no such query parameter",
                pointer=f"?{name[:100]}",
                accepted=", ".join(sorted(known)) or "none",
            )
        values = request.query_params.getlist(name)
        if len(values) > 1 and not _is_list(known[name]):
            # Which of them counts, the sender and a proxy in between may see differently.
            raise InvalidRequestError(
                "the query parameter was given more than once",
                pointer=f"?{name}",
                found=", ".join(values)[:200],
                accepted="one value",
            )


def _query_fields(dependant: Dependant) -> dict[str, Any]:
    """The types of the query parameters of a route."""
    found = {field.alias: field.field_info.annotation for field in dependant.query_params}
    for inner in dependant.dependencies:
        found |= _query_fields(inner)
    return found


def _is_list(annotation: Any) -> bool:
    return list in (get_origin(annotation), *map(get_origin, get_args(annotation)))
