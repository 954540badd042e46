"""From the frames that a request asks for to the frames of a job, one by one."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from typing import Any

from raykiln.errors import SettingsError
from raykiln.frames import frame_times, orbit
from raykiln.scene import PerspectiveCamera
from raykiln.settings import RenderSettings

from raykiln_service.errors import InvalidRequestError
from raykiln_service.planner import GATHERED, Frame
from raykiln_service.schemas_frames import FrameChoice, TimeRange, Turntable

_SEEDS = 1 << 32
_LIBRARIES = {"webp": ("PIL", "Pillow"), "mp4": ("av", "PyAV")}


def plan_frames(
    choice: FrameChoice,
    given: RenderSettings,
    settings: RenderSettings,
    report: Mapping[str, Any],
    max_frames: int,
) -> tuple[Frame, ...]:
    """The frames of a job.

    Parameters
    ----------
    given, settings
        The render settings of the request, and as they will be, the scene's own included.
    report
        What the scene check found: cameras, views, targets, time_range_s.

    Raises
    ------
    InvalidRequestError
        The scene cannot give these frames; names the place in the request.
    """
    if choice.cameras is not None:
        _check_no_camera(given)
        frames = _of_cameras(choice.cameras, report["cameras"])
    elif choice.turntable is not None:
        _check_count(choice.turntable.count, max_frames, "/frames/turntable/count")
        frames = _of_turntable(choice.turntable, settings.camera, report)
    else:
        assert choice.time is not None
        frames = _of_time(choice.time, report["time_range_s"], max_frames)
    _check_count(len(frames), max_frames, "/frames")
    if choice.vary_seed:
        frames = [_with_seed(frame, settings.seed) for frame in frames]
    return tuple(frames)


def checked_outputs(outputs: Sequence[str] | None, frames: FrameChoice | None) -> tuple[str, ...]:
    """The outputs of a job, each once; raises for what cannot be made.

    Frames come with a contact sheet unless the outputs are given.
    """
    if outputs is None:
        return ("exr", "png") if frames is None else ("exr", "png", "contact_sheet")
    for i, name in enumerate(outputs):
        where = f"/outputs/{i}"
        if name in GATHERED and frames is None:
            raise InvalidRequestError(
                f"{name} is made of frames, and the job asks for one image",
                pointer=where,
                found=name,
                accepted="exr, png; or 'frames' with it",
            )
        module, library = _LIBRARIES.get(name, (None, None))
        if module is not None and importlib.util.find_spec(module) is None:
            raise InvalidRequestError(
                f"{name} needs {library}, which this service does not have "
                "(the extra `video` brings it)",
                pointer=where,
                found=name,
            )
    return tuple(dict.fromkeys(outputs))


def _check_no_camera(given: RenderSettings) -> None:
    if given.camera is not None:
        raise InvalidRequestError(
            "the frames name the cameras, so the settings must not",
            pointer="/settings/camera",
            found=given.camera,
            accepted="no camera here, or no 'cameras' in the frames",
        )


def _of_cameras(wanted: list[str] | str, known: Sequence[str]) -> list[Frame]:
    names = list(known) if isinstance(wanted, str) else wanted
    for i, name in enumerate(names):
        if name not in known:
            raise InvalidRequestError(
                f"the scene has no camera {name!r}",
                pointer=f"/frames/cameras/{i}",
                found=name,
                accepted=", ".join(known[:20]),
            )
    return [Frame(i + 1, {"camera": name}) for i, name in enumerate(names)]


def _of_turntable(turn: Turntable, base: str | None, report: Mapping[str, Any]) -> list[Frame]:
    names = report["cameras"]
    index = names.index(base) if base else 0
    view = PerspectiveCamera.model_validate(report["views"][index])
    x, y, z = turn.target or report["targets"][index]
    options = turn.model_dump(exclude={"count", "target"})
    try:
        cameras = orbit(view, turn.count, target=(x, y, z), **options)
    except SettingsError as error:
        name, _, text = str(error).partition(": ")
        raise InvalidRequestError(text or name, pointer=f"/frames/turntable/{name}") from None
    return [
        Frame(
            i + 1,
            {"camera": camera.name},
            camera=camera.model_dump(mode="json", exclude_none=True),
        )
        for i, camera in enumerate(cameras)
    ]


def _of_time(wanted: TimeRange, known: tuple[float, float] | None, max_frames: int) -> list[Frame]:
    if known is None:
        raise InvalidRequestError(
            "the scene has no animation, so it has no frames in time",
            pointer="/frames/time",
            accepted="a glTF scene with an animation, or 'turntable' or 'cameras'",
        )
    start = known[0] if wanted.start is None else wanted.start
    end = known[1] if wanted.end is None else wanted.end
    if end < start:
        raise InvalidRequestError(
            "the end lies before the start",
            pointer="/frames/time/end",
            found=f"{end:g}",
            accepted=f"from {start:g} on",
        )
    _check_count(int(min((end - start) * wanted.fps, 1e9)) + 1, max_frames, "/frames/time")
    times = frame_times(start, end, wanted.fps)
    return [Frame(i + 1, time_s=time_s) for i, time_s in enumerate(times)]


def _with_seed(frame: Frame, seed: int) -> Frame:
    own = {**frame.settings, "seed": (seed + frame.number - 1) % _SEEDS}
    return Frame(frame.number, own, frame.camera, frame.time_s)


def _check_count(count: int, limit: int, pointer: str) -> None:
    if count > limit:
        raise InvalidRequestError(
            "too many frames for one job",
            pointer=pointer,
            found=str(count),
            accepted=f"at most {limit}",
        )
