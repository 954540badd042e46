"""Promises kept while the storage fails: a full disk, a locked database, a clock that jumps."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from campaign import SETTINGS, check_whole, pixels

SMALL_DISK = 24 << 20


@pytest.fixture(scope="module")
def undisturbed(server: Any, ball: dict[str, Any]) -> dict[str, bytes]:
    """The layers of the image when nothing happens to the service."""
    job = server.submit(scene={"inline": ball}, settings=SETTINGS)
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
    return pixels(server, job["id"])


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own that is soon full."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "raykiln-test", str(place)]
    try:
        made = subprocess.run(mount, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount command")
    if made.returncode != 0:
        pytest.skip(f"file systems cannot be mounted here: {made.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def fill(disk: Path, but_bytes: int) -> Path:
    """Take all the room there is but so much; the file that has to go for it to be there again."""
    filler = disk / "filler"
    with filler.open("wb") as file:
        left = shutil.disk_usage(disk).free - but_bytes
        while left > 0:
            left -= file.write(b"\0" * min(left, 1 << 20))
    return filler


def ask(client: httpx.Client, ball: dict[str, Any]) -> httpx.Response:
    body = {"scene": {"inline": ball}, "settings": SETTINGS, "cache": False}
    return client.post("/v1/jobs", json=body)


def test_a_job_on_a_full_disk_waits_for_room(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], small_disk: Path
) -> None:
    options = {"max_attempts": 1, "retry_delay_max_s": 0.5, "checkpoint_interval_s": 0.0}
    server = serve(data_dir=str(small_disk / "data"), **options)
    with server.client() as client:
        client.post("/v1/queue/pause").raise_for_status()
        job_id = ask(client, ball).raise_for_status().json()["id"]
        # Room for what the database has to say, but none for an image.
        filler = fill(small_disk, but_bytes=400_000)
        client.post("/v1/queue/resume").raise_for_status()
        waiting = server.wait_for(job_id, lambda job: job["interruptions"] >= 2)
        assert waiting["state"] in ("queued", "running")
        assert client.get("/healthz").status_code == 200
    filler.unlink()
    job = server.wait_for_end(job_id)
    check_whole(server, job, undisturbed)
    assert b"No space left" in server.output(job_id, "log.txt")


def test_a_full_disk_refuses_new_jobs_and_makes_nothing_by_half(
    serve: Any, ball: dict[str, Any], small_disk: Path
) -> None:
    server = serve(data_dir=str(small_disk / "data"))
    with server.client() as client:
        client.post("/v1/queue/pause").raise_for_status()
        filler = fill(small_disk, but_bytes=0)
        for reply in (
            ask(client, ball),
            client.post("/v1/assets?filename=a.ply", content=b"ply" * 9999),
        ):
            assert reply.status_code == 507, reply.text
            assert reply.headers["content-type"] == "application/problem+json"
        assert client.get("/v1/jobs").json()["items"] == []
        assert os.listdir(server.data_dir / "jobs") == []
        assert os.listdir(server.data_dir / "tmp") == []
        filler.unlink()
        assert ask(client, ball).status_code == 202
        assert client.post("/v1/assets?filename=a.ply", content=b"ply").status_code == 201


def test_a_data_folder_that_is_read_only(small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    command = [sys.executable, "-m", "raykiln_service.cli", "serve", "--port", "0"]
    ended = subprocess.run(
        [*command, "--data-dir", str(small_disk)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert "Read-only file system" in line
    assert str(small_disk) in line


def test_a_database_that_another_process_locks(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes]
) -> None:
    server = serve(checkpoint_interval_s=0.0)
    with server.client() as client:
        client.post("/v1/queue/pause").raise_for_status()
        job_id = ask(client, ball).raise_for_status().json()["id"]
        client.post("/v1/queue/resume").raise_for_status()
        server.wait_for(job_id, lambda job: job["state"] == "running")
        other = sqlite3.connect(server.data_dir / "raykiln.db", timeout=60, isolation_level=None)
        other.execute("BEGIN EXCLUSIVE")
        try:
            # Looking goes on; what would have to be written is refused after a while.
            assert client.get(f"/v1/jobs/{job_id}").status_code == 200
            refusal = ask(client, ball)
            assert refusal.status_code == 503, refusal.text
            assert refusal.headers["Retry-After"]
            assert server.job(job_id)["state"] == "running"
        finally:
            other.execute("ROLLBACK")
            other.close()
        check_whole(server, server.wait_for_end(job_id), undisturbed)
        assert ask(client, ball).status_code == 202


@pytest.fixture
def jumping_clock(tmp_path: Path) -> Any:
    """An environment in which a file says how far the wall clock is off."""
    found = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
    if not found:
        pytest.skip("libfaketime is not installed")
    offset = tmp_path / "offset"
    offset.write_text("+0\n")
    env = {
        "LD_PRELOAD": str(found[0]),
        "FAKETIME_TIMESTAMP_FILE": str(offset),
        "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "FAKETIME_DONT_RESET": "1",
    }
    return offset, env


def test_a_clock_that_jumps(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], jumping_clock: Any
) -> None:
    offset, env = jumping_clock
    server = serve(env=env, checkpoint_interval_s=0.0, lease_s=1.0, heartbeat_s=0.2)
    jobs = []
    with server.client() as client:
        for jump in ("+0", "+90d", "-400d", "+3600", "-3600", "+0"):
            offset.write_text(jump + "\n")
            jobs.append(ask(client, ball).raise_for_status().json()["id"])
            time.sleep(0.3)
        ended = [server.wait_for_end(job_id) for job_id in jobs]
    created = sorted(datetime.fromisoformat(job["created_at"]) for job in ended)
    assert created[-1] - created[0] > timedelta(days=400), "the clock did not jump"
    for job in ended:
        check_whole(server, job, undisturbed)
        assert (job["attempts"], job["interruptions"]) == (1, 0)
        assert all(seconds >= 0 for seconds in job["timings"].values())


def test_a_clock_that_jumps_does_not_hold_up_what_was_lost(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], jumping_clock: Any
) -> None:
    offset, env = jumping_clock
    offset.write_text("+90d\n")
    server = serve(env=env, checkpoint_interval_s=0.0)
    with server.client() as client:
        job_id = ask(client, ball).raise_for_status().json()["id"]
    server.wait_for(job_id, lambda job: job["state"] == "running")
    server.kill_all()
    offset.write_text("+0\n")
    server = serve(env=env)
    check_whole(server, server.wait_for_end(job_id), undisturbed)


@pytest.mark.parametrize("seed", range(2))
def test_sigterm_gives_the_job_back_whatever_it_does(
    serve: Any, ball: dict[str, Any], undisturbed: dict[str, bytes], seed: int
) -> None:
    server = serve()
    with server.client() as client:
        job_id = ask(client, ball).raise_for_status().json()["id"]
    time.sleep(seed * 0.4)
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(timeout=60) == 0
    with sqlite3.connect(f"file:{server.data_dir}/raykiln.db?mode=ro", uri=True) as database:
        ((state, token),) = database.execute("SELECT state, lease_token FROM jobs").fetchall()
    database.close()
    assert state in ("queued", "succeeded")
    assert token is None
    server = serve()
    job = server.wait_for_end(job_id)
    check_whole(server, job, undisturbed)
    assert job["interruptions"] == 0
