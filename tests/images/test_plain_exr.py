"""OpenEXR without compression: the same image as with, for our reader and for another one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from raykiln.errors import ImageError
from raykiln.image import encode_exr, read_exr_layers, read_exr_metadata, write_exr

METADATA: dict[str, str | int | float] = {"raykiln:seed": 7, "x:y": 1.5, "note": "a\u00e9" * 300}


def layers_of(width: int, height: int) -> dict[str, npt.NDArray[np.float32]]:
    rng = np.random.default_rng(width * 1000 + height)
    made = {"beauty": 3, "albedo": 3, "normal": 3, "depth": 1, "variance": 1}
    layers = {name: rng.normal(0, 1e5, (height, width, n)) for name, n in made.items()}
    return {name: layer.astype(np.float32) for name, layer in layers.items()}


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (33, 17)])
def test_the_same_as_with_compression(tmp_path: Path, size: tuple[int, int], half: bool) -> None:
    layers = layers_of(*size)
    layers["beauty"][0, 0] = (np.inf, -np.inf, np.nan)
    for name, compress in (("zip", True), ("plain", False)):
        write_exr(tmp_path / name, layers, half=half, metadata=METADATA, compress=compress)
    found, wanted = (read_exr_layers(tmp_path / name) for name in ("plain", "zip"))
    assert list(found) == list(wanted)
    for name in wanted:
        np.testing.assert_array_equal(found[name], wanted[name])
    assert read_exr_metadata(tmp_path / "plain") == read_exr_metadata(tmp_path / "zip")


def test_a_crop_keeps_its_place(tmp_path: Path) -> None:
    for name, compress in (("zip", True), ("plain", False)):
        window = (5, 6, 20, 30)
        write_exr(tmp_path / name, layers_of(4, 3), window=window, compress=compress)
    from raykiln import _image

    found, wanted = (_image.read_channels(tmp_path / name) for name in ("plain", "zip"))
    assert found["window"] == wanted["window"]
    np.testing.assert_array_equal(found["pixels"], wanted["pixels"])


def test_another_reader_reads_it(tmp_path: Path) -> None:
    mitsuba = pytest.importorskip("mitsuba", reason="mitsuba is not installed")
    mitsuba.set_variant("scalar_rgb")
    layers = layers_of(33, 17)
    write_exr(tmp_path / "plain.exr", layers, metadata=METADATA, compress=False)
    bitmap = mitsuba.Bitmap(str(tmp_path / "plain.exr"))
    names = [channel.name for channel in bitmap.struct_()]
    pixels = np.array(bitmap)
    for channel, plane in [("R", layers["beauty"][..., 0]), ("N.Y", layers["normal"][..., 1])]:
        np.testing.assert_array_equal(pixels[..., names.index(channel)], plane)


def test_bad_layers_are_refused_alike() -> None:
    uneven = {"beauty": np.ones((2, 2, 3)), "depth": np.ones((2, 3))}
    with pytest.raises(ImageError, match="does not have the shape of the first"):
        encode_exr(uneven, compress=False)
    with pytest.raises(ImageError, match="at least one channel"):
        encode_exr({}, compress=False)
