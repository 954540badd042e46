"""`raykiln render`: outputs, settings, interruption, and careless use."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from raykiln.image import read_exr_layers, read_image

from .support import COMMAND, Run, raykiln_process, write_scene


def test_without_outputs_the_scene_gives_the_names(raykiln: Run, scene: Path) -> None:
    ran = raykiln("render", scene)
    assert ran.code == 0
    summary, *paths = ran.out.splitlines()
    assert re.match(r"rendered 24x16, 4/4 spp in .*samples/s.*rays/s", summary)
    assert paths == ["ball.exr", "ball.png"]
    assert read_image("ball.exr").shape[:2] == (16, 24)
    assert read_image("ball.png").dtype == np.uint8


def test_each_pass_prints_a_line_without_a_terminal(scene: Path, tmp_path: Path) -> None:
    ran = raykiln_process("render", scene, "-o", "a.exr", "--spp", "20", cwd=tmp_path)
    assert ran.code == 0
    assert "pass 1: " in ran.err
    assert "20/20 spp, 100%" in ran.err


def test_quiet_prints_nothing(scene: Path, tmp_path: Path) -> None:
    ran = raykiln_process("render", scene, "-o", "a.exr", "--quiet", cwd=tmp_path)
    assert (ran.code, ran.out, ran.err) == (0, "", "")


def test_options_come_before_the_scene_and_the_scene_before_defaults(
    raykiln: Run, scene: Path
) -> None:
    ran = raykiln(
        *("render", scene, "-o", "a.exr", "--stats", "s.json", "--spp", "2"),
        *("--aov", "normal", "--aov", "depth,albedo"),
    )
    assert ran.code == 0
    stats = json.loads(Path("s.json").read_text())
    assert stats["spp"] == 2
    assert stats["samples"] == 24 * 16 * 2
    assert stats["total_s"] > 0
    layers = read_exr_layers("a.exr")
    assert {"beauty", "normal", "depth", "albedo"} <= layers.keys()
    assert layers["normal"].shape == (16, 24, 3)


def test_a_camera_is_chosen_by_name(raykiln: Run, scene: Path) -> None:
    for camera in ("front", "top"):
        assert raykiln("render", scene, "-o", f"{camera}.exr", "--camera", camera).code == 0
    assert not np.array_equal(read_image("front.exr"), read_image("top.exr"))


def test_a_crop_is_measured_by_the_size_of_the_scene(raykiln: Run, tmp_path: Path) -> None:
    large = write_scene(tmp_path / "large.json", settings={"width": 800, "height": 800, "spp": 1})
    assert raykiln("render", large, "-o", "a.exr", "--crop", "700,600,720,610").code == 0
    small = write_scene(tmp_path / "small.json", settings={"width": 8, "height": 8, "spp": 1})
    ran = raykiln("render", small, "-o", "a.exr", "--crop", "0,0,9,9")
    assert ran.code == 2
    assert "crop must lie within the 8 x 8 image" in ran.error


def test_the_same_seed_gives_the_same_bits_on_any_number_of_threads(
    raykiln: Run, scene: Path
) -> None:
    for threads in (1, 2):
        line = ("render", scene, "-o", f"{threads}.exr", "--threads", threads, "--seed", 5)
        assert raykiln(*line).code == 0
    assert raykiln("render", scene, "-o", "other.exr", "--seed", 6).code == 0
    np.testing.assert_array_equal(read_image("1.exr"), read_image("2.exr"))
    assert not np.array_equal(read_image("1.exr"), read_image("other.exr"))


def test_exposure_and_view_change_the_png_alone(raykiln: Run, scene: Path) -> None:
    assert raykiln("render", scene, "-o", "a.png", "-o", "a.exr").code == 0
    shown = ("--exposure", "-2", "--view", "agx")
    assert raykiln("render", scene, "-o", "b.png", "-o", "b.exr", *shown).code == 0
    assert read_image("b.png").mean() < read_image("a.png").mean()
    np.testing.assert_array_equal(read_image("a.exr"), read_image("b.exr"))


def test_a_bundled_scene_renders_by_name_unless_a_file_has_it(raykiln: Run, tmp_path: Path) -> None:
    small = ("--size", "16x16", "--spp", "1", "-o", "a.exr")
    assert raykiln("render", "cornell_box", *small).code == 0
    (tmp_path / "cornell_box").write_text("not a scene")
    assert raykiln("render", "cornell_box", *small).code == 2


def test_warnings_of_the_scene_are_said(raykiln: Run, tmp_path: Path) -> None:
    dark = write_scene(tmp_path / "dark.json", lights=[], cameras=[])
    ran = raykiln("render", dark, "-o", "a.exr")
    assert ran.code == 0
    assert ran.err.count("raykiln: warning: ") == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "empty.json"),
        ('{"shapes": [', "empty.json: line 1"),
        ("[]", "empty.json"),
        ('{"shapes": [{"type": "sphere", "radius": -1}]}', "/shapes/0/radius"),
        ('{"shapes": [{"type": "sphere", "material": "gold"}]}', "gold"),
        ('{"shapes": []}', "empty.json"),
        ("\x00\xff", "empty.json"),
        ('{"settings": {"spp": 0}, "shapes": [{"type": "sphere"}]}', "/settings/spp: "),
        ('{"settings": {"samples": 9}, "shapes": [{"type": "sphere"}]}', "/settings/samples: "),
    ],
)
def test_a_bad_scene_is_one_line_with_its_place(
    raykiln: Run, tmp_path: Path, content: str, message: str
) -> None:
    (tmp_path / "empty.json").write_bytes(content.encode("latin-1"))
    ran = raykiln("render", "empty.json", "-o", "a.exr")
    assert ran.code == 2
    assert message in ran.error
    assert not Path("a.exr").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["nothing.json"], "nothing.json: no such file"),
        (["corn"], "corn: no such file, nor a bundled scene; bundled: .*cornell_box"),
        (["."], r"\.: is a folder"),
        (["/dev/null"], "/dev/null: is not a regular file"),
        (["x" * 5000], "not a usable path"),
        (["ball.json", "-o", "a.jpg"], r"-o: .*a\.jpg; accepted: \.exr, \.png"),
        (["ball.json", "-o", "a"], r"-o: cannot write a file of this kind: a"),
        (["ball.json", "-o", "no/a.exr"], r"-o: the folder does not exist \(found no\)"),
        (["ball.json", "-o", "folder.exr"], "-o: a folder stands in the way"),
        (["ball.json", "--stats", "no/s.json"], "--stats: the folder does not exist"),
        (["ball.json", "--resume"], "--resume: .*accepted: --checkpoint FILE"),
        (["ball.json", "-o", "a.exr", "--checkpoint", "a.exr"], "--checkpoint: .* an output"),
        (["ball.json", "--size", "0x10"], r"--size: .*\(found 0\)"),
        (["ball.json", "--spp", "0"], r"--spp: .*\(found 0\); accepted: 1 to 1048576"),
        (["ball.json", "--size", "100000x100000"], r"--size: .*\(found 100000\)"),
        (["ball.json", "--size", "big"], r"--size: not a size \(found big\)"),
        (["ball.json", "--aov", "colour"], r"--aov: .*found 'colour'.*accepted: albedo"),
        (["ball.json", "--camera", "back"], "back.*front.*top"),
        (["ball.json", "--crop", "0,0,99,99"], "crop"),
        (["ball.json", "--view", "film"], r"--view: .*\(found film\); accepted: srgb, agx"),
        (["ball.json", "--exposure", "nan"], "--exposure: out of range"),
        (["ball.json", "--base-dir", "no"], "--base-dir: no such folder"),
        (["ball.json", "--time-budget", "0"], "--time-budget: "),
        (["ball.json", "--checkpoint-interval", "-1"], "--checkpoint-interval: "),
        (["ball.txt"], r"ball\.txt: .*accepted: "),
    ],
)
def test_careless_use_is_refused_before_rendering(
    raykiln: Run, scene: Path, tmp_path: Path, line: list[str], message: str
) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "ball.txt").write_text("hello")
    before = sorted(tmp_path.rglob("*"))
    ran = raykiln("render", *line)
    assert ran.code == 2
    assert re.search(message, ran.error), ran.error
    assert sorted(tmp_path.rglob("*")) == before


def test_a_disk_that_takes_no_more_is_a_failed_render(scene: Path, tmp_path: Path) -> None:
    def limit_file_size() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))

    ran = raykiln_process(
        *("render", scene, "-o", "a.exr", "--quiet"), cwd=tmp_path, preexec_fn=limit_file_size
    )
    assert ran.code == 1
    assert "a.exr: cannot write: " in ran.error
    assert sorted(tmp_path.iterdir()) == [scene]


def start(line: list[str], cwd: Path) -> subprocess.Popen[str]:
    """Start a render and return once its first pass is done."""
    child = subprocess.Popen(
        [*COMMAND, *line],
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stderr is not None
    assert child.stderr.readline().startswith("pass 1: ")
    return child


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_render_keeps_what_it_has(
    long_scene: Path, tmp_path: Path, number: signal.Signals
) -> None:
    line = ["render", str(long_scene), "-o", "a.exr", "-o", "a.png", "--checkpoint", "c.ckpt"]
    child = start(line, tmp_path)
    child.send_signal(number)
    out, err = child.communicate(timeout=60)
    assert child.returncode == 130
    assert "Traceback" not in err
    assert out.startswith("partial image: 512x512, ")
    assert "go on with --checkpoint c.ckpt --resume" in err
    assert (tmp_path / "c.ckpt").stat().st_size > 0
    image = read_image(tmp_path / "a.exr")
    assert image.shape[:2] == (512, 512)
    assert np.isfinite(image).all()
    assert image.mean() > 0.1


def test_a_resumed_render_has_the_bits_of_an_undisturbed_one(scene: Path, tmp_path: Path) -> None:
    settings = ["--size", "128x128", "--spp", "96"]
    whole = raykiln_process("render", scene, "-o", "whole.exr", *settings, cwd=tmp_path)
    assert whole.code == 0
    line = ["render", str(scene), "-o", "a.exr", "--checkpoint", "c.ckpt", *settings]
    child = start(line, tmp_path)
    time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    resumed = raykiln_process(*line, "--resume", cwd=tmp_path)
    assert resumed.code == 0
    np.testing.assert_array_equal(
        read_image(tmp_path / "a.exr"), read_image(tmp_path / "whole.exr")
    )


def damaged(data: bytes, how: str) -> bytes:
    return {"empty": b"", "cut": data[: len(data) // 2], "noise": data[:100] + b"?" * 500}[how]


@pytest.mark.parametrize("how", ["empty", "cut", "noise"])
def test_a_damaged_checkpoint_is_one_line(
    raykiln: Run, long_scene: Path, tmp_path: Path, how: str
) -> None:
    line = ["render", str(long_scene), "-o", "a.exr", "--checkpoint", "c.ckpt"]
    child = start(line, tmp_path)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    checkpoint = tmp_path / "c.ckpt"
    checkpoint.write_bytes(damaged(checkpoint.read_bytes(), how))
    ran = raykiln(*line, "--resume", "--quiet")
    assert ran.code == 1
    assert "c.ckpt" in ran.error


def test_a_checkpoint_of_another_render_is_refused(
    raykiln: Run, long_scene: Path, tmp_path: Path
) -> None:
    line = ["render", str(long_scene), "-o", "a.exr", "--checkpoint", "c.ckpt"]
    child = start(line, tmp_path)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    ran = raykiln(*line, "--resume", "--quiet", "--seed", "9")
    assert ran.code == 1
    assert "c.ckpt" in ran.error


def test_a_missing_checkpoint_starts_from_the_beginning(raykiln: Run, scene: Path) -> None:
    assert raykiln("render", scene, "-o", "a.exr", "--checkpoint", "c", "--resume").code == 0
    assert Path("a.exr").exists()


def test_what_is_no_file_is_not_replaced_by_one(raykiln: Run, scene: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.exr"
    os.mkfifo(pipe)
    ran = raykiln("render", scene, "-o", pipe)
    assert (ran.code, ran.error) == (2, f"-o: not a regular file (found {pipe})")
    assert pipe.is_fifo()
