"""The commands that talk to a service, against a real one."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ports import free_port
from raykiln.image import read_image
from raykiln_service.client import AsyncClient, Client, Event, ServerError

from .support import COMMAND, Ran, Run, raykiln_process, write_scene
from .test_packing import write_bundle

SMALL = ("--size", "16x16", "--spp", "2")


@dataclass(frozen=True)
class Service:
    """A running service."""

    url: str
    process: subprocess.Popen[bytes]


def serve(folder: Path, *arguments: str) -> Service:
    """Start `raykiln serve` on a free port and wait until it serves."""
    folder.mkdir(exist_ok=True)
    log = folder / f"serve-{time.monotonic_ns()}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*COMMAND, "serve", "--port", "0", "--data-dir", str(folder), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    while process.poll() is None:
        if match := re.search(r"raykiln serving on (http://\S+)", log.read_text()):
            return Service(match[1], process)
        time.sleep(0.02)
    raise AssertionError(f"the service did not start:\n{log.read_text()}")


def stop(service: Service) -> int:
    service.process.send_signal(signal.SIGTERM)
    return service.process.wait(timeout=60)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service for the tests of this file."""
    running = serve(tmp_path_factory.mktemp("service"))
    yield running
    stop(running)


@pytest.fixture
def remote(raykiln: Run, service: Service, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command line against that service."""
    monkeypatch.setenv("RAYKILN_SERVER", service.url)
    return raykiln


@pytest.fixture
def long_job(service: Service) -> Iterator[str]:
    """A job that is still running when the test ends."""
    settings = {"width": 256, "height": 256, "spp": 1 << 20}
    with Client(service.url) as client:
        job = client.submit({"name": "cornell_box"}, settings)
        yield job.id
        if not client.job(job.id).is_final:
            client.cancel(job.id)
            client.wait(job.id, timeout_s=120)


def wait_for_state(service: Service, job: str, *states: str) -> str:
    deadline = time.monotonic() + 60
    with Client(service.url) as client:
        while (state := client.job(job).state) not in states:
            assert time.monotonic() < deadline, f"job {job} stays {state}"
            time.sleep(0.05)
    return state


def test_submit_waits_and_downloads(remote: Run, tmp_path: Path) -> None:
    files = ("-o", "a.exr", "-o", "a.png", "--stats", "s.json")
    ran = remote("submit", "cornell_box", *SMALL, *files)
    assert ran.code == 0
    assert ran.out.splitlines()[1:] == ["a.exr", "a.png", "s.json"]
    assert json.loads(Path("s.json").read_text())["spp"] == 2
    # The service and the command render the same bits.
    assert remote("render", "cornell_box", *SMALL, "-o", "local.exr").code == 0
    np.testing.assert_array_equal(read_image("a.exr"), read_image("local.exr"))


def test_what_a_submitted_job_may_take(remote: Run) -> None:
    limits = ("--timeout", "0.3", "--memory", "1536M")
    ran = remote("submit", "cornell_box", "--size", "64x64", "--spp", 1 << 20, *limits, "--wait")
    assert ran.code == 1
    assert "took longer than its time limit" in ran.err
    with Client() as client:
        (job,) = client.jobs(limit=1).items
        assert job.model_extra is not None
        assert job.model_extra["timeout_s"] == 0.3
        assert job.model_extra["memory_bytes"] == 3 << 29
        assert job.error is not None
        assert job.error["reason"] == "timeout"


def test_a_job_is_retried_and_deleted(remote: Run, service: Service, long_job: str) -> None:
    assert remote("retry", long_job).error.startswith(f"job {long_job}: a job that is ")
    assert remote("delete", long_job).error.startswith(f"job {long_job} is ")
    assert remote("cancel", long_job).code == 0
    assert wait_for_state(service, long_job, "cancelled") == "cancelled"
    again = remote("retry", long_job, "--json").json
    assert (again["id"], again["state"]) == (long_job, "queued")
    assert remote("cancel", long_job).code == 0
    assert wait_for_state(service, long_job, "cancelled") == "cancelled"
    done = remote("submit", "cornell_box", *SMALL, "--wait", "--json").json["id"]
    assert remote("delete", done) == Ran(0, "", "")
    assert remote("status", done).code == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--memory", "much"], "--memory: not understood (found much); accepted: a whole"),
        (["--timeout", "0"], "/timeout_s: "),
        (["--webhook-event", "failed"], "--webhook-event: goes with --webhook only"),
        (["--webhook", "ftp://x/"], "/webhook/url: "),
        (["--webhook", "http://127.0.0.1/"], "/webhook/url: "),
        (["--webhook", "https://example.com/", "--webhook-event", "born"], "/webhook/events/0: "),
    ],
)
def test_limits_and_webhooks_that_are_none(remote: Run, arguments: list[str], says: str) -> None:
    ran = remote("submit", "cornell_box", *SMALL, *arguments)
    assert ran.code == 2
    assert ran.error.startswith(says)


def test_webhooks_are_asked_for_and_told_again(
    raykiln: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the command and both clients; the secret comes from the environment."""
    answers, got = [410, 204, 204], []

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            got.append(json.loads(self.rfile.read(int(self.headers["content-length"]))))
            self.send_response(answers[min(len(got), len(answers)) - 1])
            self.end_headers()

        def log_message(self, *_arguments: Any) -> None:
            """Say nothing."""

    def settled(job: str) -> list[str]:
        while not (items := raykiln("deliveries", job, "--json").json["items"]) or any(
            item["state"] == "pending" for item in items
        ):
            time.sleep(0.05)
        return [item["id"] for item in items]

    monkeypatch.setenv("RAYKILN_WEBHOOK_ALLOW_PRIVATE", "true")
    own = serve(tmp_path / "hooked")
    monkeypatch.setenv("RAYKILN_SERVER", own.url)
    receiver = ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=receiver.serve_forever, daemon=True).start()
    hook = ("--webhook", f"http://127.0.0.1:{receiver.server_address[1]}/")
    try:
        assert "no secret of its own" in raykiln("submit", "cornell_box", *SMALL, *hook).error
        monkeypatch.setenv("RAYKILN_JOB_WEBHOOK_SECRET", "whsec_" + "a" * 40)
        done = raykiln("submit", "cornell_box", *SMALL, *hook, "--webhook-event", "succeeded")
        job = done.out.strip()
        (message,) = settled(job)
        assert "failed" in raykiln("deliveries", job).out
        assert raykiln("deliveries", job, "--redeliver-failed").code == 0
        assert settled(job) == [message]
        assert "delivered" in raykiln("deliveries", job).out

        async def tell_again() -> str:
            async with AsyncClient() as client:
                return (await client.redeliver(job, message)).items[0].id

        assert asyncio.run(tell_again()) == message
        settled(job)
        assert [one["type"] for one in got] == ["job.succeeded"] * 3
        assert raykiln("deliveries", job, "--redeliver", "msg_none").code == 2
    finally:
        stop(own)
        receiver.shutdown()
        receiver.server_close()


def test_a_submitted_job_is_followed_by_its_id(remote: Run, tmp_path: Path) -> None:
    ran = remote("submit", "cornell_box", *SMALL, "--label", "shot=010")
    assert ran.code == 0
    job = ran.out.strip()
    assert f"raykiln watch {job}" in ran.err
    watched = remote("watch", job)
    assert (watched.code, watched.out) == (0, f"{job} succeeded\n")
    # Watching what has ended ends at once.
    assert remote("watch", job).code == 0
    assert "succeeded" in remote("status", job).out
    assert remote("status", job, "--json").json["progress"]["fraction"] == 1.0
    listed = remote("list", "--label", "shot=010", "--json").json
    assert [entry["id"] for entry in listed] == [job]
    assert job in remote("list", "--state", "succeeded").out
    paths = remote("download", job).out.splitlines()
    assert {"image.exr", "image.png", "stats.json"} <= set(paths)
    assert all((tmp_path / path).stat().st_size > 0 for path in paths)


def test_download_of_chosen_outputs_and_views(remote: Run, tmp_path: Path) -> None:
    job = remote("submit", "cornell_box", *SMALL, "--wait", "--json").json["id"]
    assert remote("download", job, "log.txt", "-o", "my.log").out == "my.log\n"
    (tmp_path / "d").mkdir()
    assert remote("download", job, "image.png", "stats.json", "-o", "d").code == 0
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["image.png", "stats.json"]
    assert remote("download", job, "-o", "dark.png", "--exposure", "-3").code == 0
    assert read_image("dark.png").mean() < read_image("d/image.png").mean()
    # As root, taking the place of a device would take it from everybody.
    os.mkfifo(tmp_path / "pipe.png")
    ran = remote("download", job, "-o", "pipe.png")
    assert ran.code != 0
    assert "not a regular file" in ran.error
    assert (tmp_path / "pipe.png").is_fifo()
    ran = remote("download", job, "nothing.exr")
    assert ran.code == 2
    assert not (tmp_path / "nothing.exr").exists()


def test_a_scene_file_is_uploaded(remote: Run, scene: Path) -> None:
    assert remote("submit", scene, "-o", "a.exr").code == 0
    assert read_image("a.exr").shape[:2] == (16, 24)


def test_a_scene_with_side_files_is_uploaded_as_a_bundle(remote: Run, tmp_path: Path) -> None:
    bundle = write_bundle(tmp_path / "in")
    assert remote("submit", bundle, "-o", "a.exr").code == 0
    assert remote("render", bundle, "-o", "local.exr").code == 0
    np.testing.assert_array_equal(read_image("a.exr"), read_image("local.exr"))


def test_warnings_of_the_scene_come_back(remote: Run, tmp_path: Path) -> None:
    ran = remote("submit", write_scene(tmp_path / "dark.json", lights=[]), "-o", "a.exr")
    assert ran.code == 0
    assert "raykiln: warning: " in ran.err


def test_list_pages(remote: Run) -> None:
    jobs = [
        remote("submit", "cornell_box", *SMALL, "--label", "page=1").out.strip() for _ in range(3)
    ]
    listed = remote("list", "--label", "page=1", "--limit", "2", "--json").json
    assert [entry["id"] for entry in listed] == jobs[:0:-1]


def test_the_asynchronous_client_does_the_same(service: Service, tmp_path: Path) -> None:
    events: list[Event] = []

    async def run() -> None:
        async with AsyncClient(service.url) as client:
            assert "cornell_box" in [scene["name"] for scene in await client.scenes()]
            job = await client.submit({"name": "cornell_box"}, {"width": 8, "height": 8, "spp": 1})
            job = await client.wait(job.id, on_event=events.append)
            assert job.state == "succeeded"
            await client.download(job.id, "image.png", tmp_path / "a.png")
            await client.delete(job.id)
            with pytest.raises(ServerError, match=job.id):
                await client.job(job.id)

    asyncio.run(run())
    assert read_image(tmp_path / "a.png").shape[:2] == (8, 8)
    assert events[-1].data["state"] == "succeeded"


def test_cancel(remote: Run, service: Service, long_job: str) -> None:
    wait_for_state(service, long_job, "running")
    assert remote("cancel", long_job).code == 0
    ran = remote("watch", long_job)
    assert ran.code == 1
    assert "was cancelled" in ran.err.splitlines()[-1]
    assert remote("status", long_job, "--json").json["state"] == "cancelled"


def test_watch_as_json_lines(service: Service, remote: Run) -> None:
    job = remote("submit", "cornell_box", *SMALL).out.strip()
    out = remote("watch", job, "--json").out
    assert '"state": "succeeded"' in out


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["submit", "nothing.json"], "nothing.json: no such file"),
        (["submit", "cornell_box", "--spp", "0"], "--spp: "),
        (["submit", "cornell_box", "-o", "no/a.exr"], "-o: the folder does not exist"),
        (["submit", "cornell_box", "-o", "a.jpg"], "-o: not a place to download to"),
        (["submit", "cornell_box", "--label", "=x"], "--label: "),
        (["submit", "cornell_box", "--camera", "none such"], "none such"),
        (["submit", "cornell_box", "--priority", "999999"], "/priority"),
        (["status", "job-none"], "job-none"),
        (["watch", "job-none"], "job-none"),
        (["cancel", "job-none"], "job-none"),
        (["download", "job-none"], "job-none"),
        (["download", "job-none", "../x"], "NAME: not the name of an output"),
        (["list", "--state", "lazy"], "lazy"),
        (["list", "--server", "ftp://x"], "ftp://x: not the URL of a service"),
    ],
)
def test_careless_use_is_one_line(remote: Run, line: list[str], message: str) -> None:
    ran = remote(*line)
    assert ran.code == 2
    assert message in ran.error


def test_a_bad_scene_is_refused_with_its_place(remote: Run, tmp_path: Path) -> None:
    write_scene(tmp_path / "bad.json", shapes=[{"type": "sphere", "material": "gold"}])
    ran = remote("submit", "bad.json")
    assert ran.code == 2
    assert "gold" in ran.error


def test_no_service(raykiln: Run) -> None:
    ran = raykiln("list", "--server", "http://127.0.0.1:9")
    assert ran.code == 2
    assert ran.error.startswith("no raykiln service answers at http://127.0.0.1:9")


def test_a_token_is_needed_and_taken_from_the_environment(
    raykiln: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAYKILN_TOKEN", "open sesame")
    running = serve(tmp_path / "data")
    try:
        assert raykiln("list", "--server", running.url).code == 0
        monkeypatch.setenv("RAYKILN_TOKEN", "wrong")
        ran = raykiln("list", "--server", running.url)
        assert ran.code == 2
        assert "token" in ran.error
    finally:
        stop(running)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["--host", "0.0.0.0"], "token"),
        (["--port", "70000"], "port"),
        (["--slots", "0"], "slots"),
        (["--executor", "magic"], "executor"),
        (["--data-dir", "/dev/null/x"], "/dev/null/x"),
    ],
)
def test_serve_refuses_what_it_cannot_do(raykiln: Run, line: list[str], message: str) -> None:
    ran = raykiln("serve", "--data-dir", "d", *line)
    assert ran.code == 2
    assert message in ran.error


def test_serve_refuses_a_port_that_is_taken(service: Service, tmp_path: Path) -> None:
    port = service.url.rsplit(":", 1)[1]
    ran = raykiln_process("serve", "--data-dir", "d", "--port", port, cwd=tmp_path)
    assert ran.code == 2
    assert port in ran.error


def test_serve_ends_on_sigterm(tmp_path: Path) -> None:
    assert stop(serve(tmp_path / "data")) == 0


def on_terminal(line: list[str], cwd: Path, talk: dict[str, str]) -> Ran:
    """Run a command on a terminal; answers are typed once their text appears (^C interrupts)."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(cwd)
        os.execvpe(COMMAND[0], [*COMMAND, *line], {**os.environ, "COLUMNS": "200"})
    seen = ""
    waiting = dict(talk)
    while True:
        try:
            data = os.read(terminal, 4096)
        except OSError:
            break
        seen += data.decode(errors="replace")
        for text in [text for text in waiting if text in seen]:
            os.write(terminal, waiting.pop(text).encode())
    os.close(terminal)
    return Ran(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), seen, seen)


@pytest.mark.parametrize(("answer", "state"), [("c\n", "cancelled"), ("\n", "running")])
def test_ctrl_c_asks_what_to_do_with_the_job(
    service: Service, tmp_path: Path, answer: str, state: str
) -> None:
    line = ["submit", "cornell_box", "--spp", "1000000", "--wait", "--server", service.url]
    ran = on_terminal(line, tmp_path, {"spp": "\x03", "leave it running?": answer})
    assert ran.code == 130
    assert "Traceback" not in ran.out
    found = re.search(r"submitted (\S+) to", ran.out)
    assert found is not None
    job = found[1]
    try:
        if state == "running":
            assert f"raykiln watch {job}" in ran.out
        assert wait_for_state(service, job, state) == state
    finally:
        with Client(service.url) as client:
            if not client.job(job).is_final:
                client.cancel(job)
                client.wait(job, timeout_s=120)


def test_an_interrupted_wait_without_a_terminal_leaves_the_job(
    service: Service, tmp_path: Path
) -> None:
    line = ["submit", "cornell_box", "--spp", "1000000", "--wait", "--server", service.url]
    child = subprocess.Popen(
        [*COMMAND, *line],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stderr is not None
    job = child.stderr.readline().split()[1]
    wait_for_state(service, job, "running")
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 130
    assert f"job {job} goes on" in err
    with Client(service.url) as client:
        assert client.job(job).state == "running"
        client.cancel(job)
        client.wait(job, timeout_s=120)


def test_a_wait_survives_a_restart_of_the_service(tmp_path: Path) -> None:
    port = str(free_port())
    first = serve(tmp_path / "data", "--port", port)
    done: list[Any] = []

    def wait() -> None:
        with Client(first.url) as client:
            done.append(client.wait(job, timeout_s=120))

    try:
        with Client(first.url) as client:
            settings = {"width": 96, "height": 96, "spp": 1 << 20}
            job = client.submit({"name": "cornell_box"}, settings).id
        watcher = threading.Thread(target=wait)
        watcher.start()
        wait_for_state(first, job, "running")
    finally:
        first.process.kill()
        first.process.wait()
    second = serve(tmp_path / "data", "--port", port)
    try:
        wait_for_state(second, job, "running")
        assert watcher.is_alive()
        with Client(second.url) as client:
            client.cancel(job)
        watcher.join(timeout=120)
        assert [found.state for found in done] == ["cancelled"]
    finally:
        stop(second)
