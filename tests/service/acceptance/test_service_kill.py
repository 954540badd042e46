"""Promises kept by killing things: real processes, SIGKILL, and the bits of the image after it."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from typing import Any

import httpx
import numpy as np
import pytest
from campaign import (
    SETTINGS,
    check_whole,
    descendants,
    kill_children,
    pixels,
    render_children,
    wait_for_children,
    wait_until_gone,
)


@pytest.fixture(scope="module")
def undisturbed(server: Any, ball: dict[str, Any]) -> dict[str, bytes]:
    """The layers of the image when nothing happens to the service."""
    job = server.submit(scene={"inline": ball}, settings=SETTINGS)
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
    found = pixels(server, job["id"])
    assert np.frombuffer(found["beauty"], np.float32).max() > 0
    return found


def kill_and_resume(serve: Any, ball: dict[str, Any], kills: int, seed: int) -> tuple[Any, Any]:
    """A job through `kills` deaths of its service at random moments of its render."""
    chance = random.Random(seed)
    server = serve(checkpoint_interval_s=0.0)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    for _ in range(kills):
        server.wait_for(job_id, lambda view: view["state"] != "queued")
        time.sleep(chance.uniform(0.0, 1.0))
        children = render_children(server)
        server.kill_all()
        for pid in children:
            wait_until_gone(pid)
        server = serve(checkpoint_interval_s=0.0)
    return server, server.wait_for_end(job_id)


def test_a_killed_service_goes_on_and_the_image_has_the_same_bits(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server, job = kill_and_resume(serve, ball, kills=3, seed=1)
    assert job["attempts"] >= 2
    assert job["interruptions"] == job["attempts"] - 1
    check_whole(server, job, undisturbed)


def campaign(serve: Any, ball: dict[str, Any], rounds: int, seed: int) -> tuple[Any, list[str]]:
    """Jobs come, and at random moments the service, or what renders in it, is killed.

    A client that does not know whether its job was taken asks again with the same key.
    """
    chance = random.Random(seed)
    options = {"checkpoint_interval_s": 0.0, "max_attempts": 100, "retry_delay_max_s": 0.1}
    server = serve(**options)
    accepted: list[str] = []
    for number in range(rounds):
        if number % 8 == 0:
            accepted.append(_submit_through_deaths(serve, options, server, ball, number))
            server = serve.latest()
        time.sleep(chance.uniform(0.0, 0.8))
        if chance.random() < 0.4:
            kill_children(server)
            continue
        children = descendants(server)
        if chance.random() < 0.5:
            server.kill_all()
        else:
            # Its children must notice by themselves.
            server.process.kill()
            server.process.wait()
        for pid in children:
            wait_until_gone(pid)
        server = serve(**options)
    return server, accepted


def _submit_through_deaths(
    serve: Any, options: dict[str, Any], server: Any, ball: dict[str, Any], number: int
) -> str:
    body = {"scene": {"inline": ball}, "settings": SETTINGS, "cache": False}
    headers = {"Idempotency-Key": f"key-{number}"}
    killer = threading.Timer(random.Random(number).uniform(0.0, 0.1), server.kill_all)
    killer.start()
    first = None
    try:
        with server.client() as client:
            first = client.post("/v1/jobs", json=body, headers=headers)
    except httpx.TransportError:
        pass
    killer.join()
    server = serve(**options)
    with server.client() as client:
        again = client.post("/v1/jobs", json=body, headers=headers)
    assert again.status_code == 202, again.text
    job_id: str = again.json()["id"]
    if first is not None and first.status_code == 202:
        # What was accepted is there, and is not there twice.
        assert first.json()["id"] == job_id
    return job_id


def check_campaign(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], rounds: int, seed: int
) -> None:
    server, accepted = campaign(serve, ball, rounds, seed)
    with server.client() as client:
        listed = client.get("/v1/jobs?limit=200").json()["items"]
    assert sorted(job["id"] for job in listed) == sorted(accepted)
    for job_id in accepted:
        check_whole(server, server.wait_for_end(job_id), undisturbed)
    assert server.stop() == 0


def test_random_deaths(serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]) -> None:
    check_campaign(serve, ball, undisturbed, rounds=4, seed=2)


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_a_hundred_random_deaths(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    check_campaign(serve, ball, undisturbed, rounds=120, seed=3)


def test_a_resumed_job_starts_from_its_last_pass(serve: Any, ball: dict[str, Any]) -> None:
    server = serve(checkpoint_interval_s=0.0)
    job_id = server.submit(scene={"inline": ball}, settings={**SETTINGS, "spp": 4096})["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 64)
    server.kill_all()
    server = serve()
    view = server.wait_for(job_id, lambda view: view["progress"]["phase"] == "render")
    assert view["progress"]["spp_done"] >= 48


def test_a_killed_render_child_is_one_lost_attempt(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server = serve(checkpoint_interval_s=0.0)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 2)
    for pid in wait_for_children(server):
        os.kill(pid, signal.SIGSEGV)
    job = server.wait_for_end(job_id)
    assert (job["state"], job["attempts"], job["interruptions"]) == ("succeeded", 2, 0)
    assert pixels(server, job_id) == undisturbed
    assert b"SIGSEGV" in server.output(job_id, "log.txt")


def test_a_job_whose_child_always_dies_fails_with_the_reason(
    serve: Any, ball: dict[str, Any]
) -> None:
    server = serve(max_attempts=2)
    job_id = server.submit(scene={"inline": ball}, settings={**SETTINGS, "spp": 100_000})["id"]
    for attempt in (1, 2):
        server.wait_for(
            job_id,
            lambda view, n=attempt: (
                view["attempts"] == n
                and view["state"] == "running"
                and view["progress"]["phase"] == "render"
            ),
        )
        for pid in wait_for_children(server):
            os.kill(pid, signal.SIGKILL)
    job = server.wait_for_end(job_id)
    assert job["state"] == "failed"
    assert job["error"]["reason"] == "crashed"
    assert "SIGKILL" in job["error"]["detail"]
    other = server.submit(scene={"inline": ball}, settings={**SETTINGS, "spp": 1})
    assert server.wait_for_end(other["id"])["state"] == "succeeded"


def test_sigterm_keeps_the_finished_passes_and_gives_the_job_back(
    serve: Any, ball: dict[str, Any]
) -> None:
    server = serve(checkpoint_interval_s=1000)
    body = {"scene": {"inline": ball}, "settings": {**SETTINGS, "spp": 4000}, "cache": False}
    job_id = server.submit(**body)["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 8)
    assert server.stop() == 0
    assert (server.data_dir / "jobs" / job_id / "checkpoint").exists()
    server = serve()
    job = server.wait_for_end(job_id)
    assert (job["state"], job["interruptions"], job["attempts"]) == ("succeeded", 0, 2)
    undisturbed = server.submit(**body)["id"]
    assert server.wait_for_end(undisturbed)["attempts"] == 1
    assert pixels(server, job_id) == pixels(server, undisturbed)


def test_a_damaged_checkpoint_means_starting_over(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server = serve(checkpoint_interval_s=0.0)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    checkpoint = server.data_dir / "jobs" / job_id / "checkpoint"
    # The news of a pass come before its checkpoint.
    server.wait_for(
        job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 8 and checkpoint.exists()
    )
    server.kill_all()
    damaged = bytearray(checkpoint.read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    checkpoint.write_bytes(damaged)
    server = serve()
    assert server.wait_for_end(job_id)["state"] == "succeeded"
    assert pixels(server, job_id) == undisturbed
    assert b"starting over" in server.output(job_id, "log.txt")


def test_the_same_on_postgresql(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], postgres_url: str
) -> None:
    settings = {"database_url": postgres_url, "checkpoint_interval_s": 0.0}
    settings |= {"lease_s": 2.0, "heartbeat_s": 0.5}
    server = serve(**settings)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 4)
    server.kill_all()
    server = serve(**settings)
    # The lease of the dead service has to run out: others may share the database.
    job = server.wait_for_end(job_id)
    assert (job["state"], job["attempts"], job["interruptions"]) == ("succeeded", 2, 1)
    assert pixels(server, job_id) == undisturbed
