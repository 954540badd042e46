"""What the service costs beyond the rendering: `python benchmarks/service/run.py [PART ...]`.

Parts: overhead, throughput, queue, watchers, stop.  Every number stands beside one of the same
machine at the same moment (the Python API in one process, the same render without watchers, the
cheapest call), because it is the ratio that says something.  Prints a table, and JSON with --json.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import raykiln as rk
from raykiln_service.database import Database
from raykiln_service.jobs import JobSpec
from raykiln_service.store import Store

SCENE = "cornell_box"
TINY = {"width": 64, "height": 64, "spp": 1}
SMALL = {"width": 128, "height": 128, "spp": 64}
ENDED = ("succeeded", "failed", "cancelled")


@contextlib.contextmanager
def service(data_dir: Path, *options: str) -> Iterator[tuple[httpx.Client, subprocess.Popen[str]]]:
    """A service on a data folder, warm: it has rendered once."""
    command = [sys.executable, "-m", "raykiln_service.cli", "serve", "--port", "0"]
    process = subprocess.Popen(
        [*command, "--data-dir", str(data_dir), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        with httpx.Client(base_url=line.split()[-1], timeout=120.0) as client:
            yield client, process
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


def submit(client: httpx.Client, settings: dict[str, Any], **options: Any) -> str:
    """A job that is rendered in any case; its id."""
    body = {"scene": {"name": SCENE}, "settings": settings, "cache": False, **options}
    job_id: str = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    return job_id


def finish(client: httpx.Client, settings: dict[str, Any]) -> dict[str, Any]:
    """Submit a job and wait for its end in one call."""
    body = {"scene": {"name": SCENE}, "settings": settings, "cache": False}
    reply = client.post("/v1/jobs", json=body, headers={"Prefer": "wait=100"})
    assert reply.is_success, reply.text
    job: dict[str, Any] = reply.json()
    assert job["state"] == "succeeded", job
    return job


def in_process(settings: dict[str, Any], folder: Path) -> float:
    """Seconds to do the same by the Python API: load, render, write EXR and PNG."""
    started = time.perf_counter()
    result = rk.render(rk.load_scene(SCENE), rk.RenderSettings(**settings))
    result.save(folder / "out.exr")
    result.save(folder / "out.png")
    return time.perf_counter() - started


def overhead(folder: Path) -> dict[str, float]:
    """From the request to the answer that names the outputs, beyond the pure render."""
    beyond, whole, alone = [], [], []
    with service(folder / "data") as (client, _process):
        for seed in range(12):
            settings = {**SMALL, "seed": seed}
            started = time.perf_counter()
            job = finish(client, settings)
            took = time.perf_counter() - started
            if seed >= 2:
                whole.append(took)
                beyond.append(took - job["stats"]["render_s"])
                alone.append(in_process(settings, folder))
    return {
        "beyond_render_ms": 1000 * statistics.median(beyond),
        "job_s": statistics.median(whole),
        "python_api_s": statistics.median(alone),
        "job_over_python_api": statistics.median(whole) / statistics.median(alone),
    }


def throughput(folder: Path, jobs: int = 100) -> dict[str, float]:
    """Jobs per second of 64 x 64 pixels at 1 sample, queued beforehand."""
    with service(folder / "data") as (client, _process):
        finish(client, TINY)
        client.post("/v1/queue/pause").raise_for_status()
        ids = [submit(client, {**TINY, "seed": seed}) for seed in range(jobs)]
        started = time.perf_counter()
        client.post("/v1/queue/resume").raise_for_status()
        while client.get(f"/v1/jobs/{ids[-1]}").json()["state"] not in ENDED:
            time.sleep(0.02)
        per_second = jobs / (time.perf_counter() - started)
    in_process(TINY, folder)
    started = time.perf_counter()
    for seed in range(jobs):
        in_process({**TINY, "seed": seed}, folder)
    alone = jobs / (time.perf_counter() - started)
    return {
        "jobs_per_s": per_second,
        "python_api_per_s": alone,
        "ratio": per_second / alone,
    }


def queue(folder: Path, jobs: int = 10_000, calls: int = 300) -> dict[str, float]:
    """Latency of looking, with a long queue."""
    data_dir = folder / "data"
    data_dir.mkdir()
    database = Database(Database.sqlite_url(data_dir / "raykiln.db"))
    database.migrate()
    store = Store(database)
    store.pause()
    for number in range(jobs):
        spec = JobSpec({"name": SCENE}, TINY, priority=number % 7, labels={"n": str(number % 100)})
        store.create_job(f"job-{number:05}", spec, pixel_samples=4096)
    database.close()
    looks: dict[str, Callable[[httpx.Client, int], httpx.Response]] = {
        "healthz": lambda client, i: client.get("/healthz"),
        "get": lambda client, i: client.get(f"/v1/jobs/job-{i * 37 % jobs:05}"),
        "list_50": lambda client, i: client.get("/v1/jobs"),
        "list_200": lambda client, i: client.get("/v1/jobs?limit=200"),
        "list_label": lambda client, i: client.get(f"/v1/jobs?label=n={i % 100}"),
        "list_state": lambda client, i: client.get("/v1/jobs?state=queued"),
        "queue": lambda client, i: client.get("/v1/queue"),
    }
    times: dict[str, list[float]] = {name: [] for name in looks}
    with service(data_dir) as (client, _process):
        for i in range(calls):
            # In turn, so that whatever else the machine does meets all of them.
            for name, look in looks.items():
                started = time.perf_counter()
                look(client, i).raise_for_status()
                if i >= 5:
                    times[name].append(1000 * (time.perf_counter() - started))
    found = {}
    for name, taken in times.items():
        found[f"{name}_p50_ms"] = statistics.median(taken)
        found[f"{name}_p99_ms"] = statistics.quantiles(taken, n=100)[98]
    return found


def watchers(folder: Path, readers: int = 200, rounds: int = 3) -> dict[str, float]:
    """What readers of one job's events cost its render."""
    settings = {**SMALL, "width": 256, "height": 256, "spp": 128}
    alone, watched, heard = [], [], []
    with service(folder / "data") as (client, _process):
        finish(client, settings)
        for seed in range(rounds):
            alone.append(finish(client, {**settings, "seed": seed})["stats"]["render_s"])
            client.post("/v1/queue/pause").raise_for_status()
            job_id = submit(client, {**settings, "seed": seed})
            # The readers are a process of their own, and step back for the render.
            command = [sys.executable, __file__, "--read", str(client.base_url), job_id]
            with subprocess.Popen(
                ["nice", "-n", "19", *command, str(readers)], stdout=subprocess.PIPE, text=True
            ) as crowd:
                assert crowd.stdout is not None
                assert crowd.stdout.readline() == "all listen\n"
                client.post("/v1/queue/resume").raise_for_status()
                heard.append(int(crowd.stdout.readline()))
            stats = client.get(f"/v1/jobs/{job_id}").json()["stats"]
            watched.append(stats["render_s"])
    return {
        "readers": readers,
        "events_heard": statistics.median(heard),
        "render_alone_s": statistics.median(alone),
        "render_watched_s": statistics.median(watched),
        "ratio": statistics.median(b / a for a, b in zip(alone, watched, strict=True)),
    }


def read_events(base_url: str, job_id: str, readers: int) -> None:
    """Be the readers: listen until the streams end, and print how many events came in all."""
    counts = [0] * readers
    listening = threading.Barrier(readers + 1)

    def listen(number: int) -> None:
        limits = httpx.Limits(max_connections=1)
        with (
            httpx.Client(base_url=base_url, timeout=120.0, limits=limits) as client,
            client.stream("GET", f"/v1/jobs/{job_id}/events") as reply,
        ):
            listening.wait()
            counts[number] = sum(line.startswith("event:") for line in reply.iter_lines())

    threads = [threading.Thread(target=listen, args=(i,)) for i in range(readers)]
    for thread in threads:
        thread.start()
    listening.wait()
    print("all listen", flush=True)
    for thread in threads:
        thread.join()
    print(sum(counts), flush=True)


def stop(folder: Path, rounds: int = 3) -> dict[str, float]:
    """From SIGTERM during a render to the end of the process."""
    taken = []
    for number in range(rounds):
        with service(folder / f"data-{number}") as (client, process):
            job_id = submit(client, {**SMALL, "spp": 1_000_000})
            while (client.get(f"/v1/jobs/{job_id}").json()["progress"]["spp_done"] or 0) < 1:
                time.sleep(0.02)
            started = time.perf_counter()
            process.send_signal(signal.SIGTERM)
            process.wait(60)
            taken.append(time.perf_counter() - started)
    return {"sigterm_to_exit_s": statistics.median(taken), "longest_s": max(taken)}


PARTS: dict[str, Callable[[Path], dict[str, float]]] = {
    "overhead": overhead,
    "throughput": throughput,
    "queue": queue,
    "watchers": watchers,
    "stop": stop,
}


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--read", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.read:
        read_events(given.read[0], given.read[1], int(given.read[2]))
        return
    if unknown := set(given.parts) - set(PARTS):
        parser.error(f"no such part: {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    found = {}
    for name in given.parts or PARTS:
        with tempfile.TemporaryDirectory(prefix="raykiln-bench-") as folder:
            found[name] = PARTS[name](Path(folder))
        if not given.json:
            for key, value in found[name].items():
                print(f"{name:<12}{key:<24}{value:10.3f}", flush=True)
    if given.json:
        print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
