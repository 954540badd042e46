"""Frames in the store, the plan of a turntable, and what is made of the pictures."""

from __future__ import annotations

import importlib.util
import itertools
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raykiln.settings import RenderSettings
from raykiln_service.archive import archive_of, entries_of, tag_of
from raykiln_service.attempt_frames import total_of
from raykiln_service.errors import InvalidRequestError, LeaseLostError, NotFoundError
from raykiln_service.executors.base import OutcomeKind, StopReason
from raykiln_service.executors.contact_sheet import contact_sheet, fitted, shrunk, thumb_size
from raykiln_service.executors.gatherer import Gathering, gather
from raykiln_service.framing import checked_outputs, plan_frames
from raykiln_service.jobs import FrameState, Job, JobSpec, JobState
from raykiln_service.planner import Frame, playback_fps
from raykiln_service.schemas_frames import FrameChoice
from raykiln_service.store import Store

RESULT = {"dir": "frame-0001-a", "files": [], "complete": True}
ERROR = {"reason": "crashed", "detail": "it broke"}


def add(store: Store, count: int, job_id: str = "job-1") -> Job:
    planned = tuple(Frame(i + 1, {"seed": i}) for i in range(count))
    spec = JobSpec({"name": "x"}, {}, frames={"cameras": "all"}, planned=planned)
    return store.create_job(job_id, spec)[0]


def claim(store: Store) -> Any:
    job = store.claim("me", 30.0)
    assert job is not None
    assert job.lease is not None
    return job.lease


# The store.


def test_frames_are_kept_with_their_job(store: Store) -> None:
    add(store, 3)
    add(store, 1, "job-2")
    assert store.job("job-1").spec.frames == {"cameras": "all"}
    records = store.frames("job-1")
    assert [record.frame for record in records] == [Frame(i, {"seed": i - 1}) for i in (1, 2, 3)]
    assert {record.state for record in records} == {FrameState.QUEUED}
    assert [r.frame.number for r in store.frames("job-1", after=1, limit=1)] == [2]
    assert store.frame("job-1", 3).frame.settings == {"seed": 2}
    for job_id, number in (("job-1", 4), ("job-1", 0), ("job-3", 1)):
        with pytest.raises(NotFoundError):
            store.frame(job_id, number)
    counts = store.frame_counts(["job-1", "job-2"])
    assert {job_id: count[FrameState.QUEUED] for job_id, count in counts.items()} == {
        "job-1": 3,
        "job-2": 1,
    }
    assert store.frame_counts([]) == {}


def test_a_frame_counts_once(store: Store) -> None:
    add(store, 2)
    lease = claim(store)
    store.end_frame(lease, 1, FrameState.SUCCEEDED, result=RESULT)
    store.end_frame(lease, 1, FrameState.SUCCEEDED, result={**RESULT, "dir": "another"})
    store.end_frame(lease, 1, FrameState.FAILED, error=ERROR)
    record = store.frame("job-1", 1)
    assert (record.state, record.result, record.failures) == (FrameState.SUCCEEDED, RESULT, 0)


def test_a_lost_attempt_changes_no_frame(store: Store) -> None:
    add(store, 1)
    lost = claim(store)
    store.release(lost)
    current = claim(store)
    with pytest.raises(LeaseLostError):
        store.end_frame(lost, 1, FrameState.SUCCEEDED, result=RESULT)
    assert store.frame("job-1", 1).state is FrameState.QUEUED
    store.end_frame(current, 1, FrameState.SUCCEEDED, result=RESULT)
    store.succeed(current, RESULT)
    with pytest.raises(LeaseLostError):
        store.end_frame(current, 1, FrameState.FAILED, error=ERROR)


def test_a_job_with_open_frames_cannot_succeed(store: Store) -> None:
    add(store, 2)
    lease = claim(store)
    store.end_frame(lease, 1, FrameState.SUCCEEDED, result=RESULT)
    with pytest.raises(AssertionError, match="did not succeed"):
        store.succeed(lease, RESULT)
    assert store.job("job-1").state is JobState.RUNNING
    store.end_frame(lease, 2, FrameState.SUCCEEDED, result=RESULT)
    assert store.succeed(lease, RESULT) is JobState.SUCCEEDED


def test_failures_are_counted_and_a_retry_forgives_them(store: Store) -> None:
    add(store, 3)
    lease = claim(store)
    store.end_frame(lease, 1, FrameState.SUCCEEDED, result=RESULT)
    store.end_frame(lease, 2, FrameState.QUEUED, error=ERROR)
    store.end_frame(lease, 2, FrameState.FAILED, error=ERROR)
    store.end_frame(lease, 3, FrameState.CANCELLED, result=RESULT)
    failed = store.frame("job-1", 2)
    assert (failed.state, failed.failures, failed.error) == (FrameState.FAILED, 2, ERROR)
    store.fail(lease, ERROR, RESULT)
    assert store.job("job-1").result == RESULT
    store.retry("job-1")
    states = [record.state for record in store.frames("job-1")]
    assert states == [FrameState.SUCCEEDED, FrameState.QUEUED, FrameState.QUEUED]
    again = store.frame("job-1", 2)
    assert (again.failures, again.error, again.result) == (0, None, None)


def test_a_frame_that_ends_forgives_interruptions(store: Store) -> None:
    add(store, 1)
    store.lose(claim(store), ERROR, own_fault=False)
    lease = claim(store)
    assert store.job("job-1").stalls == 1
    store.end_frame(lease, 1, FrameState.QUEUED, error=ERROR)
    assert store.job("job-1").stalls == 0


def test_frames_go_with_their_job(store: Store) -> None:
    add(store, 2)
    store.cancel("job-1")
    store.delete("job-1")
    assert store.frames("job-1") == []


def test_a_pause_before_a_frame_is_tried_again(store: Store, clock: Any) -> None:
    add(store, 1)
    store.release(claim(store), delay_s=2.0)
    assert store.claim("me", 30.0) is None
    clock.ms += 2000
    claim(store)


# The plan.

REPORT: dict[str, Any] = {
    "cameras": ["a", "b"],
    "views": [
        {"name": "a", "transform": np.eye(4).tolist()},
        {"name": "b", "look_at": {"origin": [0, 0, 5], "target": [0, 0, 1]}},
    ],
    "targets": [[0.0, 0.0, -2.0], [0.0, 0.0, 1.0]],
    "time_range_s": None,
}


def planned(frames: dict[str, Any], **settings: Any) -> tuple[Frame, ...]:
    given = RenderSettings(**settings)
    return plan_frames(FrameChoice.model_validate(frames), given, given, REPORT, 10)


def test_a_turntable_turns_about_what_its_camera_looks_at() -> None:
    def eye(frame: Frame) -> Any:
        assert frame.camera is not None
        return np.array(frame.camera["transform"])[:3, 3]

    turn = {"turntable": {"count": 2}}
    assert eye(planned(turn)[1]) == pytest.approx([0, 0, -4])
    assert eye(planned(turn, camera="b")[1]) == pytest.approx([0, 0, -3])
    aimed = {"turntable": {"count": 2, "target": [1, 0, 0]}}
    assert eye(planned(aimed, camera="b")[1]) == pytest.approx([2, 0, -5])


def test_seeds_wrap_around() -> None:
    frames = planned({"cameras": ["a", "b"], "vary_seed": True}, seed=(1 << 32) - 1)
    assert [frame.settings["seed"] for frame in frames] == [(1 << 32) - 1, 0]


def test_the_speed_of_animations() -> None:
    assert playback_fps({"cameras": "all"}) == 12
    assert playback_fps({"cameras": "all", "fps": 2}) == 2
    assert playback_fps({"time": {"fps": 30}}) == 30
    assert playback_fps({"time": {}}) == 24


def test_outputs_that_need_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = FrameChoice.model_validate({"turntable": {"count": 2}})
    assert checked_outputs(None, None) == ("exr", "png")
    assert checked_outputs(None, turn) == ("exr", "png", "contact_sheet")
    assert checked_outputs(["exr", "exr"], turn) == ("exr",)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for name, library in (("webp", "Pillow"), ("mp4", "PyAV")):
        with pytest.raises(InvalidRequestError, match=library) as caught:
            checked_outputs(["exr", name], turn)
        assert caught.value.pointer == "/outputs/1"


def test_totals() -> None:
    one = {
        "render_s": 2.0, "samples": 5, "camera_rays": 6, "bounce_rays": 3, "shadow_rays": 1,
        "spp": 4, "isa": "x", "rays_per_s": 5.0, "peak_memory_bytes": 7, "warm": False,
    }  # fmt: skip
    total = total_of([one, {**one, "peak_memory_bytes": 9, "spp": 2}])
    assert total == {
        **one, "render_s": 4.0, "samples": 10, "camera_rays": 12, "bounce_rays": 6,
        "shadow_rays": 2, "rays_per_s": 5.0, "peak_memory_bytes": 9,
    }  # fmt: skip


# Pictures.


def test_shrinking_keeps_the_mean() -> None:
    image = np.random.default_rng(1).random((30, 47, 3), dtype=np.float32)
    small = shrunk(image, 10, 7)
    assert small.shape == (7, 10, 3)
    assert small.mean(axis=(0, 1)) == pytest.approx(image.mean(axis=(0, 1)), rel=1e-5)
    assert np.allclose(shrunk(image, 47, 30), image, atol=1e-6)
    exact = shrunk(image[:28, :40], 10, 7)
    assert np.allclose(exact, image[:28, :40].reshape(7, 4, 10, 4, 3).mean(axis=(1, 3)), atol=1e-6)


@pytest.mark.parametrize(("count", "size"), [(1, (64, 64)), (7, (100, 20)), (300, (8, 400))])
def test_a_sheet_has_room_for_every_frame(count: int, size: tuple[int, int]) -> None:
    width, height = thumb_size(count, *size)
    colours = itertools.cycle((80, 120, 160))
    frames = [
        (i + 1, np.full((height, width, 3), c, np.uint8))
        for i, c in zip(range(count), colours, strict=False)
    ]
    sheet = contact_sheet(iter(frames), count, (width, height))
    inked = np.isin(sheet[:, :, 0], (80, 120, 160)).sum()
    assert inked == count * width * height
    assert max(sheet.shape[:2]) < 4096


def test_the_numbers_differ() -> None:
    picture = np.zeros((20, 40, 3), np.uint8)
    labels = {
        contact_sheet([(number, picture)], 1, (40, 20))[28:].tobytes() for number in range(1, 200)
    }
    assert len(labels) == 199


def test_sizes() -> None:
    assert fitted(4000, 1000, 960) == (960, 240)
    assert fitted(64, 48, 960) == (64, 48)
    assert fitted(10_000, 1, 960) == (960, 1)


def test_an_archive_tells_when_it_changes(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "stats.json").write_text("{}")
    result = {"dir": "r", "files": [{"name": "stats.json", "sha256": "1"}]}
    entries = entries_of(tmp_path, result, [], "log.txt")
    assert [entry.name for entry in entries] == ["stats.json"]
    (tmp_path / "log.txt").write_text("begins")
    with_log = entries_of(tmp_path, result, [], "log.txt")
    assert tag_of(with_log) != tag_of(entries)
    assert b"".join(archive_of(with_log)) == b"".join(archive_of(with_log))
    assert entries_of(tmp_path, None, [], "log.txt") == []


class Recorder:
    """A watcher that notes what it hears, and stops when told to."""

    def __init__(self, stop: StopReason | None = None) -> None:
        self.heard: list[Any] = []
        self.lines: list[str] = []
        self._stop = stop

    def progress(self, progress: Any) -> None:
        self.heard.append(progress)

    def preview(self) -> None:
        raise AssertionError("there is no preview of a sheet")

    def log(self, line: str) -> None:
        self.lines.append(line)

    def stop_reason(self) -> StopReason | None:
        return self._stop


def gathering(folder: Path) -> Gathering:
    return Gathering(
        frames=[(1, folder / "missing.exr")],
        outputs=["contact_sheet"],
        fps=12,
        job_dir=folder,
        work_dir=folder,
        memory_bytes=1 << 30,
        sandbox="auto",
    )


def test_frames_that_cannot_be_read_break_the_gathering(tmp_path: Path) -> None:
    outcome = gather(gathering(tmp_path), Recorder())
    assert outcome.kind is OutcomeKind.BROKEN
    assert outcome.error["reason"] == "gather-error"
    assert "missing.exr" in outcome.error["detail"]


@pytest.mark.parametrize(
    ("program", "detail"),
    [
        ("import os; os.kill(os.getpid(), 9)", "ended by SIGKILL"),
        ("raise SystemExit(3)", "exited with code 3"),
    ],
)
def test_a_gatherer_that_dies_breaks_the_gathering(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, detail: str
) -> None:
    (tmp_path / "odd_gather.py").write_text(textwrap.dedent(program))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    outcome = gather(gathering(tmp_path), Recorder(), module="odd_gather")
    assert outcome.kind is OutcomeKind.BROKEN
    assert detail in outcome.error["detail"]


def test_a_stop_ends_the_gathering_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "odd_gather.py").write_text("import time; time.sleep(600)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    watcher = Recorder(StopReason.CANCEL)
    outcome = gather(gathering(tmp_path), watcher, module="odd_gather")
    assert outcome.kind is OutcomeKind.STOPPED
