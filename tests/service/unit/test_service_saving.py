"""Files of a render: compressed where there is time, at once where somebody waits."""

from __future__ import annotations

import struct
import threading
from pathlib import Path

import numpy as np
import pytest
import raykiln as rk
from raykiln.image import read_exr_layers
from raykiln.result import RenderStats
from raykiln_service.executors.saving import Saving

ALL = ["albedo.exr", "depth.exr", "image.exr", "image.png"]


def result_of(side: int = 64) -> rk.RenderResult:
    rng = np.random.default_rng(side)
    image = rng.random((side, side, 3)).astype(np.float32)
    aovs = {"albedo": image * 2, "depth": image[..., 0].copy()}
    settings = rk.RenderSettings(width=side, height=side, aovs=("albedo", "depth"))
    return rk.RenderResult(image, aovs, RenderStats(), settings)


def compression(path: Path) -> int:
    head = b"compression\0compression\0" + struct.pack("<i", 1)
    exr = path.read_bytes()
    return exr[exr.index(head) + len(head)]


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize(("stopped", "wanted"), [(False, 3), (True, 0)])
def test_all_files_are_written(tmp_path: Path, stopped: bool, wanted: int) -> None:
    told: list[list[str]] = []
    saving = Saving(result_of(), tmp_path, ("exr", "png"), lambda: told.append(names_in(tmp_path)))
    saving.run(lambda: stopped)
    assert names_in(tmp_path) == ALL
    assert told == [["image.exr"]]
    for name in ("image.exr", "albedo.exr", "depth.exr"):
        assert compression(tmp_path / name) == wanted, name
    layers = read_exr_layers(tmp_path / "image.exr")
    np.testing.assert_array_equal(layers["beauty"], result_of().image)


def test_from_a_stop_on_nothing_is_compressed_any_more(tmp_path: Path) -> None:
    seen = threading.Event()

    def is_stopped() -> bool:
        if (tmp_path / "image.exr").exists():
            seen.set()
        return seen.is_set()

    def on_image() -> None:
        # What comes after it waits for the stop, which so always comes in time.
        seen.wait(60)

    Saving(result_of(1024), tmp_path, ("exr",), on_image).run(is_stopped)
    assert names_in(tmp_path)[:3] == ALL[:3]
    assert compression(tmp_path / "image.exr") == 3
    assert compression(tmp_path / "depth.exr") == 0


def test_only_what_was_asked_for(tmp_path: Path) -> None:
    Saving(result_of(), tmp_path, ("exr",), lambda: None).run(lambda: False)
    assert "image.png" not in names_in(tmp_path)


@pytest.mark.parametrize("stopped", [False, True])
def test_what_cannot_be_written_is_told(tmp_path: Path, stopped: bool) -> None:
    saving = Saving(result_of(), tmp_path / "missing", ("exr",), lambda: None)
    with pytest.raises(rk.RaykilnError, match="cannot be written"):
        saving.run(lambda: stopped)
