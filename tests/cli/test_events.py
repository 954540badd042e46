"""The decoder of server-sent events, and the rules for trying again."""

from __future__ import annotations

import json
from itertools import pairwise

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raykiln_service.client.calls import Call, RetryPolicy, check_server, may_retry
from raykiln_service.client.models import (
    Event,
    EventDecoder,
    ServerError,
    ServerUnreachableError,
)
from raykiln_service.client.requests import submit

STREAM = (
    ': hello\nid: 1\nevent: state\ndata: {"state": "running"}\n\n'
    'event: progress\r\ndata: {"fraction":\r\ndata: 0.5}\r\n\r\n'
    "id: 2\rdata: plain\r\r"
    "event: empty\n\n"
)
EVENTS = [
    Event("state", {"state": "running"}, "1"),
    Event("progress", {"fraction": 0.5}, "1"),
    Event("message", "plain", "2"),
]


@given(st.lists(st.integers(0, len(STREAM))))
def test_a_stream_may_be_cut_anywhere(cuts: list[int]) -> None:
    decoder = EventDecoder()
    edges = [0, *sorted(cuts), len(STREAM)]
    pieces = [STREAM[a:b] for a, b in pairwise(edges)]
    assert [event for piece in pieces for event in decoder.feed(piece)] == EVENTS
    assert decoder.last_id == "2"


@given(st.text(max_size=50))
def test_any_text_survives(text: str) -> None:
    """Also the line separators of Unicode, which are no line ends of an event stream."""
    stream = f"data: {json.dumps(text, ensure_ascii=False)}\n\n"
    (event,) = EventDecoder().feed(stream)
    assert event.data == text


def test_a_lost_connection_drops_the_half_event_and_its_id() -> None:
    decoder = EventDecoder()
    decoder.feed("id: 7\ndata: 1\n\nid: 8\ndata: ha")
    decoder.reset()
    assert decoder.feed("data: 2\n\n") == [Event("message", 2, "7")]


def test_only_repeatable_calls_are_sent_twice() -> None:
    broken = httpx.ReadError("reset")
    refused = httpx.ConnectError("refused")
    read = Call("GET", "/v1/jobs")
    cancel = Call("POST", "/v1/jobs/1/cancel", repeatable=False)
    assert may_retry(broken, read)
    assert not may_retry(broken, cancel)
    # Nothing was sent, so nothing can happen twice.
    assert may_retry(refused, cancel)
    assert may_retry(ServerError(503, {}), read)
    assert not may_retry(ServerError(503, {}), cancel)
    assert not may_retry(ServerError(422, {}), read)


def test_the_pause_grows_follows_the_service_and_ends() -> None:
    policy = RetryPolicy(retries=3)
    call = Call("GET", "/v1/jobs")
    error = httpx.ReadError("reset")
    pauses = [policy.pause_s(tried, error, call) for tried in (1, 2, 3, 4)]
    assert pauses[3] is None
    assert pauses[0] is not None
    assert pauses[2] is not None
    assert pauses[0] < pauses[2]
    assert policy.pause_s(1, ServerError(429, {}, retry_after_s=7.0), call) == 7.0
    assert policy.pause_s(1, ServerError(429, {}, retry_after_s=3600.0), call) is None


def test_a_submission_carries_a_key_of_its_own() -> None:
    calls = [submit({"name": "a"}).call for _ in range(2)]
    keys = {call.headers["Idempotency-Key"] for call in calls}
    assert len(keys) == 2
    assert all(call.repeatable for call in calls)


@pytest.mark.parametrize("url", ["", "localhost:8000", "ftp://x", "http://", "http://a:b:c", "x"])
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ServerUnreachableError, match="not "):
        check_server(url)


def test_a_problem_reads_as_one_line() -> None:
    error = ServerError(
        422,
        {
            "title": "The scene cannot be rendered",
            "detail": "unknown material",
            "pointer": "/shapes/0/material",
            "found": "gold",
            "accepted": "silver",
        },
    )
    assert str(error) == "/shapes/0/material: unknown material (found gold); accepted: silver"
