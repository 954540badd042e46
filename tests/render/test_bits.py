"""Same scene, settings, seed and build: the same bits, however the work was cut up."""

from __future__ import annotations

import _thread
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .bit_scene import SETTINGS, bit_scene
from .support import sha256

SPP = 40


def settings(**changes: Any) -> rk.RenderSettings:
    return rk.RenderSettings(**{**SETTINGS, "spp": SPP, **changes})


def hashes(result: rk.RenderResult) -> dict[str, str]:
    """Of the image and of every layer."""
    layers = {"image": result.image, **result.aovs}
    return {name: sha256(layer) for name, layer in layers.items()}


@pytest.fixture(scope="module")
def undisturbed() -> rk.RenderResult:
    return rk.render(bit_scene(), settings())


def stop_at(spp: int) -> Callable[[rk.Progress], bool]:
    """Says stop as soon as a sample beyond `spp` a pixel was begun."""
    pixels = SETTINGS["width"] * SETTINGS["height"]
    return lambda progress: progress.samples <= spp * pixels


class TestThreadsAndProcesses:
    @pytest.mark.parametrize("threads", [1, 2, 3, 8])
    def test_threads(self, undisturbed: rk.RenderResult, threads: int) -> None:
        found = rk.render(bit_scene(), settings(threads=threads))
        assert found.stats.threads == threads
        assert hashes(found) == hashes(undisturbed)

    def test_another_process(self, undisturbed: rk.RenderResult, tmp_path: Path) -> None:
        path = tmp_path / "state"
        run = subprocess.run(command(path, SPP), check=True, capture_output=True, cwd=FOLDER)
        assert run.stdout
        resumed = rk.render(bit_scene(), settings(), checkpoint=path, resume=True)
        assert hashes(resumed) == hashes(undisturbed)

    def test_another_seed_is_another_image(self, undisturbed: rk.RenderResult) -> None:
        other = rk.render(bit_scene(), settings(seed=8))
        assert hashes(other)["image"] != hashes(undisturbed)["image"]


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("crop", [(0, 0, 67, 45), (0, 0, 1, 1), (5, 7, 41, 30), (60, 40, 67, 45)])
def test_crops(sampler: str, crop: tuple[int, int, int, int]) -> None:
    whole = rk.render(bit_scene(), settings(spp=8, sampler=sampler))
    part = rk.render(bit_scene(), settings(spp=8, sampler=sampler, crop=crop))
    x0, y0, x1, y1 = crop
    assert part.image.shape == (y1 - y0, x1 - x0, 3)
    np.testing.assert_array_equal(part.image, whole.image[y0:y1, x0:x1])
    for name, layer in part.aovs.items():
        np.testing.assert_array_equal(layer, whole.aovs[name][y0:y1, x0:x1])


class TestResume:
    @pytest.mark.parametrize("at", [0, 1, 3, 16, 31])
    def test_after_a_stop(self, undisturbed: rk.RenderResult, tmp_path: Path, at: int) -> None:
        path = tmp_path / "state"
        part = rk.render(bit_scene(), settings(), stop_at(at), checkpoint=path)
        assert not part.complete
        assert part.stats.spp < SPP
        rest = rk.render(bit_scene(), settings(threads=3), checkpoint=path, resume=True)
        assert rest.complete
        assert hashes(rest) == hashes(undisturbed)
        assert rest.stats.samples == rest.stats.camera_rays == undisturbed.stats.samples
        assert rest.stats.bounce_rays == undisturbed.stats.bounce_rays
        assert rest.stats.shadow_rays == undisturbed.stats.shadow_rays

    def test_after_many_stops(self, undisturbed: rk.RenderResult, tmp_path: Path) -> None:
        path, stops = tmp_path / "state", 0
        while stops < 200:
            result = rk.render(
                bit_scene(), settings(), lambda _: False, checkpoint=path, resume=True
            )
            if result.complete:
                break
            stops += 1
        assert result.complete
        assert stops >= 1
        assert hashes(result) == hashes(undisturbed)

    def test_after_ctrl_c(self, undisturbed: rk.RenderResult, tmp_path: Path) -> None:
        path = tmp_path / "state"

        def interrupt(progress: rk.Progress) -> None:
            if progress.spp_done >= 2:
                _thread.interrupt_main(signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            rk.render(bit_scene(), settings(), interrupt, checkpoint=path)
        rest = rk.render(bit_scene(), settings(), checkpoint=path, resume=True)
        assert hashes(rest) == hashes(undisturbed)

    def test_after_an_error_of_the_caller(
        self, undisturbed: rk.RenderResult, tmp_path: Path
    ) -> None:
        path = tmp_path / "state"

        def fail(progress: rk.Progress) -> None:
            raise LookupError("the caller's own")

        with pytest.raises(LookupError, match="the caller's own"):
            rk.render(bit_scene(), settings(), fail, checkpoint=path)
        rest = rk.render(bit_scene(), settings(), checkpoint=path, resume=True)
        assert hashes(rest) == hashes(undisturbed)

    @pytest.mark.parametrize("after", [1, 4, 16])
    def test_after_kill_9(self, undisturbed: rk.RenderResult, tmp_path: Path, after: int) -> None:
        path = tmp_path / "state"
        with subprocess.Popen(command(path, SPP), stdout=subprocess.PIPE, cwd=FOLDER) as process:
            assert process.stdout is not None
            while int(process.stdout.readline() or SPP) < after:
                pass
            os.kill(process.pid, signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        seen: list[int] = []
        rest = rk.render(
            bit_scene(),
            settings(),
            lambda progress: seen.append(progress.samples),
            checkpoint=path,
            resume=True,
        )
        # The passes before the kill were not rendered again.
        assert seen[0] >= (after // 2) * SETTINGS["width"] * SETTINGS["height"]
        assert hashes(rest) == hashes(undisturbed)

    def test_of_what_is_finished(self, undisturbed: rk.RenderResult, tmp_path: Path) -> None:
        path = tmp_path / "state"
        rk.render(bit_scene(), settings(), checkpoint=path, checkpoint_interval_s=0.0)
        again = rk.render(bit_scene(), settings(), checkpoint=path, resume=True)
        assert hashes(again) == hashes(undisturbed)
        assert again.stats.samples == undisturbed.stats.samples

    def test_without_a_checkpoint_starts_anew(
        self, undisturbed: rk.RenderResult, tmp_path: Path
    ) -> None:
        fresh = rk.render(bit_scene(), settings(), checkpoint=tmp_path / "none", resume=True)
        assert hashes(fresh) == hashes(undisturbed)


FOLDER = Path(__file__).parents[1]


def command(checkpoint: Path, spp: int) -> list[str]:
    """The process that renders the scene with a checkpoint at every pass."""
    return [sys.executable, "-m", "render.bit_scene", str(checkpoint), str(spp)]


SMALL: dict[str, Any] = {"width": 24, "height": 16, "spp": 32, "aovs": ()}


@pytest.fixture(scope="module")
def scene() -> rk.Scene:
    return bit_scene()


@pytest.fixture(scope="module")
def good(scene: rk.Scene, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The checkpoint of a small render that was stopped, or that was over before it could be."""
    path = tmp_path_factory.mktemp("good") / "state"
    pixels = SMALL["width"] * SMALL["height"]
    rk.render(
        scene,
        settings(**SMALL),
        lambda progress: progress.samples < 10 * pixels,
        checkpoint=path,
        checkpoint_interval_s=0.0,
    )
    return path.read_bytes()


@pytest.fixture(scope="module")
def image_hash(scene: rk.Scene) -> str:
    return sha256(rk.render(scene, settings(**SMALL)).image)


class TestBadCheckpoints:
    def resume(self, scene: rk.Scene, path: Path, **changes: Any) -> rk.RenderResult:
        resolved = settings(**{**SMALL, **changes})
        return rk.render(scene, resolved, checkpoint=path, resume=True)

    def test_truncated(self, scene: rk.Scene, good: bytes, tmp_path: Path) -> None:
        path = tmp_path / "state"
        for length in [*range(0, len(good), max(1, len(good) // 40)), len(good) - 1]:
            path.write_bytes(good[:length])
            with pytest.raises(rk.RenderError, match="state"):
                self.resume(scene, path)

    def test_flipped_bits(self, scene: rk.Scene, good: bytes, tmp_path: Path) -> None:
        path = tmp_path / "state"
        random = np.random.default_rng(5)
        places = {*range(0, len(good), max(1, len(good) // 100)), *range(0, 200, 3)}
        places |= set(range(len(good) - 100, len(good), 3))
        for place in sorted(places):
            damaged = bytearray(good)
            damaged[place] ^= 1 << int(random.integers(8))
            path.write_bytes(damaged)
            with pytest.raises(rk.RenderError, match="state"):
                self.resume(scene, path)

    def test_whole(self, scene: rk.Scene, good: bytes, image_hash: str, tmp_path: Path) -> None:
        path = tmp_path / "state"
        path.write_bytes(good)
        assert sha256(self.resume(scene, path).image) == image_hash

    @pytest.mark.parametrize(
        "content", [b"", b"\x00" * 100, b"PK\x03\x04", b"not a checkpoint\n", b"\x93NUMPY\x01\x00"]
    )
    def test_not_a_checkpoint(self, scene: rk.Scene, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "state"
        path.write_bytes(content)
        with pytest.raises(rk.RenderError, match="state"):
            self.resume(scene, path)

    def test_a_folder(self, scene: rk.Scene, tmp_path: Path) -> None:
        with pytest.raises(rk.RenderError, match=tmp_path.name):
            self.resume(scene, tmp_path)

    @pytest.mark.parametrize(
        "changes",
        [
            {"seed": 9},
            {"spp": 33},
            {"width": 25},
            {"max_depth": 5},
            {"sampler": "independent"},
            {"filter": "box"},
            {"crop": (0, 0, 24, 15)},
            {"aovs": ("depth",)},
            {"integrator": "ao"},
        ],
        ids=str,
    )
    def test_other_settings(
        self, scene: rk.Scene, good: bytes, tmp_path: Path, changes: dict[str, Any]
    ) -> None:
        path = tmp_path / "state"
        path.write_bytes(good)
        with pytest.raises(rk.RenderError, match=next(iter(changes))):
            self.resume(scene, path, **changes)
        assert path.read_bytes() == good

    def test_another_scene(self, good: bytes, tmp_path: Path) -> None:
        path = tmp_path / "state"
        path.write_bytes(good)
        other = bit_scene()
        other.add_light(rk.PointLight(position=(0, 9, 0), intensity=1e-6))
        with pytest.raises(rk.RenderError, match="scene"):
            self.resume(other, path)

    def test_another_version(
        self, scene: rk.Scene, good: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "state"
        path.write_bytes(good)
        monkeypatch.setattr("raykiln._core.__version__", "0.0.0")
        with pytest.raises(rk.RenderError, match="engine"):
            self.resume(scene, path)

    def test_resume_without_a_file(self, scene: rk.Scene) -> None:
        with pytest.raises(rk.SettingsError, match="resume"):
            rk.render(scene, settings(**SMALL), resume=True)

    def test_unwritable_place(self, scene: rk.Scene, tmp_path: Path) -> None:
        with pytest.raises(rk.RenderError, match="missing"):
            rk.render(
                scene,
                settings(**SMALL),
                checkpoint=tmp_path / "missing" / "state",
                checkpoint_interval_s=0,
            )

    def test_nothing_is_left_beside_it(self, scene: rk.Scene, tmp_path: Path) -> None:
        path = tmp_path / "state"
        rk.render(scene, settings(**SMALL), checkpoint=path, checkpoint_interval_s=0)
        assert list(tmp_path.iterdir()) == [path]
