"""From a request to a queued job: everything is checked before anything is made."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Protocol

from pydantic import ValidationError
from raykiln.errors import SettingsError, pointer_of, shorten
from raykiln.settings import RenderSettings

from raykiln_service.assets import AssetStore, SceneFile
from raykiln_service.errors import InvalidRequestError, InvalidSettingsError
from raykiln_service.files import remove_tree
from raykiln_service.jobs import Job, JobSpec, new_job_id
from raykiln_service.rows import dump
from raykiln_service.schemas import JobRequest
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store


class SceneChecker(Protocol):
    """Looks over a scene without rendering it."""

    def check(self, scene: SceneFile, key: str | None) -> dict[str, Any]:
        """settings, cameras and warnings of the scene; `InvalidSceneError` if it is none."""


class Submissions:
    """Takes job requests."""

    def __init__(
        self, store: Store, assets: AssetStore, checker: SceneChecker, settings: ServiceSettings
    ) -> None:
        self._store = store
        self._assets = assets
        self._checker = checker
        self._settings = settings

    def submit(self, body: Any, key: str | None) -> tuple[Job, bool]:
        """Check a request and queue its job.

        Parameters
        ----------
        body
            The decoded JSON.
        key
            The `Idempotency-Key`, if one came.

        Returns
        -------
        The job, and whether it is new (not the replay of an earlier request).
        """
        request = parse_request(body)
        digest = hashlib.sha256(dump(body).encode()).hexdigest()
        if key is not None and (known := self._store.replayed(key, digest)) is not None:
            return known, False
        job_id = new_job_id()
        created = False
        try:
            spec = self._checked(job_id, request)
            job, created = self._store.create_job(
                job_id,
                spec,
                max_attempts=self._settings.max_attempts,
                max_queued=self._settings.max_queued,
                key=key,
                digest=digest,
            )
        finally:
            if not created:
                remove_tree(self._assets.job_dir(job_id))
        return job, created

    def _checked(self, job_id: str, request: JobRequest) -> JobSpec:
        if request.scene.inline is not None:
            self._assets.keep_inline(job_id, request.scene.inline)
            scene: dict[str, Any] = {"inline": True}
        else:
            scene = self._assets.resolve(request.scene.model_dump(exclude_none=True))
        place = self._assets.locate(job_id, scene)
        report = self._checker.check(place, None if "inline" in scene else dump(scene))
        _check_settings(request.settings, report)
        return JobSpec(
            scene=scene,
            settings=request.settings.model_dump(mode="json", exclude_unset=True),
            outputs=tuple(dict.fromkeys(request.outputs)),
            priority=request.priority,
            labels=request.labels,
            warnings=tuple(report["warnings"]),
        )


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
    found = None if first["type"] == "missing" else shorten(first.get("input"))
    return kind(
        first["msg"].removeprefix("Value error, "),
        pointer=pointer,
        found=found,
        accepted=_accepted(first.get("ctx", {})),
    )


_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}


def _accepted(context: Mapping[str, Any]) -> str | None:
    for name, words in _BOUNDS.items():
        if name in context:
            return f"{words} {context[name]}"
    expected = context.get("expected") or context.get("pattern")
    return None if expected is None else str(expected)


def _check_settings(settings: RenderSettings, report: Mapping[str, Any]) -> None:
    cameras = report["cameras"]
    if settings.camera is not None and settings.camera not in cameras:
        raise InvalidSettingsError(
            f"the scene has no camera {settings.camera!r}",
            pointer="/settings/camera",
            found=settings.camera,
            accepted=", ".join(cameras[:20]),
        )
    try:
        settings.over(report["settings"])
    except SettingsError as error:
        raise InvalidSettingsError(
            f"with the scene's own settings: {error}", pointer="/settings"
        ) from None
