"""The service as a person's browser meets it, and small scenes for it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
from ports import free_port

BALL: dict[str, Any] = {
    "version": 1,
    "name": "ball",
    "cameras": [
        {"type": "perspective", "name": name, "look_at": {"origin": origin, "target": [0, 0.5, 0]}}
        for name, origin in (("front", [0, 1, 4]), ("side", [4, 1, 0]))
    ],
    "materials": {"red": {"type": "diffuse", "reflectance": [0.7, 0.2, 0.1]}},
    "shapes": [
        {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.7, "material": "red"},
        {"type": "sphere", "center": [2, 3, 2], "radius": 0.4, "emission": {"radiance": 12}},
    ],
    "lights": [{"type": "constant", "radiance": 0.2}],
}
FOREVER = {"width": 128, "height": 96, "spp": 1 << 20}
QUICK = {"width": 32, "height": 24, "spp": 1}
ENDED = ("succeeded", "failed", "cancelled")


class Service:
    """A service on a port of its own, which it keeps when it is started again."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._folder = folder
        self.data_dir = folder / "data"
        self._environment = environment
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; returns when it answers."""
        command = [sys.executable, "-m", "raykiln_service.cli", "serve", "--port", str(self.port)]
        log = self._folder / "service.log"
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [*command, "--data-dir", str(self.data_dir)],
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **self._environment},
                start_new_session=True,
            )
        deadline = time.monotonic() + 120
        while not self._answers():
            assert self._process.poll() is None, log.read_text()
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)

    def kill(self) -> None:
        """End it, and all its children, without warning."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def _answers(self) -> bool:
        try:
            return httpx.get(f"{self.url}/healthz", timeout=60).status_code == 200
        except httpx.TransportError:
            return False

    def client(self) -> httpx.Client:
        """A plain HTTP client of it."""
        token = self._environment.get("RAYKILN_TOKEN")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.url, timeout=60.0, headers=headers)

    def submit(self, **body: Any) -> str:
        """Submit a job of the ball, unless told otherwise; its id."""
        with self.client() as client:
            reply = client.post("/v1/jobs", json={"scene": {"inline": BALL}, **body})
            assert reply.status_code == 202, reply.text
            return str(reply.json()["id"])

    def finished(self, **body: Any) -> dict[str, Any]:
        """The same, once the job has ended."""
        job_id = self.submit(**body)
        deadline = time.monotonic() + 120
        while (job := self.get(f"/v1/jobs/{job_id}").json())["state"] not in ENDED:
            assert time.monotonic() < deadline, job
            time.sleep(0.05)
        return dict(job)

    def get(self, path: str, **params: Any) -> httpx.Response:
        """What stands at a path."""
        with self.client() as client:
            return client.get(path, params=params).raise_for_status()

    def jobs(self) -> list[dict[str, Any]]:
        """The newest jobs."""
        return list(self.get("/v1/jobs", limit=200).json()["items"])

    def clear(self, keep: set[str]) -> None:
        """End and remove all jobs but some."""
        with self.client() as client:
            deadline = time.monotonic() + 60
            while jobs := {job["id"] for job in self.jobs()} - keep:
                for job_id in jobs:
                    client.post(f"/v1/jobs/{job_id}/cancel")
                    client.delete(f"/v1/jobs/{job_id}")
                assert time.monotonic() < deadline, jobs
                time.sleep(0.05)


def until(seen: Callable[[], Any], within_s: float = 60) -> Any:
    """What `seen` returns as soon as it is true.

    The page forbids scripts that are text, so the browser cannot be asked to wait for one.
    """
    deadline = time.monotonic() + within_s
    while not (value := seen()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)
    return value


def write_ball(path: Path, **changed: Any) -> Path:
    """The ball as a scene file."""
    path.write_text(json.dumps({**BALL, **changed}))
    return path
