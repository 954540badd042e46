"""The table of transitions: each legal one, and none besides."""

from __future__ import annotations

import itertools

import pytest
from raykiln_service.jobs import (
    TRANSITIONS,
    IllegalTransitionError,
    JobEvent,
    JobState,
    new_job_id,
    next_state,
)

LEGAL = {
    ("queued", "claim"): "running",
    ("queued", "answer"): "succeeded",
    ("queued", "cancel"): "cancelled",
    ("running", "succeed"): "succeeded",
    ("running", "fail"): "failed",
    ("running", "cancel"): "cancelled",
    ("running", "lose"): "queued",
    ("failed", "retry"): "queued",
    ("cancelled", "retry"): "queued",
}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(JobState, JobEvent)))
def test_each_pair_of_state_and_event(state: JobState, event: JobEvent) -> None:
    wanted = LEGAL.get((state.value, event.value))
    if wanted is None:
        with pytest.raises(IllegalTransitionError, match=f"{state.value} cannot {event.value}"):
            next_state(state, event)
    else:
        assert next_state(state, event) == wanted


def test_every_state_can_be_reached() -> None:
    assert {JobState.QUEUED, *TRANSITIONS.values()} == set(JobState)


def test_ids_sort_by_time_and_differ() -> None:
    ids = [new_job_id() for _ in range(100)]
    assert len(set(ids)) == 100
    assert [i.split("-")[1] for i in ids] == sorted(i.split("-")[1] for i in ids)
