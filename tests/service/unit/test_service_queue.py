"""The queue: its order, its pause, and answers that need no render."""

from __future__ import annotations

from typing import Any

import pytest
from raykiln_service.jobs import Job, JobSpec, JobState, Lease
from raykiln_service.rows import StateEvent
from raykiln_service.store import Store
from raykiln_service.store_queue import Pause

SPEC = JobSpec({"name": "cornell_box"}, {"spp": 4})
RESULT = {"dir": "result-x", "files": []}
ERROR = {"reason": "crashed", "detail": "it broke"}


def add(store: Store, job_id: str = "job-1", priority: int = 0) -> Job:
    spec = JobSpec({"name": "cornell_box"}, {}, priority=priority)
    return store.create_job(job_id, spec)[0]


def claim(store: Store) -> Lease:
    job = store.claim("me", 30.0)
    assert job is not None
    assert job.lease is not None
    return job.lease


def test_waiting_makes_up_for_priority(store: Store, clock: Any) -> None:
    step_ms = store.priority_step_ms
    add(store, "old")
    clock.ms += step_ms + 1
    add(store, "new", priority=1)
    add(store, "newer and higher", priority=2)
    order = ["newer and higher", "old", "new"]
    assert [job.id for job in store.waiting()] == order
    assert [claimed.id for _ in order if (claimed := store.claim("me", 30.0))] == order


def test_no_stream_of_high_priorities_starves_a_low_one(store: Store, clock: Any) -> None:
    add(store, "low", priority=-1000)
    levels_a_day = 24 * 3_600_000 // store.priority_step_ms
    for day in range(100):
        add(store, f"high-{day}", priority=1000)
        if claim(store).job_id == "low":
            break
        clock.ms += 24 * 3_600_000
    assert day == 2000 // levels_a_day + 1


def test_a_clock_that_is_set_back_lets_nobody_pass(store: Store, clock: Any) -> None:
    add(store, "first")
    clock.ms -= 900_000
    add(store, "second")
    assert [job.id for job in store.waiting()] == ["first", "second"]
    assert store.claim("me", 30.0) is not None


def test_a_clock_that_is_set_back_does_not_prolong_a_back_off(store: Store, clock: Any) -> None:
    clock.ms += 10_000_000_000
    add(store)
    store.lose(claim(store), ERROR, own_fault=True, delay_s=2.0)
    assert store.claim("me", 30.0) is None
    clock.ms -= 5_000_000_000
    assert store.claim("me", 30.0) is not None


def test_a_retried_job_goes_to_the_end(store: Store, clock: Any) -> None:
    add(store, "a")
    store.cancel("a")
    clock.ms += 1
    add(store, "b")
    clock.ms += 1
    store.retry("a")
    assert [job.id for job in store.waiting()] == ["b", "a"]


def test_a_lost_job_keeps_its_place(store: Store, clock: Any) -> None:
    add(store, "a")
    lease = claim(store)
    clock.ms += 1
    add(store, "b")
    store.lose(lease, ERROR, own_fault=True)
    assert [job.id for job in store.waiting()] == ["a", "b"]


def test_another_priority_step_reorders_what_waits(store: Store, clock: Any) -> None:
    add(store, "a")
    clock.ms += 60_000
    add(store, "b", priority=1)
    assert [job.id for job in store.waiting()] == ["b", "a"]
    other = Store(store.database, clock=clock, priority_step_s=1.0)
    other.rerank()
    assert [job.id for job in store.waiting()] == ["a", "b"]


def test_a_pause_begins_nothing_and_survives(store: Store, clock: Any) -> None:
    add(store, "a")
    lease = claim(store)
    add(store, "b")
    heard: list[str] = []
    store.listen_to_queue(lambda: heard.append("changed"))
    assert store.pause("maintenance") == Pause(1_000_000, "maintenance")
    clock.ms += 1
    assert store.pause("another reason") == Pause(1_000_000, "maintenance")
    assert store.claim("me", 30.0) is None
    assert Store(store.database, clock=clock).paused() == Pause(1_000_000, "maintenance")
    # What runs goes on, and what comes waits.
    store.heartbeat(lease, 30.0, None, advanced=False)
    assert store.succeed(lease, RESULT) is JobState.SUCCEEDED
    add(store, "c")
    store.resume()
    assert store.paused() is None
    assert claim(store).job_id == "b"
    assert heard == ["changed"] * 3


def test_a_result_that_is_there_answers_at_once(store: Store) -> None:
    heard: list[StateEvent] = []
    store.listen(heard.append)
    job, created = store.create_job("job-1", SPEC, answer=RESULT, max_queued=0)
    assert (created, job.state, job.result, job.attempts) == (True, JobState.SUCCEEDED, RESULT, 0)
    assert [event.data["state"] for event in heard] == ["queued", "succeeded"]


def test_an_answer_that_breaks_half_way_leaves_nothing(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_arguments: object) -> None:
        raise OSError("half-way")

    monkeypatch.setattr(store, "_answer", broken)
    with pytest.raises(OSError, match="half-way"):
        store.create_job("job-1", SPEC, answer=RESULT)
    assert store.job_ids() == set()
