"""One attempt at a job: from the lease to the commit.

`Attempt` is a job of one image; `attempt_frames.py` makes jobs of many from its parts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from raykiln_service.assets import AssetStore
from raykiln_service.errors import LeaseLostError, ServiceError
from raykiln_service.events import EventHub
from raykiln_service.executors.base import Executor, Outcome, OutcomeKind, StopReason, Task
from raykiln_service.files import (
    publish_folder,
    remove_tree,
    sha256_of,
    storage_trouble,
    sync_dir,
    write_json,
)
from raykiln_service.jobs import Job, JobState, Lease
from raykiln_service.logs import JobLog, get_logger
from raykiln_service.metrics import Metrics
from raykiln_service.planner import Unit, plan
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.telemetry import AttemptTrace, Tracing

Made = TypeVar("Made")

_CANCEL_POLL_S = 0.1
MEDIA_TYPES = {
    ".exr": "image/x-exr",
    ".png": "image/png",
    ".json": "application/json",
    ".webp": "image/webp",
    ".mp4": "video/mp4",
}


class Attempt:
    """Runs a claimed job; also the `Watcher` of its task."""

    def __init__(
        self,
        job: Job,
        *,
        store: Store,
        assets: AssetStore,
        hub: EventHub,
        metrics: Metrics,
        settings: ServiceSettings,
        is_stopping: Callable[[], bool],
        tracing: Tracing | None = None,
    ) -> None:
        assert job.lease is not None
        self._job = job
        self._lease: Lease = job.lease
        self._store = store
        self._assets = assets
        self._hub = hub
        self._metrics = metrics
        self._settings = settings
        self._is_stopping = is_stopping
        self._tracing = tracing or Tracing()
        self._trace = AttemptTrace(None, None)
        self._folder = assets.job_dir(job.id)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._work_dir = self._folder / f"work-{self._lease.token}"
        self._log = JobLog(self._folder / "log.txt", self._lease.attempt)
        self._service_log = get_logger(job=job.id, attempt=self._lease.attempt)
        self._progress: Mapping[str, Any] | None = None
        self._first_spp: int | None = None
        self._began_at = self._beat_at = time.monotonic()
        self._polled_at = 0.0
        self._reason: StopReason | None = None

    def run(self, slot: int, executor: Executor) -> None:
        """Render and commit; every way out leaves the job in a state from which it goes on."""
        with self._tracing.attempt(self._job) as self._trace:
            self._run(slot, executor)

    def _run(self, slot: int, executor: Executor) -> None:
        self._say("begins")
        try:
            self._clean()
            self._work(slot, executor)
        except LeaseLostError:
            self._say("lost its lease, its result is dropped")
        except ServiceError as error:
            problem = {"reason": error.slug, **error.problem()}
            self._try(lambda: self._fail(problem))
        except OSError as error:
            detail = f"the data folder: {error.strerror or error}"
            self._try(lambda: self._lose("storage", detail, own_fault=False))
        except SQLAlchemyError as error:
            self._say(f"could not be committed: {error}")
        except Exception:
            self._service_log.exception("attempt broke in the service")
            self._try(lambda: self._lose("internal", "the service broke during the attempt"))
        finally:
            remove_tree(self._work_dir)

    # What the executor tells and asks

    def progress(self, progress: Mapping[str, Any]) -> None:
        """Note how far it has come."""
        self._progress = self._overall(progress)
        spp = progress.get("spp_done")
        if self._first_spp is None:
            self._first_spp = spp
        self._hub.progress_made(self._job.id, self._progress)

    def _overall(self, progress: Mapping[str, Any]) -> Mapping[str, Any]:
        """The progress of the job, from that of its unit."""
        return progress

    def preview(self) -> None:
        """Tell of a new preview."""
        spp = (self._progress or {}).get("spp_done", 0)
        self._hub.preview_made(self._job.id, spp)

    def log(self, line: str) -> None:
        """Keep a line in the job's log."""
        if line.strip():
            self._log.write(line)

    def stop_reason(self) -> StopReason | None:
        """Beat the lease's heart if it is time, and look whether the end was asked for."""
        if self._is_stopping():
            return StopReason.SHUTDOWN
        now = time.monotonic()
        try:
            if now - self._beat_at >= self._settings.heartbeat_s:
                self._beat_at = now
                self._beat()
            if now - self._polled_at >= _CANCEL_POLL_S:
                self._polled_at = now
                self._reason = StopReason.CANCEL if self._asked_to_cancel() else self._reason
        except LeaseLostError:
            self._reason = StopReason.LEASE_LOST
        except SQLAlchemyError as error:
            self._service_log.warning("heartbeat not written", error=str(error))
        return self._reason

    def _beat(self) -> None:
        spp = (self._progress or {}).get("spp_done") or 0
        advanced = self._first_spp is not None and spp > self._first_spp
        self._store.heartbeat(
            self._lease,
            self._settings.lease_s,
            self._progress,
            advanced=advanced,
            used_ms=self._used_ms(),
        )

    def _used_ms(self) -> int:
        """Time of the job on a slot, over all attempts."""
        return self._job.used_ms + int((time.monotonic() - self._began_at) * 1000)

    def _time_left_s(self) -> float | None:
        limits = [s for s in (self._job.spec.timeout_s, self._settings.max_job_s) if s is not None]
        return max(0.0, min(limits) - self._used_ms() / 1000) if limits else None

    def _asked_to_cancel(self) -> bool:
        job = self._store.job(self._job.id)
        if job.lease != self._lease:
            raise LeaseLostError
        return job.cancel_requested

    # The way of an attempt

    def _clean(self) -> None:
        """Drop what killed attempts left: their leases are gone, so nobody will miss it."""
        for left in (*self._folder.glob("work-*"), *self._folder.glob(".*")):
            remove_tree(left) if left.is_dir() else left.unlink(missing_ok=True)

    def _work(self, slot: int, executor: Executor) -> None:
        (unit,) = plan(self._job.spec.settings)
        self._commit(executor.run(slot, self._task(unit), self))

    def _task(self, unit: Unit) -> Task:
        """The task of a unit, with an empty folder to work in."""
        self._work_dir.mkdir()
        scene = self._assets.locate(self._job.id, self._job.spec.scene)
        frame = unit.frame
        own, suffix = ({}, "") if frame is None else (frame.settings, f"-{frame.name}")
        return Task(
            job_id=self._job.id,
            token=self._lease.token + suffix,
            unit=unit,
            scene_path=scene.path,
            base_dir=scene.base_dir,
            settings={**self._job.spec.settings, **own},
            outputs=self._job.spec.outputs,
            work_dir=self._work_dir,
            checkpoint=self._folder / f"checkpoint{suffix}",
            preview=self._folder / "preview.png",
            scene_key=self._assets.key_of(self._job.spec.scene, scene),
            memory_bytes=self._job.spec.memory_bytes,
            time_left_s=self._time_left_s(),
        )

    def _commit(self, outcome: Outcome) -> None:
        match outcome.kind:
            case OutcomeKind.DONE:
                assert outcome.result is not None
                result = self._publish(outcome.result)
                self._log.write(_summary(result))
                self._end(lambda: self._store.succeed(self._lease, result))
                self._metrics.note_result(result["stats"]["queue_s"], result["stats"])
                self._tidy(result)
            case OutcomeKind.STOPPED if self._reason is StopReason.CANCEL:
                kept = self._keep(outcome.result)
                self._end(lambda: self._store.end_cancelled(self._lease, kept))
                self._tidy(kept)
            case OutcomeKind.STOPPED if self._reason is None:
                self._end(lambda: self._store.release(self._lease))
            case OutcomeKind.STOPPED:
                raise LeaseLostError
            case OutcomeKind.TIMED_OUT:
                kept = self._keep(outcome.result)
                self._fail(outcome.error, kept)
                self._tidy(kept)
            case OutcomeKind.REJECTED:
                self._fail(outcome.error)
            case OutcomeKind.BROKEN:
                self._broken(outcome.error)

    def _fail(self, error: Mapping[str, Any], kept: Mapping[str, Any] | None = None) -> None:
        self._say(f"failed: {error['detail']}")
        self._end(lambda: self._store.fail(self._lease, error, kept), error["reason"])

    def _broken(self, error: Mapping[str, Any]) -> None:
        trouble = storage_trouble(self._folder)
        if trouble is None:
            self._lose(error["reason"], error["detail"], error)
        else:
            # Not the job's fault: it goes on when there is room again.
            detail = f"the data folder: {trouble}; the render said: {error['detail']}"
            self._lose("storage", detail, own_fault=False)

    def _lose(
        self,
        reason: str,
        detail: str,
        error: Mapping[str, Any] | None = None,
        *,
        own_fault: bool = True,
    ) -> None:
        self._say(f"lost: {detail}")
        self._metrics.note_loss(reason)
        problem = error or {"reason": reason, "title": "The attempt was lost", "detail": detail}
        delay_s = self._settings.retry_pause_s(self._job.failures + self._job.stalls)
        self._end(
            lambda: self._store.lose(self._lease, problem, own_fault=own_fault, delay_s=delay_s),
            reason,
        )

    def _keep(self, partial: Mapping[str, Any] | None) -> dict[str, Any] | None:
        """Publish what there is of a job that ends before it is done."""
        return None if partial is None else self._publish(partial)

    def _publish(
        self,
        result: Mapping[str, Any],
        kind: str = "result",
        times: Mapping[str, float] | None = None,
    ) -> dict[str, Any]:
        """The outputs in their final folder, durably; what the database will say of them."""
        stats = {**result["stats"], **(times or self._times())}
        self._trace.rendered(stats if kind != "result" or self._job.spec.frames is None else {})
        write_json(self._work_dir / "stats.json", stats)
        files = [_describe(path) for path in sorted(self._work_dir.iterdir())]
        place = self._folder / f"{kind}-{self._lease.token}"
        publish_folder(self._work_dir, place)
        sync_dir(self._folder.parent)
        return {**result, "stats": stats, "dir": place.name, "files": files}

    def _times(self) -> dict[str, float]:
        """Of the job: how long it waited, and how long it took until now."""
        created, started = self._job.created_ms, self._job.started_ms or self._job.created_ms
        return {
            "queue_s": max(0.0, (started - created) / 1000),
            "total_s": max(0.0, (self._store.clock() - created) / 1000),
        }

    def _end(self, commit: Callable[[], JobState], reason: str | None = None) -> None:
        """Commit the end; `reason` says why the attempt did not deliver."""
        state = self._committed(commit)
        self._say(f"ends, the job is {state}")
        self._trace.ended(state)
        if reason is not None and state is JobState.FAILED:
            self._metrics.note_failure(reason)
        elif reason is not None and state is JobState.QUEUED:
            self._metrics.retried.inc()

    def _committed(self, commit: Callable[[], Made]) -> Made:
        """Commit; a database that cannot take it now is asked again."""
        pause_s = 0.2
        while True:
            try:
                return commit()
            except SQLAlchemyError as error:
                self._service_log.warning("commit postponed", error=str(error))
                if self._is_stopping():
                    raise
                time.sleep(pause_s)
                pause_s = min(5.0, pause_s * 2)

    def _try(self, end: Callable[[], None]) -> None:
        try:
            end()
        except (LeaseLostError, SQLAlchemyError) as error:
            self._say(f"could not be ended: {error}")

    def _tidy(self, result: Mapping[str, Any] | None) -> None:
        """Remove what no reader needs any more; what stays for a crash goes with the job."""
        kept = None if result is None else result["dir"]
        for folder in self._folder.glob("result-*"):
            if folder.name != kept:
                remove_tree(folder)
        if result is not None and result["complete"]:
            (self._folder / "checkpoint").unlink(missing_ok=True)

    def _say(self, text: str) -> None:
        self._log.write(text)
        self._service_log.info(f"attempt {text}")


def _summary(result: Mapping[str, Any]) -> str:
    stats = result["stats"]
    size = f"{result['width']} x {result['height']}"
    warnings = "".join(f"; warning: {text}" for text in result["warnings"])
    return f"rendered {size} at {stats['spp']} spp in {stats['render_s']:.2f} s{warnings}"


def _describe(path: Path) -> dict[str, Any]:
    return {
        "name": path.name,
        "media_type": MEDIA_TYPES.get(path.suffix, "application/octet-stream"),
        "size_bytes": path.stat().st_size,
        "sha256": sha256_of(path),
    }
