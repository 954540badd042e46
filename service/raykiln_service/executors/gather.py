"""The process that puts a job's frames together: contact sheet, animated WebP, MP4."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from raykiln.image import encode_png, read_exr_layers, to_png_pixels, write_atomically

from raykiln_service.executors.childside import Channel, be_modest
from raykiln_service.executors.contact_sheet import (
    Picture,
    contact_sheet,
    fitted,
    shrunk,
    thumb_size,
)

# Longer side of the animations: they are for looking at, the frames are for work.
_WEBP_PIXELS, _MP4_PIXELS = 960, 1920

Pictures = Callable[[int, int], Iterator[tuple[int, Picture]]]
"""Number and picture of each frame at a width and height."""


def gather(message: dict[str, Any], tell: Callable[[float], None]) -> None:
    """Write what `message` asks for.

    Parameters
    ----------
    message
        ``frames`` (lists of number and EXR path), ``outputs``, ``work_dir``, ``fps``.
    tell
        Told the share of the work that is done.
    """
    frames = [(int(number), Path(path)) for number, path in message["frames"]]
    folder = Path(message["work_dir"])
    wanted = [name for name in _WRITERS if name in message["outputs"]]
    total = len(wanted) * len(frames)
    done = 0

    def pictures(width: int, height: int) -> Iterator[tuple[int, Picture]]:
        nonlocal done
        for number, path in frames:
            yield number, _picture(path, width, height)
            done += 1
            tell(done / total)

    height, width = _beauty(frames[0][1]).shape[:2]
    for name in wanted:
        _WRITERS[name](folder, pictures, (width, height), len(frames), float(message["fps"]))


def _beauty(path: Path) -> Any:
    return read_exr_layers(path)["beauty"]


def _picture(path: Path, width: int, height: int) -> Picture:
    picture: Picture = to_png_pixels(shrunk(_beauty(path), width, height))
    return picture


def _write_sheet(
    folder: Path, pictures: Pictures, size: tuple[int, int], count: int, fps: float
) -> None:
    thumb = thumb_size(count, *size)
    sheet = contact_sheet(pictures(*thumb), count, thumb)
    write_atomically(folder / "contact_sheet.png", encode_png(sheet))


def _write_webp(
    folder: Path, pictures: Pictures, size: tuple[int, int], count: int, fps: float
) -> None:
    from PIL import Image

    frames = (Image.fromarray(picture) for _, picture in pictures(*fitted(*size, _WEBP_PIXELS)))
    first = next(frames)
    # Whole milliseconds that do not drift: frame i ends at the rounded (i + 1) / fps.
    ends = [round((i + 1) * 1000 / fps) for i in range(count)]
    durations = [max(1, end - start) for start, end in zip([0, *ends], ends, strict=False)]
    first.save(
        folder / "animation.webp",
        save_all=True,
        append_images=frames,
        duration=durations if count > 1 else durations[0],
        loop=0,
        quality=85,
        method=4,
    )


def _write_mp4(
    folder: Path, pictures: Pictures, size: tuple[int, int], count: int, fps: float
) -> None:
    from fractions import Fraction

    import av

    width, height = fitted(*size, _MP4_PIXELS)
    # The coding of colour at half resolution wants even sides.
    pad = ((0, height % 2), (0, width % 2), (0, 0))
    options = {"movflags": "+faststart"}
    with av.open(str(folder / "animation.mp4"), "w", options=options) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "18", "preset": "medium", "threads": "1"}
        for _, picture in pictures(width, height):
            frame = av.VideoFrame.from_ndarray(np.pad(picture, pad, mode="edge"), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


_LIBRARIES = {"webp": "PIL.WebPImagePlugin", "mp4": "av"}
_WRITERS = {"contact_sheet": _write_sheet, "webp": _write_webp, "mp4": _write_mp4}


def main() -> None:
    """Answer one request; what it reads was written by processes that had a stranger's scene."""
    channel = Channel(listen=False)
    be_modest(5)
    os.umask(0o027)
    message = channel.first()
    for name in message["outputs"]:
        if name in _LIBRARIES:
            import_module(_LIBRARIES[name])
    channel.confine(message)
    channel.listen()
    try:
        gather(message, lambda share: channel.send(type="progress", share=share))
    except Exception as error:
        traceback.print_exc()
        channel.send(type="broken", detail=f"{type(error).__name__}: {error}")
        return
    channel.send(type="done")


if __name__ == "__main__":
    main()
