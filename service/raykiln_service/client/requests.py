"""What the methods of the clients ask and how the answers are read: once for both clients."""

from __future__ import annotations

import inspect
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar
from urllib.parse import quote

from raykiln_service.client.calls import Call, job_path
from raykiln_service.client.models import Deliveries, Job, JobPage

T = TypeVar("T")


@dataclass(frozen=True)
class Ask(Generic[T]):
    """One request, and what to make of the JSON of its answer."""

    call: Call
    read: Callable[[Any], T]


def signed_like(method: Any, maker: Callable[..., Any], answer: Any) -> None:
    """Let a method look like the function of this module that it carries out."""
    me = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    own = inspect.signature(maker)
    method.__signature__ = own.replace(
        parameters=[me, *own.parameters.values()], return_annotation=answer
    )


def _document(answer: Any) -> dict[str, Any]:
    document: dict[str, Any] = answer
    return document


def version() -> Ask[dict[str, Any]]:
    """What the service says about itself."""
    return Ask(Call("GET", "/v1/version"), _document)


def queue() -> Ask[dict[str, Any]]:
    """The queue as a whole: how much waits and runs, and whether it is paused."""
    return Ask(Call("GET", "/v1/queue"), _document)


def pause_queue(reason: str | None = None) -> Ask[dict[str, Any]]:
    """Begin no further jobs; those that run go on."""
    body = {} if reason is None else {"reason": reason}
    return Ask(Call("POST", "/v1/queue/pause", json=body), _document)


def resume_queue() -> Ask[dict[str, Any]]:
    """Begin jobs again."""
    return Ask(Call("POST", "/v1/queue/resume"), _document)


def scenes() -> Ask[list[dict[str, Any]]]:
    """The scenes that the service bundles."""
    return Ask(Call("GET", "/v1/scenes"), list)


def submit(
    scene: Mapping[str, Any],
    settings: Mapping[str, Any] | None = None,
    *,
    frames: Mapping[str, Any] | None = None,
    outputs: list[str] | None = None,
    priority: int = 0,
    labels: Mapping[str, str] | None = None,
    timeout_s: float | None = None,
    memory_bytes: int | None = None,
    webhook: Mapping[str, Any] | None = None,
    cache: bool = True,
    idempotency_key: str | None = None,
    wait_s: float | None = None,
) -> Ask[Job]:
    """Submit a job.

    Parameters
    ----------
    scene
        ``{"name": …}``, ``{"asset": id, "entry": …}`` or ``{"inline": {…}}``.
    settings
        `RenderSettings` fields.
    frames
        Many pictures: ``{"turntable": {"count": 36}}``, ``{"cameras": "all"}`` or
        ``{"time": {…}}``; None = one.
    outputs
        ``exr``, ``png``, and of frames ``contact_sheet``, ``webp``, ``mp4``; None = what the
        service makes by itself.
    timeout_s, memory_bytes
        The time on a slot and the memory that the job may take; None = what the service allows.
    webhook
        Who is to hear how it ends: ``{"url": …, "events": […], "secret": …}``.
    idempotency_key
        Two submissions with one key give one job; None = a fresh key, which makes this call safe
        to repeat.
    cache
        Whether the result of an identical job may be the answer.
    wait_s
        Let the service hold the answer back until the job ends, this long at most.
    """
    body: dict[str, Any] = {"scene": dict(scene), "settings": dict(settings or {})}
    given = {
        "frames": frames,
        "outputs": outputs,
        "priority": priority or None,
        "labels": labels or None,
        "timeout_s": timeout_s,
        "memory_bytes": memory_bytes,
        "webhook": webhook,
        "cache": None if cache else False,
    }
    body |= {name: value for name, value in given.items() if value is not None}
    headers = {"Idempotency-Key": idempotency_key or secrets.token_hex(16)}
    patience_s = None
    if wait_s is not None:
        headers["Prefer"] = f"wait={max(0, round(wait_s))}"
        patience_s = wait_s + 30
    call = Call("POST", "/v1/jobs", headers=headers, json=body, timeout_s=patience_s)
    return Ask(call, Job.model_validate)


def job(job_id: str) -> Ask[Job]:
    """A job as it stands."""
    return Ask(Call("GET", job_path(job_id)), Job.model_validate)


def jobs(
    *,
    state: str | None = None,
    labels: Mapping[str, str] | None = None,
    limit: int | None = None,
    cursor: str | None = None,
) -> Ask[JobPage]:
    """One page of jobs, newest first."""
    given = {"state": state, "limit": limit, "cursor": cursor}
    params: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if labels:
        params["label"] = [f"{name}={value}" for name, value in labels.items()]
    return Ask(Call("GET", "/v1/jobs", params=params), JobPage.model_validate)


def cancel(job_id: str) -> Ask[Job]:
    """Cancel a job; what is rendered so far is kept."""
    return Ask(Call("POST", job_path(job_id) + "/cancel", repeatable=False), Job.model_validate)


def retry(job_id: str) -> Ask[Job]:
    """Queue a failed or cancelled job again."""
    return Ask(Call("POST", job_path(job_id) + "/retry", repeatable=False), Job.model_validate)


def delete(job_id: str) -> Ask[None]:
    """Delete a job that has ended, with its outputs."""
    return Ask(Call("DELETE", job_path(job_id), repeatable=False), lambda _empty: None)


def deliveries(job_id: str) -> Ask[Deliveries]:
    """What the webhook of a job has been told, newest first."""
    return Ask(Call("GET", job_path(job_id) + "/deliveries"), Deliveries.model_validate)


def redeliver(job_id: str, delivery_id: str) -> Ask[Deliveries]:
    """Send a message to the webhook of a job again, at once."""
    path = f"{job_path(job_id)}/deliveries/{quote(delivery_id, safe='')}/redeliver"
    return Ask(Call("POST", path, repeatable=False), Deliveries.model_validate)
