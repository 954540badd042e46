"""Files that are damaged, lie about their size, or are no images: an error, never a crash."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import crafted_images as crafted
import numpy as np
import pytest
from raykiln.errors import ImageError
from raykiln.image import read_image

GIB = 1 << 30


def read_all(paths: Iterable[Path], memory_limit: int) -> dict[str, str]:
    """How reading each file ended, each in its own process with so much address space."""
    driver = Path(__file__).with_name("hostile_reader.py")
    done = subprocess.run(
        [sys.executable, str(driver), str(memory_limit), *map(str, paths)],
        capture_output=True,
        text=True,
        check=True,
        timeout=240,
    )
    outcomes = [json.loads(line) for line in done.stdout.splitlines()]
    return {Path(path).name: outcome for path, outcome in outcomes}


def test_published_damaged_files(shared_assets: Path) -> None:
    files = sorted((shared_assets / "openexr-images" / "Damaged").iterdir())
    assert len(files) > 40
    outcomes = read_all(files, 4 * GIB)
    assert len(outcomes) == len(files)
    assert {n: o for n, o in outcomes.items() if not o.startswith(("image", "ImageError"))} == {}


LIARS: dict[str, Callable[[int, int], bytes]] = {
    "png": crafted.png,
    "png_interlaced": lambda w, h: crafted.png(w, h, interlaced=True),
    "exr": crafted.exr,
    "hdr": crafted.hdr,
    "bmp": crafted.bmp,
    "tiff": crafted.tiff,
}


def test_claims_cost_nothing(tmp_path: Path) -> None:
    """Neither 100,000 pixels a side nor a legal size without the bytes is ever allocated."""
    for name, make in LIARS.items():
        (tmp_path / f"{name}-over").write_bytes(make(100_000, 100_000))
        (tmp_path / f"{name}-empty").write_bytes(make(16_384, 16_384))
    (tmp_path / "targa-over").write_bytes(crafted.targa(65_535, 65_535))
    (tmp_path / "targa-empty").write_bytes(crafted.targa(16_384, 16_384))
    outcomes = read_all(sorted(tmp_path.iterdir()), 2 * GIB)
    assert len(outcomes) == 2 * len(LIARS) + 2
    for name, outcome in outcomes.items():
        assert outcome.startswith("ImageError"), (name, outcome)
        assert "not enough memory" not in outcome, (name, outcome)
        # TIFF's reader has the same limit and comes first.
        if name.endswith("-over") and not name.startswith("tiff"):
            assert "over the limit" in outcome, (name, outcome)


def mutations(whole: bytes, rng: np.random.Generator, count: int) -> Iterable[bytes]:
    """Damaged copies: a few bytes changed, most of them in the header, or the end cut off."""
    for _ in range(count):
        damaged = bytearray(whole)
        for _ in range(rng.integers(1, 6)):
            reach = min(len(damaged), 200) if rng.random() < 0.7 else len(damaged)
            damaged[rng.integers(reach)] = rng.choice([0, 1, 127, 128, 255, int(rng.integers(256))])
        cut = rng.integers(1, len(damaged)) if rng.random() < 0.15 else len(damaged)
        yield bytes(damaged[:cut])


@pytest.mark.parametrize(
    "copies", [pytest.param(6, id="few"), pytest.param(15, id="many", marks=pytest.mark.slow)]
)
def test_mutated_files(tmp_path: Path, copies: int) -> None:
    rng = np.random.default_rng(20)
    for kind, whole in crafted.one_of_each().items():
        for i, damaged in enumerate(mutations(whole, rng, copies)):
            (tmp_path / f"{kind}-{i}").write_bytes(damaged)
    outcomes = read_all(sorted(tmp_path.iterdir()), 4 * GIB)
    assert len(outcomes) == copies * len(crafted.one_of_each())
    assert {n: o for n, o in outcomes.items() if not o.startswith(("image", "ImageError"))} == {}
    ends = list(outcomes.values())
    assert any(o.startswith("image") for o in ends)
    assert any(o.startswith("ImageError") for o in ends)


@pytest.mark.parametrize("kind", sorted(crafted.one_of_each()))
def test_every_length_of_a_cut_file(kind: str) -> None:
    whole = crafted.one_of_each()[kind]
    for length in range(min(len(whole) // 2, 120)):
        with pytest.raises(ImageError):
            read_image(whole[:length])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.png", b"", "the file is empty; accepted: OpenEXR, PNG"),
        ("notes.png", b"This is no image, whatever its name says.", "not an image of an accepted"),
        ("video.gif", b"GIF89a" + bytes(40), "not an image of an accepted kind"),
        ("cut.png", crafted.one_of_each()["png"][:60], "damaged or unsupported PNG image: "),
        ("runs.bmp", crafted.bmp(4, 4, 8)[:30] + b"\1" + bytes(80), "compression is not accepted"),
    ],
)
def test_the_message_names_file_and_reason(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ImageError, match=message) as caught:
        read_image(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert text.count(name) == 1
    assert "\n" not in text


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    cases: list[tuple[str | Path, str]] = [
        (tmp_path / "missing.png", "no such file"),
        (tmp_path, "not a regular file"),
        (tmp_path / "pipe.png", "not a regular file"),
        ("a\0b.png", "null"),
    ]
    for path, message in cases:
        with pytest.raises(ImageError, match=message):
            read_image(path)
