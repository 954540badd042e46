"""The queue over HTTP: places, times, pauses; and answers from the result cache."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

SMALL = {"width": 32, "height": 24, "spp": 4}


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


@pytest.fixture
def paused(client: httpx.Client) -> Iterator[None]:
    """A pause of the queue for the length of a test."""
    client.post("/v1/queue/pause", json={"reason": "a test"}).raise_for_status()
    yield
    client.post("/v1/queue/resume").raise_for_status()


def queue(client: httpx.Client) -> dict[str, Any]:
    view: dict[str, Any] = client.get("/v1/queue").raise_for_status().json()
    return view


def test_a_pause_holds_jobs_back_and_a_resume_lets_them_go(
    client: httpx.Client, server: Any, ball: dict[str, Any], paused: None
) -> None:
    jobs = [
        server.submit(scene={"inline": ball}, settings={**SMALL, "seed": seed}, cache=False)
        for seed in range(3)
    ]
    view = queue(client)
    assert (view["paused"], view["pause_reason"], view["queued"]) == (True, "a test", 3)
    assert view["drained_in_s"] is None
    found = [server.job(job["id"]) for job in jobs]
    assert [job["state"] for job in found] == ["queued"] * 3
    assert [job["queue_position"] for job in found] == [0, 1, 2]
    assert [job["eta"]["start_s"] for job in found] == [None] * 3
    client.post("/v1/queue/resume").raise_for_status()
    for job in jobs:
        assert server.wait_for_end(job["id"])["state"] == "succeeded"
    assert not queue(client)["paused"]


def test_the_answer_tells_what_the_call_has_done(client: httpx.Client) -> None:
    for _ in range(3):
        assert client.post("/v1/queue/pause").json()["paused"] is True
        assert client.post("/v1/queue/resume").json()["paused"] is False


def test_a_pause_survives_a_kill(serve: Any, ball: dict[str, Any]) -> None:
    server = serve()
    with server.client() as client:
        client.post("/v1/queue/pause").raise_for_status()
    server.kill_all()
    server = serve()
    job = server.submit(scene={"inline": ball}, settings=SMALL)
    with server.client() as client:
        assert queue(client)["paused"]
        assert server.job(job["id"])["state"] == "queued"
        client.post("/v1/queue/resume").raise_for_status()
    assert server.wait_for_end(job["id"])["state"] == "succeeded"


def test_times_are_unknown_until_there_is_something_to_go_by(
    serve: Any, ball: dict[str, Any]
) -> None:
    server = serve()
    with server.client() as client:
        assert queue(client)["samples_per_s"] is None
        first = server.submit(scene={"inline": ball}, settings={**SMALL, "spp": 64})
        server.wait_for_end(first["id"])
        client.post("/v1/queue/pause").raise_for_status()
        same = server.submit(scene={"inline": ball}, settings={**SMALL, "spp": 128})
        other = server.submit(scene={"name": "cornell_box"}, settings=SMALL)
        client.post("/v1/queue/resume").raise_for_status()
        client.post("/v1/queue/pause").raise_for_status()
        assert same["eta"] == {"start_s": None, "end_s": None, "basis": "scene"}
        # One job of another scene says nothing about this one.
        assert other["eta"]["basis"] is None
        client.post("/v1/queue/resume").raise_for_status()
        for job in (same, other):
            assert server.wait_for_end(job["id"])["eta"] is None


@pytest.mark.parametrize(
    ("body", "pointer"), [({"reason": 5}, "/reason"), ({"until": 1}, "/until"), ([1], None)]
)
def test_a_pause_that_is_none(client: httpx.Client, body: Any, pointer: str | None) -> None:
    reply = client.post("/v1/queue/pause", json=body)
    assert (reply.status_code, reply.json().get("pointer")) == (422, pointer)
    assert not queue(client)["paused"]


def test_an_identical_job_is_answered_at_once(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    settings = {**SMALL, "seed": 41}
    first = server.submit(scene={"inline": ball}, settings=settings)
    first = server.wait_for_end(first["id"])
    # Threads do not decide the bits, and the name of the file does not either.
    asset = client.post("/v1/assets?filename=b.json", json=ball).json()["id"]
    client.post("/v1/queue/pause").raise_for_status()
    try:
        again = server.submit(scene={"asset": asset}, settings={**settings, "threads": 1})
    finally:
        client.post("/v1/queue/resume").raise_for_status()
    assert (again["state"], again["cached"], again["attempts"]) == ("succeeded", True, 0)
    assert first["cached"] is False
    assert again["id"] != first["id"]
    assert again["stats"] == first["stats"]
    for name in ("image.exr", "image.png", "stats.json"):
        assert server.output(again["id"], name) == server.output(first["id"], name)
    events = client.get(f"/v1/jobs/{again['id']}/events").text
    assert '"queued"' in events
    assert '"succeeded"' in events
    assert client.get(f"/v1/jobs/{again['id']}/preview.png").status_code == 200
    # Each has its own links.
    client.delete(f"/v1/jobs/{first['id']}").raise_for_status()
    assert server.output(again["id"], "image.exr")
    third = server.submit(scene={"inline": ball}, settings=settings)
    assert third["cached"]


@pytest.mark.parametrize(
    "change",
    [
        {"settings": {**SMALL, "seed": 43}},
        {"settings": {**SMALL, "seed": 42, "max_depth": 3}},
        {"settings": {**SMALL, "seed": 42, "aovs": ["depth"]}},
        {"settings": {**SMALL, "seed": 42, "time_budget_s": 60}},
        {"outputs": ["exr"]},
        {"cache": False},
    ],
    ids=str,
)
def test_a_job_that_differs_is_rendered(
    server: Any, ball: dict[str, Any], change: dict[str, Any]
) -> None:
    base = {"scene": {"inline": ball}, "settings": {**SMALL, "seed": 42}}
    server.wait_for_end(server.submit(**base)["id"])
    job = server.wait_for_end(server.submit(**{**base, **change})["id"])
    assert (job["state"], job["cached"], job["attempts"]) == ("succeeded", False, 1)


def test_another_scene_is_rendered(server: Any, ball: dict[str, Any]) -> None:
    server.wait_for_end(server.submit(scene={"inline": ball}, settings=SMALL)["id"])
    other = {**ball, "materials": {**ball["materials"], "floor": {"type": "diffuse"}}}
    job = server.submit(scene={"inline": other}, settings=SMALL)
    assert not server.wait_for_end(job["id"])["cached"]


def test_what_is_partial_answers_nobody(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    endless = {"width": 256, "height": 256, "spp": 1 << 20, "seed": 44}
    body = {"scene": {"inline": ball}, "settings": endless}
    first = server.submit(**body)
    server.wait_for(first["id"], lambda job: (job["progress"]["spp_done"] or 0) > 0)
    client.post(f"/v1/jobs/{first['id']}/cancel").raise_for_status()
    assert server.wait_for_end(first["id"])["complete"] is False
    second = server.submit(**body)
    assert (second["state"], second["cached"]) == ("queued", False)
    client.post(f"/v1/jobs/{second['id']}/cancel").raise_for_status()
    server.wait_for_end(second["id"])


def test_identical_jobs_that_wait_are_rendered_once(
    client: httpx.Client, server: Any, ball: dict[str, Any], paused: None
) -> None:
    body = {"scene": {"inline": ball}, "settings": {**SMALL, "seed": 45}}
    jobs = [server.submit(**body) for _ in range(3)]
    client.post("/v1/queue/resume").raise_for_status()
    ended = [server.wait_for_end(job["id"]) for job in jobs]
    assert [job["cached"] for job in ended] == [False, True, True]
    assert len({server.output(job["id"], "image.exr") for job in ended}) == 1


def test_a_service_without_a_cache(serve: Any, ball: dict[str, Any]) -> None:
    server = serve(result_cache=False)
    for _ in range(2):
        job = server.submit(scene={"inline": ball}, settings=SMALL)
        assert not server.wait_for_end(job["id"])["cached"]
