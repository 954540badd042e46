"""The supervisor against children that misbehave: tiny programs in place of the renderer."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from raykiln_service.executors.base import Outcome, OutcomeKind, StopReason, Task
from raykiln_service.executors.local import LocalExecutor
from raykiln_service.executors.process import JsonChild
from raykiln_service.planner import Unit

_HEAD = """
import json, os, signal, sys, time
from raykiln_service.executors.childside import Channel
channel = Channel()
def tell(kind, **fields): channel.send(type=kind, token=task["token"], **fields)
task = channel.inbox.get()
"""


class Recorder:
    """A watcher that notes what it hears, and stops when told to."""

    def __init__(self, stop: Callable[[], StopReason | None] = lambda: None) -> None:
        self.heard: list[Mapping[str, Any]] = []
        self.lines: list[str] = []
        self.previews = 0
        self.asked = 0
        self._stop = stop

    def progress(self, progress: Mapping[str, Any]) -> None:
        self.heard.append(progress)

    def preview(self) -> None:
        self.previews += 1

    def log(self, line: str) -> None:
        self.lines.append(line)

    def stop_reason(self) -> StopReason | None:
        self.asked += 1
        return self._stop()


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Runs one task in a child with the given program."""
    paths = [str(tmp_path), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(os.path.abspath(p) for p in paths if p))

    def run_program(program: str, watcher: Recorder) -> Outcome:
        (tmp_path / "odd_child.py").write_text(_HEAD + textwrap.dedent(program))
        executor = LocalExecutor(1, module="odd_child")
        task = Task(
            job_id="job-1",
            token="token-1",
            unit=Unit(0),
            scene_path=tmp_path / "scene.json",
            base_dir=tmp_path,
            settings={},
            outputs=("exr",),
            work_dir=tmp_path,
            checkpoint=tmp_path / "checkpoint",
            preview=tmp_path / "preview.png",
        )
        try:
            return executor.run(0, task, watcher)
        finally:
            executor.stop()

    return run_program


def test_news_reach_the_watcher_and_noise_does_not(run: Any, tmp_path: Path) -> None:
    def enough() -> StopReason | None:
        # Lines come by a way of their own: the child goes on when they are there.
        return StopReason.SHUTDOWN if "a warning" in watcher.lines else None

    watcher = Recorder(stop=enough)
    outcome = run(
        """
        print("noise that looks like news:", json.dumps({"type": "done", "token": "token-1"}))
        tell("progress", progress={"phase": "render", "fraction": 0.5})
        channel.send(type="progress", token="of another task", progress={"phase": "x"})
        tell("preview")
        open(task["preview"], "wb").write(b"a picture")
        tell("preview")
        sys.stderr.write("a warning\\n")
        sys.stderr.flush()
        while not channel.stop_reason(task["token"]): time.sleep(0.01)
        tell("done", result={"complete": True})
        time.sleep(60)
        """,
        watcher,
    )
    assert outcome == Outcome(OutcomeKind.DONE, result={"complete": True})
    assert watcher.heard == [{"phase": "render", "fraction": 0.5}]
    # The first was none: there was no file.
    assert (watcher.previews, "a warning" in watcher.lines) == (1, True)
    assert (tmp_path / "preview.png").read_bytes() == b"a picture"


@pytest.mark.parametrize(
    ("program", "how"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "ended by SIGSEGV"),
        ("os._exit(7)", "exited with code 7"),
        ("raise ValueError('no good')", "ValueError: no good"),
        ("os.abort()", "SIGABRT"),
        ("channel._out.close(); time.sleep(0.5); os._exit(3)", "exited with code 3"),
    ],
)
def test_a_child_that_breaks_is_a_broken_attempt(run: Any, program: str, how: str) -> None:
    outcome = run(program, Recorder())
    assert outcome.kind is OutcomeKind.BROKEN
    assert outcome.error["reason"] == "crashed"
    assert how in outcome.error["detail"]


def test_a_child_that_stops_when_told_keeps_its_image(run: Any) -> None:
    watcher = Recorder(stop=lambda: StopReason.CANCEL if watcher.heard else None)
    outcome = run(
        """
        # Who is still loading has nothing to keep, and is not waited for.
        tell("progress", progress={"phase": "render"})
        while channel.stop_reason(task["token"]) != "cancel": time.sleep(0.01)
        tell("progress", progress={"phase": "encode"})
        time.sleep(1.5)
        tell("stopped", result={"complete": False})
        """,
        watcher,
    )
    assert outcome == Outcome(OutcomeKind.STOPPED, result={"complete": False})


def test_a_child_that_does_not_stop_is_killed(run: Any, tmp_path: Path) -> None:
    watcher = Recorder(stop=lambda: StopReason.CANCEL if watcher.heard else None)
    outcome = run(
        f"""
        open({str(tmp_path / "pid")!r}, "w").write(str(os.getpid()))
        tell("progress", progress={{"phase": "render"}})
        time.sleep(600)
        """,
        watcher,
    )
    assert outcome == Outcome(OutcomeKind.STOPPED)
    assert not Path(f"/proc/{(tmp_path / 'pid').read_text()}").exists()


def test_the_supervisor_asks_on_while_the_child_is_silent(run: Any) -> None:
    watcher = Recorder(stop=lambda: StopReason.SHUTDOWN if watcher.asked >= 5 else None)
    outcome = run(
        """
        while not channel.stop_reason(task["token"]): time.sleep(0.01)
        tell("done", result={"complete": True})
        """,
        watcher,
    )
    assert outcome.kind is OutcomeKind.DONE


def test_a_broken_child_is_replaced_and_a_good_one_kept(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "two_tasks.py").write_text(
        _HEAD.replace("task = channel.inbox.get()", "")
        + textwrap.dedent(
            """
            while True:
                task = channel.inbox.get()
                if task["settings"].get("break"): os._exit(1)
                if task["settings"].get("last words"): tell("log", line="no more"); os._exit(1)
                tell("done", result={"pid": os.getpid()})
                if task["settings"].get("then die"): channel.inbox.get(); os._exit(1)
            """
        )
    )
    executor = LocalExecutor(1, module="two_tasks")

    def pid_of(**settings: Any) -> Any:
        task = Task(
            job_id="job-1",
            token="t",
            unit=Unit(0),
            scene_path=tmp_path,
            base_dir=tmp_path,
            settings=settings,
            outputs=(),
            work_dir=tmp_path,
            checkpoint=tmp_path / "checkpoint",
            preview=tmp_path / "preview.png",
            scene_key="x",
        )
        return (executor.run(0, task, Recorder()).result or {}).get("pid")

    try:
        first = pid_of()
        assert pid_of() == first
        assert pid_of(**{"break": True}) is None
        assert pid_of() not in (None, first)
        # Who was taken for alive, and is not there when its next task comes, has failed at nothing.
        second = pid_of(**{"then die": True})
        third = pid_of()
        assert third not in (None, second)
        assert pid_of() == third
        assert pid_of(**{"last words": True}) is None
    finally:
        executor.stop()


def test_children_die_with_their_supervisor(tmp_path: Path) -> None:
    (tmp_path / "idle_child.py").write_text(_HEAD)
    program = textwrap.dedent(
        """
        import time
        from raykiln_service.executors.process import JsonChild
        child = JsonChild("idle_child")
        child.send({"type": "task", "token": "t"})
        print(child.pid, flush=True)
        time.sleep(600)
        """
    )
    paths = [str(tmp_path), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(p) for p in paths if p)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env=env, text=True
    ) as supervisor:
        assert supervisor.stdout is not None
        pid = int(supervisor.stdout.readline())
        assert Path(f"/proc/{pid}").exists()
        supervisor.kill()
    deadline = time.monotonic() + 60
    while Path(f"/proc/{pid}").exists() and "Z" not in _state(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return "Z"


def test_a_child_without_its_supervisor_does_not_even_start(tmp_path: Path) -> None:
    (tmp_path / "lone_child.py").write_text(_HEAD + "open('was_here', 'w')")
    env = {**os.environ, "PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    paths = [os.path.abspath(p) for p in env["PYTHONPATH"].split(os.pathsep) if p]
    env["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *paths])
    done = subprocess.run(
        [sys.executable, "-m", "lone_child", "1"], env=env, cwd=tmp_path, timeout=120, check=False
    )
    assert done.returncode == 0
    assert not (tmp_path / "was_here").exists()


def test_messages_to_a_dead_child_do_no_harm() -> None:
    child = JsonChild("raykiln_service.executors.check")
    child.kill()
    child.send({"type": "check"})
    assert not child.is_alive()
    assert child.receive(60.0) is None
