"""Many pictures of one scene from the command line: the options of `render` and `submit`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import CommandError, usage_error
from raykiln_service.planner import frame_name

if TYPE_CHECKING:
    from raykiln import PreparedScene, RenderSettings, Scene

_PANEL = "Many pictures of the scene"
_FPS = 24.0
_MARK = re.compile("#+")


def _option(*names: str, help: str, metavar: str | None = None) -> Any:
    return typer.Option(*names, help=help, metavar=metavar, rich_help_panel=_PANEL)


@dataclass(frozen=True)
class FrameOptions:
    """Which pictures are asked for on a command line; nothing given = one image."""

    turntable: Annotated[
        int | None, _option("--turntable", help="Go round the scene in N frames.", metavar="N")
    ] = None
    axis: Annotated[
        str | None, _option("--axis", help="Axis of the turntable [default: y]", metavar="x|y|z")
    ] = None
    degrees: Annotated[
        float | None, _option("--degrees", help="The whole turn [default: 360]", metavar="D")
    ] = None
    start_degrees: Annotated[
        float | None, _option("--start-degrees", help="Where the turn begins.", metavar="D")
    ] = None
    elevation: Annotated[
        float | None,
        _option("--elevation", help="Angle of the camera above the target.", metavar="D"),
    ] = None
    target: Annotated[
        str | None, _option("--target", help="Point to turn about.", metavar="X,Y,Z")
    ] = None
    all_cameras: Annotated[
        bool, _option("--all-cameras", help="One frame for each camera of the scene.")
    ] = False
    times: Annotated[
        str | None,
        _option(
            "--times",
            help="Frames of the scene's animation in seconds; what is left out is as it has it.",
            metavar="[START]:[END][:FPS]",
        ),
    ] = None
    vary_seed: Annotated[
        bool, _option("--vary-seed", help="Another seed for each frame: seed + 0, 1, 2, ...")
    ] = False

    def request(self) -> dict[str, Any] | None:
        """The `frames` of a job; None for one image.  A `CommandError` names a bad option."""
        turn = self._turn()
        chosen = [turn is not None, self.all_cameras, self.times is not None]
        if sum(chosen) > 1:
            raise usage_error(
                "--turntable, --all-cameras, --times", "these exclude each other", accepted="one"
            )
        if not any(chosen):
            if self.vary_seed:
                raise usage_error("--vary-seed", "there are no frames to vary it over")
            return None
        frames: dict[str, Any] = {"vary_seed": True} if self.vary_seed else {}
        if turn is not None:
            return {**frames, "turntable": turn}
        if self.times is not None:
            return {**frames, "time": parse_times(self.times)}
        return {**frames, "cameras": "all"}

    def _turn(self) -> dict[str, Any] | None:
        given = {
            "axis": self.axis,
            "degrees": self.degrees,
            "start_degrees": self.start_degrees,
            "elevation_degrees": self.elevation,
            "target": None if self.target is None else parse_point(self.target),
        }
        turn = {name: value for name, value in given.items() if value is not None}
        if self.turntable is None:
            if turn:
                raise usage_error(_OPTION_OF[next(iter(turn))], "goes with --turntable only")
            return None
        return {"count": self.turntable, **turn}


_OPTION_OF = {
    "count": "--turntable",
    "axis": "--axis",
    "degrees": "--degrees",
    "start_degrees": "--start-degrees",
    "elevation_degrees": "--elevation",
    "target": "--target",
    "camera": "--camera",
    "fps": "--times",
    "end": "--times",
}


def parse_point(text: str) -> list[float]:
    """A point such as ``0,1.5,0``."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise usage_error("--target", "not a point", found=text, accepted="X,Y,Z") from None
    return [x, y, z]


def parse_times(text: str) -> dict[str, float]:
    """A range of time such as ``0:2:24``, ``:2`` or ``1:``."""
    parts = text.split(":")
    try:
        if not 2 <= len(parts) <= 3:
            raise ValueError
        values = [None if not part else float(part) for part in parts]
    except ValueError:
        accepted = "[START]:[END][:FPS]"
        raise usage_error("--times", "not times", found=text, accepted=accepted) from None
    named = zip(("start", "end", "fps"), values, strict=False)
    return {name: value for name, value in named if value is not None}


@dataclass(frozen=True)
class Picture:
    """One of the pictures to render here."""

    name: str | None
    """Number of the frame with four digits; None = the one image."""
    scene: Scene | PreparedScene
    settings: RenderSettings


def pictures(
    request: dict[str, Any], scene: Scene, settings: RenderSettings, at: Any
) -> tuple[int, Iterator[Picture]]:
    """How many frames a scene has, and each of them once its turn comes.

    Parameters
    ----------
    at
        Gives the scene at a moment of its animation.
    """
    import raykiln as rk

    try:
        if "turntable" in request:
            turn = dict(request["turntable"])
            base = settings.over(scene.settings).camera
            cameras = rk.turntable(scene, turn.pop("count"), camera=base, **turn)
            return len(cameras), _of_cameras(scene, cameras, request, settings)
        if "time" in request:
            return _of_times(request, scene, settings, at)
    except rk.SettingsError as error:
        name, _, text = str(error).partition(": ")
        raise CommandError(f"{_OPTION_OF.get(name, name)}: {text}") from None
    if settings.camera is not None:
        raise usage_error("--camera", "goes with one image, or with --turntable or --times")
    return len(scene.cameras), _of_cameras(scene, list(scene.cameras), request, settings)


def _of_cameras(
    scene: Scene, cameras: list[Any], request: dict[str, Any], settings: RenderSettings
) -> Iterator[Picture]:
    import raykiln as rk

    prepared = rk.prepare(scene)
    for i, camera in enumerate(cameras):
        own = _own(request, scene, settings, i, camera=camera.name)
        yield Picture(frame_name(i + 1), prepared.with_camera(camera), own)


def _of_times(
    request: dict[str, Any], scene: Scene, settings: RenderSettings, at: Any
) -> tuple[int, Iterator[Picture]]:
    from raykiln.frames import frame_times

    wanted = request["time"]
    if scene.time_range_s is None:
        raise usage_error("--times", "the scene has no animation", accepted="a glTF scene with one")
    start, end = scene.time_range_s
    times = frame_times(wanted.get("start", start), wanted.get("end", end), wanted.get("fps", _FPS))
    frames = (
        Picture(frame_name(i + 1), at(time_s), _own(request, scene, settings, i))
        for i, time_s in enumerate(times)
    )
    return len(times), frames


def _own(
    request: dict[str, Any], scene: Scene, settings: RenderSettings, i: int, **changes: Any
) -> RenderSettings:
    if request.get("vary_seed"):
        changes["seed"] = (settings.over(scene.settings).seed + i) % (1 << 32)
    return settings.model_copy(update=changes)


def numbered(path: Path, name: str | None) -> Path:
    """A file of a frame: ``out_####.png`` and ``out.png`` give out_0001.png and out.0001.png."""
    if name is None:
        return path
    marks = list(_MARK.finditer(path.name))
    if not marks:
        return path.with_name(f"{path.stem}.{name}{path.suffix}")
    last = marks[-1]
    number = str(int(name)).zfill(len(last[0]))
    return path.with_name(path.name[: last.start()] + number + path.name[last.end() :])
