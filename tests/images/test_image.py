"""Reading and writing image files."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from crafted_images import gradient, mapped_targa, one_of_each, pillow_file, small_hdr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image as PillowImage
from raykiln.errors import ImageError
from raykiln.image import (
    encode_exr,
    encode_png,
    read_exr_layers,
    read_exr_metadata,
    read_image,
    write_exr,
    write_png,
)

SIDES = st.integers(1, 40)
ANY_FLOAT = hnp.from_dtype(np.dtype(np.float32))


def bits_of(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return array.view(np.uint32)


@given(st.data())
def test_exr_keeps_every_bit_of_every_layer(data: st.DataObject) -> None:
    height, width = data.draw(SIDES), data.draw(SIDES)
    shapes = {
        "beauty": (height, width, 3),
        "normal": (height, width, 3),
        "depth": (height, width),
        "variance": (height, width),
        "uv": (height, width, 2),
        "crypto_object00": (height, width, 4),
    }
    names = data.draw(st.lists(st.sampled_from(sorted(shapes)), min_size=1, unique=True))
    layers = {
        name: data.draw(hnp.arrays(np.float32, shapes[name], elements=ANY_FLOAT, fill=ANY_FLOAT))
        for name in names
    }
    back = read_exr_layers(encode_exr(layers))
    assert sorted(back) == sorted(names)
    for name in names:
        np.testing.assert_array_equal(bits_of(back[name]), bits_of(layers[name]))


@given(hnp.arrays(np.float32, (5, 7, 3), elements=st.floats(-1e6, 1e6, width=32)))
def test_exr_half_rounds_as_ieee_and_never_overflows(pixels: npt.NDArray[np.float32]) -> None:
    stored = read_image(encode_exr({"beauty": pixels}, half=True))
    expected = np.clip(pixels, -65504, 65504).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(stored, expected)


def test_exr_half_keeps_depth_whole() -> None:
    depth = np.array([[1e7, 1.0 + 2.0**-20]], dtype=np.float32)
    layers = read_exr_layers(encode_exr({"beauty": np.ones((1, 2, 3)), "depth": depth}, half=True))
    np.testing.assert_array_equal(layers["depth"], depth)


def test_exr_names_channels_as_the_contract_says() -> None:
    plane = np.zeros((2, 2, 3), np.float32)
    layers = {"beauty": plane, "albedo": plane, "normal": plane, "depth": plane[..., 0]}
    data = bytes(encode_exr({**layers, "variance": plane[..., 0]}))
    for name in ("R", "G", "B", "albedo.R", "N.X", "N.Y", "N.Z", "depth.Z", "variance"):
        assert b"\0" + name.encode() + b"\0" in data[:800].replace(b"chlist", b"\0"), name


def test_exr_reads_strided_and_integer_input() -> None:
    pixels = np.arange(2 * 3 * 4, dtype=np.float32).reshape(2, 3, 4)
    for view in (pixels[::-1, ::-1, :3], pixels.transpose(1, 0, 2)[..., 1:], pixels.astype(int)):
        np.testing.assert_array_equal(read_image(encode_exr({"beauty": view})), view)


def test_exr_names_that_are_no_text() -> None:
    pixels = np.ones((1, 1, 3), np.float32)
    whole = bytes(encode_exr({"beauty": pixels}, metadata={"note": "abcd"}))
    broken = whole.replace(b"\0G\0", b"\0\xd7\0", 1).replace(b"abcd", b"a\xffcd", 1)
    assert sorted(read_exr_layers(broken)) == ["\\xd7", "beauty"]
    assert read_exr_metadata(broken) == {"note": "a\\xffcd"}


def test_png_text_of_any_language() -> None:
    data = bytes(encode_png(gradient(), metadata={"note": "Straße 道"}))
    opened = PillowImage.open(io.BytesIO(data))
    assert opened.info["note"] == "Straße 道"
    assert read_exr_metadata(data) == {"note": "Straße 道"}


OWN_KINDS = """
import sys
from raykiln.image import encode_exr, encode_png, read_image
import numpy as np
pixels = np.ones((4, 4, 3), np.float32)
for data in (encode_exr({"beauty": pixels}), encode_png(pixels)):
    read_image(bytes(data))
maps = open("/proc/self/maps").read()
assert "libOpenEXR" in maps
print("OpenImageIO" in maps, "raykiln._oiio" in sys.modules)
read_image(sys.stdin.buffer.read())
print("raykiln._oiio" in sys.modules)
"""


def test_openimageio_is_loaded_for_its_files_only() -> None:
    done = subprocess.run(
        [sys.executable, "-c", OWN_KINDS],
        input=one_of_each()["jpeg"],
        capture_output=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.split() == [b"False", b"False", b"True"]


def test_exr_metadata_and_window_come_back(tmp_path: Path) -> None:
    path = tmp_path / "crop.exr"
    metadata: dict[str, str | int | float] = {
        "raykiln:seed": 7,
        "raykiln:big": 2**40,
        "raykiln:s": 0.1,
        "raykiln:scene": "ä",
    }
    write_exr(path, {"beauty": np.ones((3, 4, 3))}, metadata=metadata, window=(5, 6, 20, 30))
    assert read_exr_metadata(path) == {**metadata, "raykiln:big": str(2**40)}
    assert read_image(path).shape == (3, 4, 3)


@given(
    st.sampled_from([np.uint8, np.uint16]).flatmap(
        lambda t: hnp.arrays(t, st.tuples(SIDES, SIDES, st.integers(1, 4)))
    )
)
def test_png_keeps_every_value(pixels: npt.NDArray[Any]) -> None:
    back = read_image(encode_png(pixels, bits=8 * pixels.itemsize))
    assert back.dtype == pixels.dtype
    np.testing.assert_array_equal(back, pixels)


def test_png_says_what_it_is() -> None:
    data = bytes(encode_png(gradient(), metadata={"view": "agx", "exposure": 1.5}))
    assert b"sRGB" in data[:200]
    opened = PillowImage.open(io.BytesIO(data))
    assert isinstance(opened.info["view"], str)
    assert (opened.info["view"], opened.info["exposure"]) == ("agx", "1.5")
    np.testing.assert_array_equal(np.asarray(opened), gradient())


def test_png_rounds_floats() -> None:
    row = np.array([[-1.0, 0.0, 0.5, 1.0, 2.0, np.nan, np.inf]])
    eight = read_image(encode_png(row))[0, :, 0]
    assert eight.tolist() == [0, 0, 128, 255, 255, 0, 255]
    assert read_image(encode_png(row, bits=16))[0, 2, 0] == 32768


def test_same_input_gives_same_bytes_without_a_date() -> None:
    rng = np.random.default_rng(3)
    layers = {"beauty": rng.random((70, 50, 3)), "depth": rng.random((70, 50))}
    first = bytes(encode_exr(layers, metadata={"raykiln:seed": 1}))
    assert first == bytes(encode_exr(layers, metadata={"raykiln:seed": 1}))
    png = bytes(encode_png(layers["beauty"], metadata={"view": "srgb"}))
    assert png == bytes(encode_png(layers["beauty"], metadata={"view": "srgb"}))
    for stamp in (b"capDate", b"DateTime", b"tIME", b"Software", b"HostComputer"):
        assert stamp not in first
        assert stamp not in png


LOSSLESS = [
    "png", "png palette", "png grey", "tiff lzw", "tiff deflate",
    "bmp", "bmp palette", "bmp bits", "targa", "targa runs", "targa palette",
]  # fmt: skip


@pytest.mark.parametrize("kind", LOSSLESS)
def test_agrees_with_pillow(kind: str) -> None:
    data = one_of_each()[kind]
    opened = PillowImage.open(io.BytesIO(data))
    wide = opened.convert("RGB") if opened.mode in ("P", "1") else opened
    expected = np.asarray(wide)
    np.testing.assert_array_equal(read_image(data).squeeze(), expected)


@pytest.mark.parametrize(
    "kind", ["jpeg", "jpeg progressive", "jpeg cmyk", "webp", "tiff palette", "tiff fax"]
)
def test_agrees_with_pillow_within_rounding(kind: str) -> None:
    data = one_of_each()[kind]
    expected = np.asarray(PillowImage.open(io.BytesIO(data)).convert("RGB"), dtype=int)
    assert np.abs(read_image(data).astype(int) - expected).max() <= 3


def test_radiance_hdr() -> None:
    pixels = read_image(small_hdr())
    assert pixels.dtype == np.float32
    np.testing.assert_allclose(pixels, np.broadcast_to([0.5, 0.25, 1.0], (8, 16, 3)), rtol=0.01)


def test_webp_alpha_is_straight() -> None:
    pixels = gradient(channels=4)
    pixels[..., 3] |= 64
    back = read_image(pillow_file(pixels, "WEBP", lossless=True)).astype(int)
    # Some versions of the reader multiply by alpha; dividing again costs 255 / 64 / 2 at most.
    assert np.abs(back - pixels).max() <= 4
    np.testing.assert_array_equal(back[..., 3], pixels[..., 3])


def test_straight_alpha_is_left_alone() -> None:
    pixels = np.array([[[200, 100, 50, 0], [10, 20, 30, 128]]], dtype=np.uint8)
    for kind in ("PNG", "TGA", "TIFF"):
        np.testing.assert_array_equal(read_image(pillow_file(pixels, kind)), pixels)


@pytest.mark.parametrize(("descriptor", "flip"), [(0x20, 1), (0x30, -1)])
def test_targa_origin(descriptor: int, flip: int) -> None:
    data = bytearray(pillow_file(gradient(), "TGA"))
    upright = read_image(bytes(data))
    turned = data[17] & 0x20
    data[17] = data[17] & ~0x30 | descriptor
    expected = upright if turned else upright[::-1]
    np.testing.assert_array_equal(read_image(bytes(data)), expected[:, ::flip])


def test_targa_colour_map() -> None:
    assert read_image(mapped_targa(1)).tolist() == [[[255, 0, 0]]]
    with pytest.raises(ImageError, match="colour 2 is not in its colour map"):
        read_image(mapped_targa(2))


def test_content_decides_not_the_name(tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(pillow_file(gradient(), "PNG"))
    np.testing.assert_array_equal(read_image(path), gradient())
    np.testing.assert_array_equal(read_image(str(path)), gradient())


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9 #1.png")
    write_png(path, gradient())
    np.testing.assert_array_equal(read_image(path), gradient())


def test_what_is_no_file_keeps_its_name(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.png"
    os.mkfifo(pipe)
    with pytest.raises(ImageError, match="not a regular file"):
        write_png(pipe, gradient())
    assert pipe.is_fifo()


def test_colour_is_chosen_by_name() -> None:
    depth, colour = np.ones((2, 2), np.float32), np.full((2, 2, 3), 0.5, np.float32)
    assert read_image(encode_exr({"depth": depth, "beauty": colour})).shape == (2, 2, 3)
    only_layers = encode_exr({"depth": depth, "normal": colour, "albedo": colour * 0.5})
    np.testing.assert_array_equal(read_image(only_layers), colour * 0.5)
    with pytest.raises(ImageError, match="none of its 6 channels is named R, G, B or Y"):
        read_image(encode_exr({"normal": colour, "position": colour}))


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "image.exr"
    write_exr(path, {"beauty": np.zeros((4, 4, 3))})
    before = path.read_bytes()

    def full_disk(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(ImageError, match=r"image\.exr: .*No space left on device"):
        write_exr(path, {"beauty": np.ones((4, 4, 3))})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ({}, "at least one channel"),
        ({"beauty": np.zeros((2, 2, 5))}, r"'beauty' needs the shape"),
        ({"beauty": np.zeros((0, 2, 3))}, r"'beauty' needs the shape"),
        ({"beauty": np.zeros((2, 2, 3)), "depth": np.zeros((3, 2))}, "shape of the first"),
        ({"a/b": np.zeros((2, 2))}, "cannot name a layer"),
        ({"R": np.zeros((2, 2))}, "cannot name a layer"),
    ],
)
def test_bad_layers_are_named(layers: dict[str, Any], message: str) -> None:
    with pytest.raises(ImageError, match=message):
        encode_exr(layers)


def test_bad_arguments_are_named(tmp_path: Path) -> None:
    for metadata in ({"compression": "none"}, {"DateTime": "now"}, {"": 1}):
        with pytest.raises(ImageError, match="cannot name metadata"):
            encode_exr({"beauty": np.zeros((1, 1, 3))}, metadata=metadata)
    with pytest.raises(ImageError, match="8 or 16 bits"):
        encode_png(gradient(), bits=12)
    with pytest.raises(ImageError, match="not uint16"):
        encode_png(gradient().astype(np.uint16))
    with pytest.raises(ImageError, match="no/such/folder"):
        write_png(tmp_path / "no/such/folder/x.png", gradient())
