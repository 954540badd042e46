"""Images that threads read before they are asked for."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from crafted_images import one_of_each
from raykiln.errors import ImageError
from raykiln.image import encode_png, read_image
from raykiln.image.ahead import MAX_THREADS, reading_ahead
from raykiln.image.codec import Source


def picture(shade: int) -> bytes:
    return bytes(encode_png(np.full((8, 9, 3), shade, np.uint8)))


def test_pixels_are_those_of_reading_one_by_one(tmp_path: Path) -> None:
    files = {}
    for name, data in one_of_each().items():
        files[name] = tmp_path / name
        files[name].write_bytes(data)
    with reading_ahead(files) as read:
        for name, file in files.items():
            expected = read_image(file)
            assert read(name).dtype == expected.dtype
            np.testing.assert_array_equal(read(name), expected)


@pytest.mark.parametrize("count", [1, 2, 40])
def test_each_image_is_read_once(count: int) -> None:
    with reading_ahead({i: picture(i) for i in range(count)}) as read:
        for i in reversed(range(count)):
            assert read(i) is read(i)
            assert (read(i) == i).all()


@pytest.mark.parametrize("others", [0, 5])
def test_errors_wait_until_the_image_is_asked_for(others: int, tmp_path: Path) -> None:
    sources: dict[str, Source] = {"bad": b"no image", "gone": tmp_path / "gone.png"}
    with reading_ahead({**sources, **{f"{i}": picture(i) for i in range(others)}}) as read:
        for i in range(others):
            assert (read(f"{i}") == i).all()
        with pytest.raises(ImageError, match="not an image of an accepted kind"):
            read("bad")
        with pytest.raises(ImageError, match=r"gone\.png: "):
            read("gone")


class Noted(os.PathLike[str]):
    """A path that notes when it is opened."""

    def __init__(self, path: Path, opened: list[Path]) -> None:
        self.path, self.opened = path, opened

    def __fspath__(self) -> str:
        self.opened.append(self.path)
        return str(self.path)


def test_what_is_not_begun_on_leaving_is_not_read(tmp_path: Path) -> None:
    before = threading.active_count()
    file = tmp_path / "large.png"
    file.write_bytes(encode_png(np.zeros((1024, 1024, 3), np.uint8)))
    opened: list[Path] = []
    count = 20 * MAX_THREADS
    with reading_ahead({i: Noted(file, opened) for i in range(count)}):
        pass
    assert len(opened) < count
    assert threading.active_count() == before
