"""Promises kept by killing things: real processes, SIGKILL, and the bits of the image after it."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raykiln.image import read_exr_layers

SETTINGS = {"width": 96, "height": 64, "spp": 160, "seed": 7, "aovs": ["albedo"]}


def pixels(server: Any, job_id: str) -> dict[str, bytes]:
    """The exact bits of every layer of a job's EXR."""
    layers = read_exr_layers(server.output(job_id, "image.exr"))
    return {name: layer.tobytes() for name, layer in layers.items()}


def render_children(server: Any) -> list[int]:
    """Process ids of the service's render children, which its zygote has forked."""
    found, parents = [], {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            name, fields = (entry / "stat").read_text().split("(", 1)[1].rsplit(")", 1)
        except (OSError, IndexError):
            continue
        parents[int(entry.name)] = int(fields.split()[1])
        if name == "raykiln-child":
            found.append(int(entry.name))
    return [pid for pid in found if parents.get(parents[pid]) == server.process.pid]


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def wait_until_gone(pid: int) -> None:
    deadline = time.monotonic() + 10
    while is_running(pid):
        assert time.monotonic() < deadline, f"process {pid} outlives its service"
        time.sleep(0.02)


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
    assert job["state"] == "succeeded", job["error"]
    assert job["attempts"] >= 2
    assert job["interruptions"] == job["attempts"] - 1
    assert job["stats"]["spp"] == SETTINGS["spp"]
    assert pixels(server, job["id"]) == undisturbed
    leftovers = [p.name for p in (server.data_dir / "jobs" / job["id"]).glob("work-*")]
    assert leftovers == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 5))
def test_many_deaths_of_one_job(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], seed: int
) -> None:
    server, job = kill_and_resume(serve, ball, kills=12, seed=seed)
    assert job["state"] == "succeeded", job["error"]
    assert pixels(server, job["id"]) == undisturbed


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
    for pid in render_children(server):
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
        for pid in render_children(server):
            os.kill(pid, signal.SIGKILL)
    job = server.wait_for_end(job_id)
    assert job["state"] == "failed"
    assert job["error"]["reason"] == "crashed"
    assert "SIGKILL" in job["error"]["detail"]
    other = server.submit(scene={"inline": ball}, settings={**SETTINGS, "spp": 1})
    assert server.wait_for_end(other["id"])["state"] == "succeeded"


def test_sigterm_keeps_the_finished_passes_and_gives_the_job_back(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server = serve(checkpoint_interval_s=1000)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 8)
    assert server.stop() == 0
    assert (server.data_dir / "jobs" / job_id / "checkpoint").exists()
    server = serve()
    job = server.wait_for_end(job_id)
    assert (job["state"], job["interruptions"], job["attempts"]) == ("succeeded", 0, 2)
    assert pixels(server, job_id) == undisturbed


def test_a_damaged_checkpoint_means_starting_over(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server = serve(checkpoint_interval_s=0.0)
    job_id = server.submit(scene={"inline": ball}, settings=SETTINGS)["id"]
    server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 8)
    server.kill_all()
    checkpoint = server.data_dir / "jobs" / job_id / "checkpoint"
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
