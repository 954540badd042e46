"""`raykiln batch`: many scenes, each in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raykiln.image import read_image

from .support import COMMAND, Ran, raykiln_process, write_scene


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two good scenes and a broken one."""
    write_scene(tmp_path / "in/a.json")
    write_scene(tmp_path / "in/sub/b.json", lights=[])
    (tmp_path / "in/broken.json").write_text('{"shapes": [')
    return tmp_path / "in"


def batch(cwd: Path, *arguments: object) -> Ran:
    return raykiln_process("batch", *arguments, cwd=cwd)


def report(out: Path) -> dict[str, dict[str, Any]]:
    document = json.loads((out / "report.json").read_text())
    return {entry["name"]: entry for entry in document["scenes"]}


def test_a_broken_scene_fails_alone(folder: Path, tmp_path: Path) -> None:
    ran = batch(tmp_path, folder, "-o", "out", "--spp", "2", "--jobs", "2")
    assert ran.code == 1
    out = tmp_path / "out"
    entries = report(out)
    assert {name: entry["state"] for name, entry in entries.items()} == {
        "a": "done",
        "broken": "failed",
        "sub/b": "done",
    }
    assert "broken.json: line 1" in entries["broken"]["error"]
    assert entries["broken"]["exit_code"] == 2
    assert len(entries["sub/b"]["warnings"]) == 1
    files = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    finished = {
        f"{name}.{kind}" for name in ("a", "sub/b") for kind in ("exr", "png", "stats.json")
    }
    assert files == {"report.json", *finished}
    assert json.loads((out / "a.stats.json").read_text())["spp"] == 2
    assert read_image(out / "sub/b.exr").shape[:2] == (16, 24)


def test_resume_skips_what_is_finished_and_unchanged(folder: Path, tmp_path: Path) -> None:
    (folder / "broken.json").unlink()
    out = tmp_path / "out"
    assert batch(tmp_path, folder, "-o", out).code == 0
    before = {name: (out / f"{name}.exr").stat().st_mtime_ns for name in ("a", "sub/b")}
    write_scene(folder / "a.json", lights=[{"type": "constant", "radiance": 2.0}])
    ran = batch(tmp_path, folder, "-o", out, "--resume")
    assert ran.code == 0
    assert "sub/b: done before" in ran.err
    assert {name: entry["skipped"] for name, entry in report(out).items()} == {
        "a": False,
        "sub/b": True,
    }
    assert (out / "a.exr").stat().st_mtime_ns > before["a"]
    assert (out / "sub/b.exr").stat().st_mtime_ns == before["sub/b"]
    # A missing output, or other settings, are a reason to render again.
    (out / "sub/b.png").unlink()
    batch(tmp_path, folder, "-o", out, "--resume")
    assert (out / "sub/b.png").exists()
    batch(tmp_path, folder, "-o", out, "--resume", "--spp", "1")
    assert not any(entry["skipped"] for entry in report(out).values())


def test_a_manifest_sets_names_and_settings(tmp_path: Path) -> None:
    write_scene(tmp_path / "a.json")
    line = {"scene": "a.json", "output": "x/small", "settings": {"width": 8, "height": 8}}
    (tmp_path / "jobs.jsonl").write_text(f"{json.dumps(line)}\na.json\nnothing.json\n")
    ran = batch(tmp_path, "jobs.jsonl", "-o", "out", "--quiet")
    assert (ran.code, ran.out, ran.err) == (1, "", "")
    assert read_image(tmp_path / "out/x/small.png").shape[:2] == (8, 8)
    assert read_image(tmp_path / "out/a.png").shape[:2] == (16, 24)
    assert "nothing.json" in report(tmp_path / "out")["nothing"]["error"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["nothing", "-o", "out"], "nothing: no such file or folder"),
        (["in", "-o", "in/a.json"], "-o: cannot make the folder"),
        (["in", "-o", "out", "--jobs", "0"], "--jobs: out of range"),
        (["in", "-o", "out", "--spp", "0"], "--spp: "),
        (["in", "-o", "out", "--view", "x"], "--view: "),
    ],
)
def test_careless_use_is_refused(
    folder: Path, tmp_path: Path, line: list[str], message: str
) -> None:
    ran = batch(tmp_path, *line)
    assert ran.code == 2
    assert message in ran.error


def start(cwd: Path, *line: object) -> subprocess.Popen[str]:
    """Start a batch and return once a scene of it is being rendered."""
    child = subprocess.Popen(
        [*COMMAND, "batch", "--checkpoint-interval=0.1", *map(str, line)],
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_until(lambda: bool(renders(child.pid)))
    return child


def renders(parent: int) -> list[int]:
    """The child processes of a batch."""
    children = Path(f"/proc/{parent}/task/{parent}/children")
    return [int(text) for text in children.read_text().split()] if children.exists() else []


def wait_until(condition: Any, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_an_interrupted_batch_goes_on_with_the_same_bits(tmp_path: Path) -> None:
    settings = {"width": 128, "height": 128, "spp": 256}
    write_scene(tmp_path / "in/a.json", settings=settings)
    whole = raykiln_process("render", "in/a.json", "-o", "whole.exr", "--quiet", cwd=tmp_path)
    assert whole.code == 0
    child = start(tmp_path, "in", "-o", "out")
    checkpoints = tmp_path / "out/.work"
    wait_until(lambda: any(checkpoints.rglob("checkpoint")) or child.poll() is not None)
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=120)
    if child.returncode == 130:
        assert report(tmp_path / "out")["a"]["state"] == "interrupted"
        assert not (tmp_path / "out/a.exr").exists()
    assert batch(tmp_path, "in", "-o", "out", "--resume").code == 0
    np.testing.assert_array_equal(
        read_image(tmp_path / "out/a.exr"), read_image(tmp_path / "whole.exr")
    )
    assert not checkpoints.exists()


def test_a_crashed_render_fails_alone(long_scene: Path, tmp_path: Path) -> None:
    write_scene(tmp_path / "in/z.json")
    long_scene.rename(tmp_path / "in/a.json")
    child = start(tmp_path, "in", "-o", "out", "--jobs", "1")
    os.kill(renders(child.pid)[0], signal.SIGSEGV)
    child.communicate(timeout=120)
    assert child.returncode == 1
    entries = report(tmp_path / "out")
    assert entries["a"]["error"] == "the render process was ended by SIGSEGV"
    assert entries["z"]["state"] == "done"


def test_a_killed_batch_leaves_no_renders_behind(long_scene: Path, tmp_path: Path) -> None:
    child = start(tmp_path, long_scene.parent, "-o", "out")
    wait_until(lambda: any((tmp_path / "out/.work").rglob("checkpoint")))
    pids = renders(child.pid)
    child.kill()
    child.communicate(timeout=120)
    wait_until(lambda: all(map(is_gone, pids)))


def test_a_damaged_checkpoint_costs_only_the_time(tmp_path: Path) -> None:
    # Not done before the signal arrives, however many processors there are.
    settings = {"width": 128, "height": 128, "spp": 1536, "threads": 1}
    write_scene(tmp_path / "in/a.json", settings=settings)
    child = start(tmp_path, "in", "-o", "out")
    wait_until(lambda: any((tmp_path / "out/.work").rglob("checkpoint")))
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=120)
    (checkpoint,) = (tmp_path / "out/.work").rglob("checkpoint")
    checkpoint.write_bytes(b"noise" * 1000)
    assert batch(tmp_path, "in", "-o", "out", "--resume").code == 0
