"""The life of jobs against a model: whatever happens in whatever order, store and model agree."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    Bundle,
    RuleBasedStateMachine,
    consumes,
    initialize,
    invariant,
    multiple,
    precondition,
    rule,
)
from raykiln_service.database import Database
from raykiln_service.errors import ConflictError, GoneError, LeaseLostError, NotFoundError
from raykiln_service.idempotency import IDEMPOTENCY_MS
from raykiln_service.jobs import TRANSITIONS, JobEvent, JobSpec, JobState, Lease
from raykiln_service.leases import MAX_STALLS
from raykiln_service.store import Store

STEP_MS = 600_000
ERROR = {"reason": "crashed", "detail": "it broke"}
LIVE = (JobState.QUEUED, JobState.RUNNING)


class Clock:
    """A clock that rules set."""

    def __init__(self) -> None:
        self.ms = 10**12

    def __call__(self) -> int:
        return self.ms


@dataclass
class Model:
    """What a job must look like."""

    seq: int
    priority: int
    queued_ms: int
    max_attempts: int
    state: JobState = JobState.QUEUED
    attempts: int = 0
    failures: int = 0
    interruptions: int = 0
    stalls: int = 0
    not_before_ms: int = 0
    cancel_requested: bool = False
    lease: Lease | None = None
    result: dict[str, Any] | None = None
    story: list[JobState] = field(default_factory=lambda: [JobState.QUEUED])

    def move(self, state: JobState) -> None:
        self.state = state
        self.story.append(state)
        if state is not JobState.RUNNING:
            self.lease = None

    @property
    def rank(self) -> tuple[int, int]:
        return self.queued_ms - self.priority * STEP_MS, self.seq

    def is_due(self, now: int) -> bool:
        return self.not_before_ms <= now or self.not_before_ms > now + 300_000


@cache
def _empty_database() -> bytes:
    with tempfile.TemporaryDirectory(prefix="raykiln-machine-") as folder:
        path = Path(folder) / "jobs.db"
        database = Database(Database.sqlite_url(path))
        database.migrate()
        database.close()
        return path.read_bytes()


class Lives(RuleBasedStateMachine):
    """Users, dispatchers, crashes and clocks, in any order."""

    ids = Bundle("ids")
    leases = Bundle("leases")

    @initialize()
    def start(self) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="raykiln-machine-")
        self.clock = Clock()
        path = Path(self.folder.name) / "jobs.db"
        path.write_bytes(_empty_database())
        self.url = Database.sqlite_url(path)
        self.open()
        self.jobs: dict[str, Model] = {}
        self.keys: dict[str, tuple[str, int]] = {}
        self.made = 0
        self.paused = False

    def open(self) -> None:
        self.store = Store(Database(self.url), clock=self.clock, priority_step_s=STEP_MS / 1000)

    def teardown(self) -> None:
        if hasattr(self, "folder"):
            self.store.database.close()
            self.folder.cleanup()

    # Users

    @rule(
        target=ids,
        priority=st.integers(-3, 3),
        attempts=st.integers(1, 3),
        key=st.none() | st.sampled_from("abc"),
    )
    def submit(self, priority: int, attempts: int, key: str | None) -> Any:
        job_id = f"job-{self.made}"
        spec = JobSpec({"name": "x"}, {}, priority=priority)
        known, kept_ms = self.keys.get(key or "", (None, 0))
        if self.clock.ms - kept_ms > IDEMPOTENCY_MS:
            known = None  # a key is kept for a day
        if known is not None and known not in self.jobs:
            with pytest.raises(GoneError):
                self.store.create_job(job_id, spec, key=key, digest="d")
            return multiple()
        job, created = self.store.create_job(
            job_id, spec, max_attempts=attempts, key=key, digest="d"
        )
        if known is not None:
            assert (job.id, created) == (known, False)
            return multiple()
        assert created
        self.made += 1
        self.jobs[job_id] = Model(self.made, priority, self._queued_ms(), attempts)
        if key is not None:
            self.keys[key] = (job_id, self.clock.ms)
        return job_id

    @rule(target=ids, priority=st.integers(-3, 3))
    def submit_what_is_known(self, priority: int) -> str:
        job_id = f"job-{self.made}"
        self.made += 1
        result = {"dir": job_id}
        spec = JobSpec({"name": "x"}, {}, priority=priority)
        self.store.create_job(job_id, spec, answer=result)
        model = Model(self.made, priority, self._queued_ms(), 3, result=result)
        model.move(JobState.SUCCEEDED)
        self.jobs[job_id] = model
        return job_id

    @rule(job_id=ids)
    def cancel(self, job_id: str) -> None:
        model = self.jobs.get(job_id)
        if model is None:
            with pytest.raises(NotFoundError):
                self.store.cancel(job_id)
        elif model.state in (JobState.SUCCEEDED, JobState.FAILED):
            with pytest.raises(ConflictError):
                self.store.cancel(job_id)
        else:
            self.store.cancel(job_id)
            if model.state is JobState.RUNNING:
                model.cancel_requested = True
            elif model.state is JobState.QUEUED:
                model.move(JobState.CANCELLED)

    @rule(job_id=ids)
    def retry(self, job_id: str) -> None:
        model = self.jobs.get(job_id)
        if model is None or (model.state, JobEvent.RETRY) not in TRANSITIONS:
            with pytest.raises(NotFoundError if model is None else ConflictError):
                self.store.retry(job_id)
            return
        queued_ms = self._queued_ms()
        self.store.retry(job_id)
        model.queued_ms = queued_ms
        model.failures = model.stalls = model.not_before_ms = 0
        model.cancel_requested = False
        model.result = None
        model.move(JobState.QUEUED)

    @rule(job_id=ids)
    def delete(self, job_id: str) -> None:
        model = self.jobs.get(job_id)
        if model is None or model.state in LIVE:
            with pytest.raises(NotFoundError if model is None else ConflictError):
                self.store.delete(job_id)
            return
        self.store.delete(job_id)
        del self.jobs[job_id]

    @rule(pause=st.booleans())
    def pause_or_resume(self, pause: bool) -> None:
        self.store.pause("why") if pause else self.store.resume()
        self.paused = pause

    # Dispatchers

    @rule(target=leases)
    def claim(self) -> Any:
        due = [
            (model.rank, job_id)
            for job_id, model in self.jobs.items()
            if model.state is JobState.QUEUED and model.is_due(self.clock.ms)
        ]
        job = self.store.claim("me", 30.0)
        if self.paused or not due:
            assert job is None
            return multiple()
        assert job is not None
        assert job.id == min(due)[1]
        model = self.jobs[job.id]
        model.attempts += 1
        model.move(JobState.RUNNING)
        model.lease = job.lease
        return job.lease

    @rule(lease=leases, advanced=st.booleans())
    def heartbeat(self, lease: Lease, advanced: bool) -> None:
        model = self._holder(lease)
        if model is None:
            with pytest.raises(LeaseLostError):
                self.store.heartbeat(lease, 30.0, {"spp_done": 1}, advanced=advanced)
            return
        self.store.heartbeat(lease, 30.0, {"spp_done": 1}, advanced=advanced)
        if advanced:
            model.stalls = 0

    @rule(lease=leases)
    def succeed(self, lease: Lease) -> None:
        model = self._holder(lease)
        result = {"dir": lease.token}
        if model is None:
            with pytest.raises(LeaseLostError):
                self.store.succeed(lease, result)
            return
        self.store.succeed(lease, result)
        model.result = result
        model.move(JobState.CANCELLED if model.cancel_requested else JobState.SUCCEEDED)

    @rule(lease=leases)
    def fail(self, lease: Lease) -> None:
        model = self._holder(lease)
        if model is None:
            with pytest.raises(LeaseLostError):
                self.store.fail(lease, ERROR)
            return
        self.store.fail(lease, ERROR)
        model.move(JobState.CANCELLED if model.cancel_requested else JobState.FAILED)

    @rule(lease=consumes(leases), own_fault=st.booleans(), delay_s=st.sampled_from([0, 5, 1e9]))
    def lose(self, lease: Lease, own_fault: bool, delay_s: float) -> None:
        model = self._holder(lease)
        if model is None:
            with pytest.raises(LeaseLostError):
                self.store.lose(lease, ERROR, own_fault=own_fault, delay_s=delay_s)
            return
        self.store.lose(lease, ERROR, own_fault=own_fault, delay_s=delay_s)
        self._lost(model, own_fault, delay_s)

    @rule(lease=leases)
    def release(self, lease: Lease) -> None:
        model = self._holder(lease)
        if model is None:
            with pytest.raises(LeaseLostError):
                self.store.release(lease)
            return
        self.store.release(lease)
        model.move(JobState.CANCELLED if model.cancel_requested else JobState.QUEUED)

    # The world

    @rule()
    def the_service_dies(self) -> None:
        # Without closing anything in order: what is committed is all that counts.
        self.store.database.close()
        self.open()
        for lease in self.store.leases_of_others("another"):
            assert self.store.void(lease)
        for model in self.jobs.values():
            if model.state is JobState.RUNNING:
                self._lost(model, own_fault=False, delay_s=0)

    @rule(by_ms=st.sampled_from([1, 1000, 10_000, 10**7, 10**11, -1, -10_000, -(10**11)]))
    def the_clock_moves(self, by_ms: int) -> None:
        self.clock.ms += by_ms

    # What must hold

    @precondition(lambda self: hasattr(self, "jobs"))
    @invariant()
    def store_and_model_agree(self) -> None:
        assert self.store.job_ids() == set(self.jobs)
        for job_id, model in self.jobs.items():
            job = self.store.job(job_id)
            for name in ("state", "attempts", "failures", "interruptions", "stalls", "lease"):
                assert getattr(job, name) == getattr(model, name), (job_id, name)
            assert job.cancel_requested == model.cancel_requested
            if model.state is JobState.SUCCEEDED:
                assert job.result == model.result
            assert (job.error is not None) == (job.state is JobState.FAILED)
            assert (job.finished_ms is not None) == job.state.is_final
            events = self.store.events_after(job_id, 0)
            assert [event.data["state"] for event in events] == model.story
        counts = self.store.count_by_state()
        for state in JobState:
            assert counts[state] == sum(m.state is state for m in self.jobs.values())

    @precondition(lambda self: hasattr(self, "jobs"))
    @invariant()
    def the_queue_has_its_order(self) -> None:
        waiting = [(m.rank, i) for i, m in self.jobs.items() if m.state is JobState.QUEUED]
        assert [job.id for job in self.store.waiting()] == [i for _rank, i in sorted(waiting)]
        assert (self.store.paused() is not None) == self.paused

    # Inside

    def _queued_ms(self) -> int:
        waiting = [m for m in self.jobs.values() if m.state is JobState.QUEUED]
        newest = max(waiting, key=lambda m: m.seq, default=None)
        return max(self.clock.ms, 0 if newest is None else newest.queued_ms)

    def _holder(self, lease: Lease) -> Model | None:
        model = self.jobs.get(lease.job_id)
        return model if model is not None and model.lease == lease else None

    def _lost(self, model: Model, own_fault: bool, delay_s: float) -> None:
        model.failures += own_fault
        model.stalls += not own_fault
        model.interruptions += not own_fault
        over = model.failures >= model.max_attempts or model.stalls >= MAX_STALLS
        if not over:
            model.not_before_ms = self.clock.ms + int(min(delay_s, 300) * 1000)
        end = JobState.FAILED if over else JobState.QUEUED
        model.move(JobState.CANCELLED if model.cancel_requested else end)


_QUICK = settings(
    max_examples=8,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    database=None,
    report_multiple_bugs=False,
    suppress_health_check=list(HealthCheck),
)


def _test_case(chosen: settings) -> Any:
    return type("Case", (Lives.TestCase,), {"settings": chosen})


TestLives = _test_case(_QUICK)
TestManyLives = pytest.mark.slow(
    _test_case(settings(_QUICK, max_examples=120, stateful_step_count=60))
)
