"""The description of the API for machines: what the framework finds, and what it cannot know."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from raykiln_service.routes import jobs
from raykiln_service.routes.access import is_open, scope_of
from raykiln_service.routes.context import ERRORS
from raykiln_service.schemas import Problem

_PROBLEM = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
_JOB_LINKS = {
    "get_job": "The job as it is now",
    "cancel_job": "Stop it",
    "retry_job": "Run it again, once it has failed or was cancelled",
    "delete_job": "Remove it, once it has ended",
    "list_outputs": "Its results",
    "job_events": "What happens to it",
}
_EXAMPLES: dict[str, Any] = {
    "job_id": "job-1a204b62b6e-38ba9cccf6",
    "asset_id": "sha256:" + "0" * 64,
    "upload_id": "up-0123456789abcdef0123456789abcdef",
    "Tus-Resumable": "1.0.0",
    "Upload-Length": "1000",
    "Upload-Offset": "0",
    "idempotency-key": "shot-a12-take-3",
    "prefer": "wait=1",
    "sha256": "0" * 64,
    "filename": "scene.glb",
    "label": ["shot=a12"],
    "state": ["queued"],
    "limit": 20,
    "view": "agx",
    "exposure": 1.0,
}


def operation_id(route: APIRoute) -> str:
    """The name by which generated clients call an operation: that of its function."""
    return route.name


def describe(app: FastAPI, asks_for_token: bool) -> dict[str, Any]:
    """The OpenAPI document, made once."""
    if app.openapi_schema is None:
        app.openapi_schema = _document(app, asks_for_token)
    return app.openapi_schema


def _document(app: FastAPI, asks_for_token: bool) -> dict[str, Any]:
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description="Render jobs: upload a scene, submit a job, watch it, fetch its images.",
        license_info={"name": "Apache 2.0", "identifier": "Apache-2.0"},
        routes=app.routes,
    )
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas.update(jobs.describe_extra())
    schemas["Problem"] = Problem.model_json_schema()
    # The framework's own shape of such errors is never sent.
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _complete(path, method.upper(), operation)
            if not is_open(path):
                operation["security"] = [{"token": []}] if asks_for_token else [{"token": []}, {}]
    return document


def _complete(path: str, method: str, operation: dict[str, Any]) -> None:
    responses = operation["responses"]
    responses.pop("422", None)
    if not is_open(path):
        responses["4XX"] = {**ERRORS["4XX"], "content": _PROBLEM}
        operation["x-required-scope"] = scope_of(method, path)
    responses["5XX"] = {"description": "Not the client's fault", "content": _PROBLEM}
    if path == "/readyz":
        responses["503"] = {"description": "Not ready", "content": {"application/json": {}}}
    for parameter in operation.get("parameters", ()):
        if parameter["name"] in _EXAMPLES:
            parameter["example"] = _EXAMPLES[parameter["name"]]
        if parameter["name"] == "Tus-Resumable":
            # Not called required: tus answers 412 here, which readers of this take for a mistake.
            parameter["description"] = (
                "Always 1.0.0; another version, or none, is answered with 412"
            )
    _add_links(operation["operationId"], responses)


def _add_links(operation: str, responses: dict[str, Any]) -> None:
    if operation in ("create_job", "retry_job", "cancel_job", "get_job"):
        for status in {"200", "202"} & responses.keys():
            responses[status]["links"] = {
                name: _link(name, text, job_id="$response.body#/id")
                for name, text in _JOB_LINKS.items()
            }
    if operation == "upload_asset":
        text = "What is stored"
        responses["201"]["links"] = {
            "get_asset": _link("get_asset", text, asset_id="$response.body#/id")
        }
        responses["201"]["links"]["create_job"] = {
            "operationId": "create_job",
            "description": "Render it",
            "requestBody": {"scene": {"asset": "$response.body#/id"}},
        }
    if operation == "list_uploads":
        responses["200"]["links"] = {
            name: _link(name, "One of them", upload_id="$response.body#/items/0/id")
            for name in ("get_upload", "head_upload", "continue_upload", "end_upload")
        }
    if operation == "list_frames":
        where = {"job_id": "$request.path.job_id", "number": "$response.body#/items/0/number"}
        responses["200"]["links"] = {"get_frame": _link("get_frame", "One of them", **where)}
    if operation == "list_jobs":
        next_page = _link("list_jobs", "The next page", cursor="$response.body#/next_cursor")
        responses["200"]["links"] = {"next": next_page}


def _link(operation: str, description: str, **parameters: str) -> dict[str, Any]:
    return {"operationId": operation, "description": description, "parameters": parameters}
