"""What the failure tests share: the processes of a service, and what must be true of a job."""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from raykiln.image import read_exr_layers
from raykiln_service.jobs import TRANSITIONS, JobState

# By one thread, so that many processors do not end it before it can be disturbed.
SETTINGS = {"width": 96, "height": 64, "spp": 1600, "seed": 7, "threads": 1, "aovs": ["albedo"]}


def pixels(server: Any, job_id: str) -> dict[str, bytes]:
    """The exact bits of every layer of a job's EXR."""
    layers = read_exr_layers(server.output(job_id, "image.exr"))
    return {name: layer.tobytes() for name, layer in layers.items()}


def render_children(server: Any) -> list[int]:
    """Process ids of what renders for a service."""
    return [pid for pid in descendants(server) if _name(pid) == "raykiln-child"]


def descendants(server: Any) -> list[int]:
    """Process ids of all that a service has started, down to the last."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        if (stat := _stat(int(entry.name))) is not None:
            parents[int(entry.name)] = int(stat[1])
    return [pid for pid in parents if server.process.pid in _ancestors(pid, parents)]


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


def _ancestors(pid: int, parents: dict[int, int]) -> Iterator[int]:
    while (pid := parents.get(pid, 0)) > 1:
        yield pid


def _stat(pid: int) -> list[str] | None:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return None


def is_running(pid: int) -> bool:
    """Whether a process is there and not dead."""
    stat = _stat(pid)
    return stat is not None and stat[0] != "Z"


def wait_until_gone(pid: int) -> None:
    """A child must not outlive its service."""
    deadline = time.monotonic() + 60
    while is_running(pid):
        assert time.monotonic() < deadline, f"process {pid} outlives its service"
        time.sleep(0.02)


def wait_for_children(server: Any) -> list[int]:
    """Process ids of what renders for a service, once there is something."""
    deadline = time.monotonic() + 60
    while not (found := render_children(server)):
        assert time.monotonic() < deadline, "nothing renders"
        time.sleep(0.02)
    return found


def kill_children(server: Any) -> None:
    """End what renders now, without any warning."""
    for pid in render_children(server):
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def check_story(server: Any, job: dict[str, Any]) -> None:
    """A job's events are a path through the table of transitions, and end once."""
    with server.client() as client:
        text = client.get(f"/v1/jobs/{job['id']}/events").text
    states = []
    for block in text.split("\n\n"):
        if "event: state" in block:
            data = next(line for line in block.splitlines() if line.startswith("data: "))
            states.append(JobState(data.split('"state": "')[1].split('"')[0]))
    legal = {(source, target) for (source, _event), target in TRANSITIONS.items()}
    assert states[0] is JobState.QUEUED
    assert all(step in legal for step in itertools.pairwise(states)), states
    assert [state.is_final for state in states].count(True) == 1
    assert states[-1] == job["state"]
    assert states.count(JobState.RUNNING) == job["attempts"]


def check_whole(server: Any, job: dict[str, Any], wanted: dict[str, bytes]) -> None:
    """A job ended well, once, with every sample counted once and the undisturbed bits."""
    assert job["state"] == "succeeded", job["error"]
    assert job["stats"]["spp"] == SETTINGS["spp"]
    width, height = SETTINGS["width"], SETTINGS["height"]
    assert job["stats"]["samples"] == width * height * SETTINGS["spp"]  # type: ignore[operator]
    assert pixels(server, job["id"]) == wanted
    check_story(server, job)
    folder = server.data_dir / "jobs" / job["id"]
    assert [path.name for path in folder.glob("work-*")] == []
    assert len(list(folder.glob("result-*"))) == 1
