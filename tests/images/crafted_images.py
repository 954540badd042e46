"""Image files made by hand: odd ones of every accepted kind, and headers that lie."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from raykiln.image import encode_exr

Pixels = npt.NDArray[np.uint8]


def gradient(width: int = 24, height: int = 16, channels: int = 3) -> Pixels:
    """Pixels that differ in every channel, row and column."""
    y, x = np.mgrid[:height, :width]
    planes = [x * 9, y * 13, x * y, 255 - x * 7]
    return (np.stack(planes[:channels], axis=-1) % 256).astype(np.uint8)


def pillow_file(pixels: Pixels, kind: str, mode: str | None = None, **options: Any) -> bytes:
    """`pixels` as a file written by Pillow."""
    image = PillowImage.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)
    buffer = io.BytesIO()
    (image.convert(mode) if mode else image).save(buffer, kind, **options)
    return buffer.getvalue()


def png_chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png(width: int, height: int, *, interlaced: bool = False) -> bytes:
    """A 16 bit RGBA PNG of the claimed size with next to no pixels."""
    header = struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, int(interlaced))
    body = png_chunk(b"IHDR", header) + png_chunk(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + body + png_chunk(b"IEND", b"")


def hdr(width: int, height: int) -> bytes:
    """A Radiance file of the claimed size with next to no pixels."""
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + b"\1" * 64


def small_hdr() -> bytes:
    """A whole run-length coded Radiance file of 16 x 8 pixels, each (0.5, 0.25, 1)."""
    row = b"\2\2\0\x10" + b"".join(bytes([128 + 16, v]) for v in (64, 32, 128, 129))
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n" + row * 8


def bmp(width: int, height: int, bits: int = 24) -> bytes:
    """A bitmap of the claimed size with next to no pixels."""
    head = b"BM" + struct.pack("<IHHI", 100, 0, 0, 54)
    info = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, 0, 0, 0, 0, 0, 0)
    return head + info + bytes(64)


def targa(width: int, height: int) -> bytes:
    """A Targa file of the claimed size with next to no pixels."""
    return struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, width, height, 32, 0) + bytes(64)


def mapped_targa(index: int) -> bytes:
    """One pixel of a colour map with two entries, blue and red."""
    head = struct.pack("<BBBHHBHHHHBB", 0, 1, 1, 0, 2, 24, 0, 0, 1, 1, 8, 0)
    return head + bytes([255, 0, 0, 0, 0, 255]) + bytes([index])


def tiff(width: int, height: int) -> bytes:
    """A grey TIFF whose only strip claims to hold all pixels."""
    strip = min(width * height, 2**32 - 1)
    tags = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 8), (277, 1)]
    tags += [(278, height), (279, strip)]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(64)


def exr(width: int, height: int) -> bytes:
    """An OpenEXR file whose windows were enlarged, with room for its table of line offsets."""
    whole = bytes(encode_exr({"beauty": np.zeros((2, 2, 3), np.float32)}))
    small, large = struct.pack("<4i", 0, 0, 1, 1), struct.pack("<4i", 0, 0, width - 1, height - 1)
    assert whole.count(small) == 2
    return whole.replace(small, large) + bytes(height // 2)


def one_of_each() -> dict[str, bytes]:
    """A valid small file of every accepted kind and of several variants."""
    rgb, rgba, grey = gradient(), gradient(channels=4), gradient(channels=1)
    return {
        "png": pillow_file(rgba, "PNG"),
        "png palette": pillow_file(rgb, "PNG", "P"),
        "png grey": pillow_file(grey, "PNG"),
        "jpeg": pillow_file(rgb, "JPEG"),
        "jpeg progressive": pillow_file(rgb, "JPEG", progressive=True),
        "jpeg cmyk": pillow_file(rgb, "JPEG", "CMYK"),
        "tiff lzw": pillow_file(rgb, "TIFF", compression="tiff_lzw"),
        "tiff deflate": pillow_file(rgba, "TIFF", compression="tiff_adobe_deflate"),
        "tiff palette": pillow_file(rgb, "TIFF", "P"),
        "tiff fax": pillow_file(rgb, "TIFF", "1", compression="group4"),
        "webp": pillow_file(rgb, "WEBP"),
        "webp lossless": pillow_file(rgba, "WEBP", lossless=True),
        "bmp": pillow_file(rgb, "BMP"),
        "bmp palette": pillow_file(rgb, "BMP", "P"),
        "bmp bits": pillow_file(rgb, "BMP", "1"),
        "targa": pillow_file(rgb, "TGA"),
        "targa runs": pillow_file(rgba, "TGA", compression="tga_rle"),
        "targa palette": pillow_file(rgb, "TGA", "P"),
        "hdr": small_hdr(),
        "exr": bytes(encode_exr({"beauty": rgb / 255.0, "depth": grey[..., 0]}, half=True)),
    }
