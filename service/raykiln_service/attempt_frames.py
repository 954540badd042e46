"""One attempt at a job of many frames: each frame is rendered, committed and tried again alone."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from raykiln_service.attempt import Attempt
from raykiln_service.executors.base import Executor, Outcome, OutcomeKind
from raykiln_service.executors.gatherer import Gathering, gather
from raykiln_service.executors.limits import default_job_memory
from raykiln_service.files import remove_tree
from raykiln_service.jobs import FrameState
from raykiln_service.planner import GATHERED, Unit, playback_fps
from raykiln_service.units import FrameRecord

_COUNTS = ("samples", "camera_rays", "bounce_rays", "shadow_rays", "nonfinite_samples")


class FramesAttempt(Attempt):
    """Renders the frames that are still to do, in order, then puts them together.

    A frame that breaks does not hold up the others: it is tried again by a later attempt, after a
    pause.  The job succeeds if all its frames do.
    """

    _records: dict[int, FrameRecord]
    _took_s: list[float]
    _number = 0
    _began = 0.0

    def _work(self, slot: int, executor: Executor) -> None:
        records = self._committed(lambda: self._store.frames(self._job.id))
        self._records = {record.frame.number: record for record in records}
        self._took_s = []
        self._tidy_frames()
        for number, record in list(self._records.items()):
            if record.state is not FrameState.QUEUED:
                continue
            if self.stop_reason() is not None:
                self._commit(Outcome(OutcomeKind.STOPPED))
                return
            self._number, self._began = number, time.monotonic()
            self._first_spp = None
            self._log.write(f"frame {record.frame.name} of {len(self._records)}")
            outcome = executor.run(slot, self._task(Unit(number, frame=record.frame)), self)
            if outcome.kind in (OutcomeKind.STOPPED, OutcomeKind.TIMED_OUT):
                self._commit(outcome)
                return
            self._end_frame(record, outcome)
        self._conclude()

    def _overall(self, progress: Mapping[str, Any]) -> Mapping[str, Any]:
        count, done = len(self._records), self._count_ended()
        within = 0.0 if progress["phase"] == "gather" else float(progress["fraction"])
        return {
            **progress,
            "fraction": min(1.0, (done + within) / count),
            "eta_s": self._eta_s(progress.get("eta_s"), count - done - 1),
            "frame": self._number,
            "frames": count,
            "frames_done": done,
        }

    def _eta_s(self, of_frame: float | None, left: int) -> float | None:
        if of_frame is None:
            return None
        this_s = time.monotonic() - self._began + of_frame
        mean_s = (sum(self._took_s) + this_s) / (len(self._took_s) + 1)
        return of_frame + max(0, left) * mean_s

    def _count_ended(self) -> int:
        return sum(record.state is not FrameState.QUEUED for record in self._records.values())

    # The end of a frame

    def _end_frame(self, record: FrameRecord, outcome: Outcome) -> None:
        if outcome.kind is OutcomeKind.DONE:
            assert outcome.result is not None
            self._took_s.append(time.monotonic() - self._began)
            self._commit_frame(record, FrameState.SUCCEEDED, result=outcome.result)
            return
        error = dict(outcome.error)
        self._say(f"frame {record.frame.name}: {error['detail']}")
        is_last = record.failures + 1 >= self._job.max_attempts
        if outcome.kind is OutcomeKind.BROKEN:
            self._metrics.note_loss(error["reason"])
            if not is_last:
                self._metrics.retried.inc()
        rejected = outcome.kind is OutcomeKind.REJECTED
        state = FrameState.FAILED if rejected or is_last else FrameState.QUEUED
        self._commit_frame(record, state, error=error)

    def _commit_frame(
        self,
        record: FrameRecord,
        state: FrameState,
        *,
        result: Mapping[str, Any] | None = None,
        error: Mapping[str, Any] | None = None,
    ) -> None:
        number = record.frame.number
        kept = None
        if result is not None:
            times = {"queue_s": 0.0, "total_s": time.monotonic() - self._began}
            kept = self._publish(result, f"frame-{record.frame.name}", times)
        remove_tree(self._work_dir)
        self._committed(
            lambda: self._store.end_frame(self._lease, number, state, result=kept, error=error)
        )
        if state is FrameState.SUCCEEDED:
            (self._folder / f"checkpoint-{record.frame.name}").unlink(missing_ok=True)
        self._records[number] = self._committed(lambda: self._store.frame(self._job.id, number))

    def _keep(self, partial: Mapping[str, Any] | None) -> dict[str, Any] | None:
        if partial is not None:
            record = self._records[self._number]
            self._commit_frame(record, FrameState.CANCELLED, result=partial)
        return self._publish_summary(complete=False)

    # The end of the job

    def _conclude(self) -> None:
        records = list(self._records.values())
        waiting = [r for r in records if r.state is FrameState.QUEUED]
        failed = [r for r in records if r.state is FrameState.FAILED]
        if waiting:
            tries = max(record.failures for record in waiting)
            pause_s = self._settings.retry_pause_s(tries - 1)
            self._end(lambda: self._store.release(self._lease, delay_s=pause_s))
        elif failed:
            error = _error_of(failed, len(records))
            kept = self._publish_summary(complete=False)
            self._fail(error, kept)
            self._tidy(kept)
        else:
            self._finish_all(records)

    def _finish_all(self, records: Sequence[FrameRecord]) -> None:
        wanted = [name for name in self._job.spec.outputs if name in GATHERED]
        if wanted:
            remove_tree(self._work_dir)
            self._work_dir.mkdir()
            outcome = gather(self._gathering(records, wanted), self)
            if outcome.kind is not OutcomeKind.DONE:
                self._commit(outcome)
                return
        result = self._publish_summary(complete=True, fresh=not wanted)
        assert result is not None
        self._end(lambda: self._store.succeed(self._lease, result))
        self._metrics.note_result(result["stats"]["queue_s"], result["stats"])
        self._tidy(result)

    def _gathering(self, records: Sequence[FrameRecord], wanted: Sequence[str]) -> Gathering:
        places = []
        for record in records:
            assert record.result is not None
            folder = self._folder / record.result["dir"]
            places.append((record.frame.number, folder / "image.exr"))
        own = self._settings.job_memory_bytes
        return Gathering(
            frames=places,
            outputs=wanted,
            fps=playback_fps(self._job.spec.frames or {}),
            job_dir=self._folder,
            work_dir=self._work_dir,
            memory_bytes=own or default_job_memory(self._settings.slots),
            sandbox=self._settings.sandbox,
        )

    def _publish_summary(self, *, complete: bool, fresh: bool = True) -> dict[str, Any] | None:
        """The result of the job: totals over its frames, beside what was gathered."""
        results = [r.result for r in self._records.values() if r.result is not None]
        if not results:
            return None
        if fresh:
            remove_tree(self._work_dir)
            self._work_dir.mkdir()
        warnings = dict.fromkeys(text for result in results for text in result["warnings"])
        summary = {
            **results[0],
            "complete": complete,
            "warnings": list(warnings),
            "stats": total_of([result["stats"] for result in results]),
        }
        return self._publish(summary)

    def _tidy(self, result: Mapping[str, Any] | None) -> None:
        super()._tidy(result)
        self._tidy_frames()

    def _tidy_frames(self) -> None:
        """Remove the folders and checkpoints that no frame needs."""
        results = [r.result for r in self._records.values() if r.result is not None]
        kept = {result["dir"] for result in results}
        for folder in self._folder.glob("frame-*"):
            if folder.name not in kept:
                remove_tree(folder)


def total_of(stats: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The statistics of several images as those of one: sums, or the largest."""
    total = dict(stats[0])
    for name, first in stats[0].items():
        if isinstance(first, bool | str) or first is None:
            continue
        values = [entry.get(name, 0) for entry in stats]
        total[name] = sum(values) if name.endswith("_s") or name in _COUNTS else max(values)
    rays = total["camera_rays"] + total["bounce_rays"] + total["shadow_rays"]
    total["rays_per_s"] = rays / total["render_s"] if total["render_s"] > 0 else 0.0
    return total


def _error_of(failed: Sequence[FrameRecord], count: int) -> dict[str, Any]:
    first = failed[0]
    error = dict(first.error or {})
    which = f"frame {first.frame.name} of {count} failed"
    if len(failed) > 1:
        which = f"{len(failed)} of {count} frames failed, the first of them {first.frame.name}"
    error["detail"] = f"{which}: {error.get('detail', 'unknown')}"
    error["frames"] = [record.frame.number for record in failed[:1000]]
    return error
