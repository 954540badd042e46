"""Many pictures from the command line: rendered here, and by a service."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk
from raykiln.image import read_exr_layers, read_image
from raykiln_service.client import AsyncClient, Client
from raykiln_service.commands.frames import numbered, parse_times

from .support import BOX, COMMAND, Run, write_scene
from .test_remote import Service, serve, stop

SMALL = ("--size", "16x12", "--spp", "2", "--quiet")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Any:
    running: Service = serve(tmp_path_factory.mktemp("service"))
    yield running
    assert stop(running) == 0


def names_in(folder: Path, pattern: str = "*") -> list[str]:
    return sorted(path.name for path in folder.glob(pattern))


# Here.


def test_a_turntable_rendered_here(raykiln: Run, scene: Path, tmp_path: Path) -> None:
    ran = raykiln("render", scene, "--turntable", 3, "-o", "out_####.png", "-o", "turn.exr", *SMALL)
    assert (ran.code, ran.err) == (0, "")
    assert names_in(tmp_path, "out_*") == ["out_0001.png", "out_0002.png", "out_0003.png"]
    assert names_in(tmp_path, "turn*") == ["turn.0001.exr", "turn.0002.exr", "turn.0003.exr"]
    loaded = rk.load_scene(scene)
    camera = rk.turntable(loaded, 3)[1]
    loaded.set_camera(camera)
    expected = rk.render(loaded, rk.RenderSettings(width=16, height=12, spp=2)).image
    assert np.array_equal(read_exr_layers(tmp_path / "turn.0002.exr")["beauty"], expected)


def test_options_of_the_turntable(raykiln: Run, tmp_path: Path) -> None:
    # A ball that is not in the middle, so that every option shows.
    ball = {"type": "sphere", "center": [0.6, 0.2, 0.1], "radius": 0.7, "material": "red"}
    scene = write_scene(tmp_path / "ball.json", shapes=[ball])
    seen = set()
    for name, options in {
        "plain": (),
        "axis": ("--axis", "x"),
        "start": ("--start-degrees", "40"),
        "elevation": ("--elevation", "30"),
        "target": ("--target", "1,0,0.5", "--start-degrees", "40"),
        "camera": ("--camera", "top", "--start-degrees", "40"),
        "half": ("--degrees", "180", "--start-degrees", "20"),
    }.items():
        line = ("render", scene, "--turntable", 2, "-o", f"{name}.exr", *options, *SMALL)
        assert raykiln(*line).code == 0
        seen.add(read_exr_layers(tmp_path / f"{name}.0002.exr")["beauty"].tobytes())
    assert len(seen) == 7


def test_an_interrupted_turntable_goes_on_with_the_same_bits(
    raykiln: Run, scene: Path, tmp_path: Path
) -> None:
    """What is finished is kept, what was under way goes on, what is damaged is made anew."""
    size = ["--size", "128x96", "--spp", "600", "--threads", "1"]
    line = ["render", str(scene), "--turntable", "3", *size]
    kept = ["--checkpoint", "turn.ckpt", "--checkpoint-interval", "0.05"]
    assert raykiln(*line, "-o", "whole.exr", "-q").code == 0
    child = subprocess.Popen([*COMMAND, *line, "-o", "a.exr", *kept, "-q"], cwd=tmp_path)
    while not (tmp_path / "turn.0002.ckpt").exists():
        assert child.poll() is None
        time.sleep(0.005)
    child.kill()
    child.wait()
    first = tmp_path / "a.0001.exr"
    written = first.stat().st_mtime_ns
    ran = raykiln(*line, "-o", "a.exr", *kept, "--resume")
    assert ran.code == 0
    assert f"{scene} 1/3 is finished, and kept" in ran.err
    assert len(re.findall("^rendered", ran.out, re.MULTILINE)) == 2
    assert first.stat().st_mtime_ns == written
    for number in (1, 2, 3):
        a, b = (tmp_path / f"{name}.000{number}.exr" for name in ("a", "whole"))
        assert a.read_bytes() == b.read_bytes()
    assert names_in(tmp_path, "turn*") == ["turn.ckpt"]
    # Once more: only what is not as it was left.
    first.write_bytes(b"damaged")
    (tmp_path / "a.0003.exr").unlink()
    again = raykiln(*line, "-o", "a.exr", *kept, "--resume")
    assert len(re.findall("^rendered", again.out, re.MULTILINE)) == 2
    assert first.read_bytes() == (tmp_path / "whole.0001.exr").read_bytes()
    # Another wish makes other images.
    other = raykiln(*line, "-o", "a.exr", *kept, "--resume", "--half")
    assert len(re.findall("^rendered", other.out, re.MULTILINE)) == 3


def test_all_cameras_with_statistics(raykiln: Run, scene: Path, tmp_path: Path) -> None:
    ran = raykiln("render", scene, "--all-cameras", "--size", "16x12", "--spp", 2,
                  "--vary-seed", "-o", "c.exr", "--stats", "s.json")  # fmt: skip
    assert ran.code == 0
    assert names_in(tmp_path, "c.*") == ["c.0001.exr", "c.0002.exr"]
    assert json.loads((tmp_path / "s.0002.json").read_text())["spp"] == 2
    assert re.findall(r"[cs]\.000\d\.\w+", ran.out) == [
        "c.0001.exr", "s.0001.json", "c.0002.exr", "s.0002.json"
    ]  # fmt: skip
    raykiln("render", scene, "--camera", "top", "--seed", 1, "-o", "one.exr", *SMALL)
    one, other = (read_exr_layers(tmp_path / f"{name}.exr")["beauty"] for name in ("c.0002", "one"))
    assert np.array_equal(one, other)


@pytest.mark.parametrize(
    ("options", "where"),
    [
        (("--turntable", "0"), "--turntable: "),
        (("--turntable", "3", "--all-cameras"), "--turntable, --all-cameras, --times: "),
        (("--turntable", "3", "--axis", "w"), "--axis: "),
        (("--turntable", "3", "--target", "1,2"), "--target: "),
        (("--turntable", "3", "--elevation", "90"), "--elevation: "),
        (("--turntable", "3", "--resume"), "--resume: "),
        (("--turntable", "3", "--checkpoint", "ball.json", "--resume"), "--checkpoint: "),
        (("--degrees", "3"), "--degrees: "),
        (("--vary-seed",), "--vary-seed: "),
        (("--times", "0:1"), "--times: "),
        (("--times", "now"), "--times: "),
        (("--all-cameras", "--camera", "top"), "--camera: "),
    ],
)
def test_frames_that_cannot_be_rendered(
    raykiln: Run, scene: Path, tmp_path: Path, options: tuple[str, ...], where: str
) -> None:
    ran = raykiln("render", scene, "-o", "x.png", *SMALL, *options)
    assert ran.code == 2
    assert ran.error.startswith(where)
    assert names_in(tmp_path) == ["ball.json"]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("out_####.png", "out_0012.png"),
        ("out_##.png", "out_12.png"),
        ("out_#.png", "out_12.png"),
        ("a#b_######.exr", "a#b_000012.exr"),
        ("out.png", "out.0012.png"),
    ],
)
def test_numbers_in_file_names(path: str, expected: str) -> None:
    assert numbered(Path(path), "0012") == Path(expected)
    assert numbered(Path(path), None) == Path(path)


def test_ranges_of_time() -> None:
    assert parse_times("0:2:24") == {"start": 0, "end": 2, "fps": 24}
    assert parse_times(":1.5") == {"end": 1.5}
    assert parse_times("1:") == {"start": 1}
    assert parse_times("::12") == {"fps": 12}


# By a service.


def test_submit_and_download_frames(
    raykiln: Run, service: Service, scene: Path, tmp_path: Path
) -> None:
    pytest.importorskip("PIL", reason="the extra `video` is not installed")
    folder = tmp_path / "all"
    folder.mkdir()
    ran = raykiln("submit", scene, "--server", service.url, "--turntable", 3, "--animation",
                  "webp", *SMALL, "-o", folder, "-o", "f_##.png", "--stats", "s.json")  # fmt: skip
    assert (ran.code, ran.err) == (0, "")
    sequence = [f"{stem}.000{i}.{kind}" for stem, kind in (("image", "exr"), ("image", "png"),
                ("stats", "json")) for i in (1, 2, 3)]  # fmt: skip
    single = ["animation.webp", "contact_sheet.png", "stats.json"]
    assert names_in(folder) == sorted([*sequence, *single])
    assert names_in(tmp_path, "f_*") == ["f_01.png", "f_02.png", "f_03.png"]
    assert json.loads((tmp_path / "s.json").read_text())["samples"] == 3 * 16 * 12 * 2
    raykiln("render", scene, "--turntable", 3, "-o", "here.exr", *SMALL)
    for i in (1, 2, 3):
        there = read_exr_layers(folder / f"image.000{i}.exr")["beauty"]
        assert np.array_equal(there, read_exr_layers(tmp_path / f"here.000{i}.exr")["beauty"])
    with Client(service.url) as client:
        (job, *_) = client.jobs(limit=1).items
    assert "3/3 frames" in raykiln("status", job.id, "--server", service.url).out
    only = raykiln("download", job.id, "image.png", "--frame", 2, "-o", "two.png",
                   "--exposure", 1, "--server", service.url)  # fmt: skip
    assert only.code == 0
    brighter = read_image(tmp_path / "two.0002.png").astype(int)
    assert brighter.sum() > read_image(folder / "image.0002.png").astype(int).sum()
    assert not (tmp_path / "two.0001.png").exists()
    for options, where in (
        (("--frame", 9), "--frame: "),
        (("nothing.exr",), f"no frame of job {job.id} has nothing.exr"),
    ):
        failed = raykiln("download", job.id, *options, "-o", tmp_path, "--server", service.url)
        assert failed.code == 2
        assert failed.error.startswith(where)


def test_what_the_service_refuses(raykiln: Run, service: Service, scene: Path) -> None:
    for options, where in (
        (("--turntable", 100_000), "/frames/turntable/count"),
        (("--times", "0:1"), "/frames/time"),
        (("--animation", "mp4"), "--animation: "),
        (("--animation", "gif", "--turntable", 2), "--animation: "),
    ):
        ran = raykiln("submit", scene, "--server", service.url, *options)
        assert ran.code == 2
        assert where in ran.error


def test_the_clients_know_frames(service: Service, tmp_path: Path) -> None:
    settings = {"width": 16, "height": 12, "spp": 2}
    inline = {"inline": BOX}
    with Client(service.url) as client:
        job = client.submit(inline, settings, frames={"cameras": "all"}, wait_s=60)
        assert job.frames is not None
        assert (job.state, job.frames.succeeded, job.frames.count) == ("succeeded", 2, 2)
        frames = client.frames(job.id)
        assert [frame.settings["camera"] for frame in frames] == ["front", "top"]
        assert client.frames(job.id, state="failed") == []
        client.download(job.id, "image.exr", tmp_path / "2.exr", frame=2)
        # The last line of the log, which is in the archive, comes a moment after the end.
        deadline = time.monotonic() + 60
        log = client.download(job.id, "log.txt", tmp_path / "log.txt")
        while "the job is succeeded" not in log.read_text():
            assert time.monotonic() < deadline
            client.download(job.id, "log.txt", log)
        client.download_archive(job.id, tmp_path / "all.zip")
    with zipfile.ZipFile(tmp_path / "all.zip") as archive:
        assert archive.testzip() is None
        assert archive.read("image.0002.exr") == (tmp_path / "2.exr").read_bytes()

    async def again() -> list[str]:
        async with AsyncClient(service.url) as client:
            same = await client.frames(job.id)
            await client.download(job.id, "image.exr", tmp_path / "again.exr", frame=2)
            await client.download_archive(job.id, tmp_path / "again.zip")
            return [frame.name for frame in same]

    assert asyncio.run(again()) == ["0001", "0002"]
    assert (tmp_path / "again.exr").read_bytes() == (tmp_path / "2.exr").read_bytes()
    assert (tmp_path / "again.zip").read_bytes() == (tmp_path / "all.zip").read_bytes()
