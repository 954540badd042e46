"""From a request to a queued job: everything is checked before anything is made."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

from pydantic import ValidationError
from raykiln.errors import SettingsError, pointer_of, shorten
from raykiln.settings import RenderSettings

from raykiln_service.access import LOCAL, Caller, Origin
from raykiln_service.assets import AssetStore, SceneFile
from raykiln_service.cache import ResultCache, result_key
from raykiln_service.errors import (
    IdempotencyInFlightError,
    InvalidRequestError,
    InvalidSettingsError,
)
from raykiln_service.files import remove_tree
from raykiln_service.framing import checked_outputs, plan_frames
from raykiln_service.jobs import Job, JobSpec, Webhook, new_job_id
from raykiln_service.metrics import Metrics
from raykiln_service.rows import dump
from raykiln_service.schemas import JobRequest
from raykiln_service.schemas_webhooks import WebhookChoice
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.store_queue import Traits
from raykiln_service.telemetry import Tracing
from raykiln_service.webhooks.addresses import ForbiddenTargetError, parse_url
from raykiln_service.webhooks.signatures import ACCEPTED


class SceneChecker(Protocol):
    """Looks over a scene without rendering it."""

    def check(self, scene: SceneFile, key: str | None) -> dict[str, Any]:
        """settings, cameras and warnings of the scene; `InvalidSceneError` if it is none."""


class Submissions:
    """Takes job requests."""

    def __init__(
        self,
        store: Store,
        assets: AssetStore,
        checker: SceneChecker,
        cache: ResultCache,
        settings: ServiceSettings,
        metrics: Metrics,
        tracing: Tracing,
    ) -> None:
        self._store = store
        self._assets = assets
        self._checker = checker
        self._cache = cache
        self._settings = settings
        self._metrics = metrics
        self._tracing = tracing
        self._lock = threading.Lock()
        self._in_flight: set[tuple[str | None, str]] = set()

    def submit(self, body: Any, key: str | None, caller: Caller = LOCAL) -> tuple[Job, bool]:
        """Check a request and queue its job.

        Parameters
        ----------
        body
            The decoded JSON.
        key
            The `Idempotency-Key`, if one came.
        caller
            Whose job it will be.

        Returns
        -------
        The job, and whether it is new (not the replay of an earlier request).
        """
        request = parse_request(body)
        digest = hashlib.sha256(dump(body).encode()).hexdigest()
        with self._alone(caller, key):
            if key is not None and (known := self._store.replayed(key, digest, caller)) is not None:
                return known, False
            return self._create(request, Origin(caller, key, digest))

    def _create(self, request: JobRequest, origin: Origin) -> tuple[Job, bool]:
        job_id = new_job_id()
        created = False
        try:
            spec, samples, traits = self._checked(job_id, request, origin.caller)
            answer = None
            if traits.use_cache and traits.cache_key is not None:
                answer = self._cache.answer(job_id, traits.cache_key)
            job, created = self._store.create_job(
                job_id,
                spec,
                max_attempts=self._settings.max_attempts,
                max_queued=self._settings.max_queued,
                key=origin.key,
                digest=origin.digest,
                caller=origin.caller,
                pixel_samples=samples,
                traits=traits,
                answer=answer,
            )
        finally:
            if not created:
                remove_tree(self._assets.job_dir(job_id))
        return job, created

    @contextmanager
    def _alone(self, caller: Caller, key: str | None) -> Iterator[None]:
        """Refuse a second request with the same key while the first is being checked."""
        if key is None:
            yield
            return
        place = (caller.owner, key)
        with self._lock:
            if place in self._in_flight:
                raise IdempotencyInFlightError(
                    f"a request with Idempotency-Key {key!r} is being worked on; ask again soon",
                    headers={"Retry-After": "1"},
                )
            self._in_flight.add(place)
        try:
            yield
        finally:
            with self._lock:
                self._in_flight.discard(place)

    def _checked(
        self, job_id: str, request: JobRequest, caller: Caller
    ) -> tuple[JobSpec, int, Traits]:
        webhook = self._webhook(request.webhook)
        if request.scene.inline is not None:
            self._assets.keep_inline(job_id, request.scene.inline)
            scene: dict[str, Any] = {"inline": True}
        else:
            scene = self._assets.resolve(request.scene.model_dump(exclude_none=True), caller)
        place = self._assets.locate(job_id, scene)
        with self._metrics.check(), self._tracing.span("check", **{"raykiln.job": job_id}):
            report = self._checker.check(place, None if "inline" in scene else dump(scene))
        resolved = _check_settings(request.settings, report)
        spec = JobSpec(
            scene=scene,
            settings=request.settings.model_dump(mode="json", exclude_unset=True),
            outputs=checked_outputs(request.outputs, request.frames),
            priority=request.priority,
            labels=request.labels,
            warnings=tuple(report["warnings"]),
            memory_bytes=request.memory_bytes,
            timeout_s=request.timeout_s,
            webhook=webhook,
            trace=self._tracing.context(),
            **self._frames(request, resolved, report),
        )
        scene_sha256 = report["summary"]["scene_sha256"]
        traits = self._traits(scene_sha256, resolved, spec, request)
        return spec, pixel_samples_of(resolved) * max(1, len(spec.planned)), traits

    def _traits(
        self, scene_sha256: str, resolved: RenderSettings, spec: JobSpec, request: JobRequest
    ) -> Traits:
        budget_s = resolved.time_budget_s
        one_image = spec.frames is None
        settings = resolved.model_dump(mode="json")
        return Traits(
            scene_key=scene_sha256,
            limit_ms=None
            if budget_s is None
            else round(budget_s * 1000) * max(1, len(spec.planned)),
            cache_key=result_key(scene_sha256, settings, spec.outputs) if one_image else None,
            use_cache=request.cache and self._settings.result_cache,
        )

    def _webhook(self, choice: WebhookChoice | None) -> Webhook | None:
        """Who is to hear of the job; the name is looked up only when there is news."""
        if choice is None:
            return None
        try:
            allow_private = self._settings.webhook_allow_private
            target = parse_url(choice.url, allow_private=allow_private)
        except ForbiddenTargetError as error:
            raise InvalidRequestError(
                str(error),
                pointer="/webhook/url",
                found=shorten(choice.url),
                accepted="an https:// or http:// URL of the public internet",
            ) from None
        if choice.secret is None and self._settings.webhook_secret is None:
            raise InvalidRequestError(
                "this service has no secret of its own to sign with",
                pointer="/webhook/secret",
                accepted=ACCEPTED,
            )
        events = tuple(dict.fromkeys(choice.events))
        return Webhook(choice.url, target.authority, events, choice.secret)

    def _frames(
        self, request: JobRequest, resolved: RenderSettings, report: Mapping[str, Any]
    ) -> dict[str, Any]:
        """The fields of a `JobSpec` that say which frames there are."""
        if request.frames is None:
            return {}
        planned = plan_frames(
            request.frames, request.settings, resolved, report, self._settings.max_frames
        )
        wanted = request.frames.model_dump(mode="json", exclude_unset=True)
        return {"frames": wanted, "planned": planned}


def pixel_samples_of(settings: RenderSettings) -> int:
    """The pixel samples that one image of these settings takes at most."""
    x0, y0, x1, y1 = settings.crop or (0, 0, settings.width, settings.height)
    return (x1 - x0) * (y1 - y0) * settings.spp


def parse_request(body: Any) -> JobRequest:
    """A validated request; the first complaint as an error with its JSON pointer."""
    try:
        return JobRequest.model_validate(body)
    except ValidationError as error:
        raise request_error_of(error, body) from None


def request_error_of(error: ValidationError, body: Any) -> InvalidRequestError:
    """The first complaint of a validation of a request's body."""
    first = error.errors(include_url=False)[0]
    pointer = pointer_of(first["loc"], body) or None
    in_settings = first["loc"][:1] == ("settings",)
    kind = InvalidSettingsError if in_settings else InvalidRequestError
    hidden = first["type"] == "missing" or _holds_secret(first["loc"])
    found = None if hidden else shorten(first.get("input"))
    return kind(
        first["msg"].removeprefix("Value error, "),
        pointer=pointer,
        found=found,
        accepted=_accepted(first.get("ctx", {})),
    )


def _holds_secret(place: tuple[int | str, ...]) -> bool:
    return place[:1] == ("webhook",) and (len(place) == 1 or place[-1] == "secret")


_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}


def _accepted(context: Mapping[str, Any]) -> str | None:
    for name, words in _BOUNDS.items():
        if name in context:
            return f"{words} {context[name]}"
    expected = context.get("expected") or context.get("pattern")
    return None if expected is None else str(expected)


def _check_settings(settings: RenderSettings, report: Mapping[str, Any]) -> RenderSettings:
    cameras = report["cameras"]
    if settings.camera is not None and settings.camera not in cameras:
        raise InvalidSettingsError(
            f"the scene has no camera {settings.camera!r}",
            pointer="/settings/camera",
            found=settings.camera,
            accepted=", ".join(cameras[:20]),
        )
    try:
        return settings.over(report["settings"])
    except SettingsError as error:
        raise InvalidSettingsError(
            f"with the scene's own settings: {error}", pointer="/settings"
        ) from None
