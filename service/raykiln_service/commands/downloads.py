"""Getting the outputs of a job: `raykiln download`, and `raykiln submit -o`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raykiln_service.commands.console import (
    CommandError,
    check_writable,
    print_json,
    usage_error,
)
from raykiln_service.commands.frames import numbered
from raykiln_service.commands.render import ExposureOption, ViewOption, check_view
from raykiln_service.commands.watch import JobArgument, JsonOption, ServerOption

if TYPE_CHECKING:
    from raykiln_service.client import Client, Frame, Job

FrameOption = Annotated[
    list[int] | None,
    typer.Option("--frame", help="Only this frame; may repeat.", metavar="NUMBER"),
]
_OUTPUT_OF = {".exr": "image.exr", ".png": "image.png", ".json": "stats.json"}


@dataclass(frozen=True)
class Target:
    """Where to download to: one output to a file, or several to a folder."""

    path: Path
    name: str | None
    """The output; None = those of the job, to the folder `path`."""


def download_targets(paths: list[Path], names: list[str] | None = None) -> list[Target]:
    """What goes where; raises now for what could not be written later."""
    for name in names or []:
        if Path(name).name != name:
            raise usage_error("NAME", "not the name of an output", found=name)
    targets: list[Target] = []
    for path in paths:
        if path.is_dir():
            targets += [Target(path / n, n) for n in names] if names else [Target(path, None)]
        elif names and len(names) == 1:
            targets.append(Target(path, names[0]))
        elif path.suffix.lower() in _OUTPUT_OF:
            targets.append(Target(path, _OUTPUT_OF[path.suffix.lower()]))
        else:
            accepted = "an existing folder, or a file ending in .exr, .png or .json"
            raise usage_error("-o", "not a place to download to", found=path, accepted=accepted)
    for target in targets:
        check_writable(target.path if target.name else target.path / "x", "-o")
    return targets


def download_all(
    client: Client,
    job: Job,
    targets: list[Target],
    *,
    exposure: float,
    view: str,
    numbers: list[int] | None = None,
) -> Iterator[Path]:
    """Download a job's outputs, one file at a time; gives the paths.

    `numbers` are those of the frames to take, None = all.
    """
    frames = [] if job.frames is None else client.frames(job.id)
    if numbers is not None:
        check_numbers(numbers, frames)
        frames = [frame for frame in frames if frame.number in numbers]
    own = [] if numbers is not None else [output.name for output in job.outputs]
    own.append("log.txt")
    fetch = _Fetch(client, job, exposure, view)
    for target in targets:
        if target.name is None:
            if not job.outputs and not any(frame.outputs for frame in frames):
                raise CommandError(f"job {job.id} has no outputs (found state {job.state})")
            for name in own[:-1]:
                yield fetch(name, target.path / Path(name).name)
            for frame in frames:
                for output in frame.outputs:
                    yield fetch(output.name, target.path / frame.file_name(output.name), frame)
        elif job.frames is None or target.name in own:
            yield fetch(target.name, target.path)
        else:
            yield from _of_frames(fetch, target, frames)


def check_numbers(numbers: list[int], frames: list[Frame]) -> None:
    """Raise for a frame that the job does not have."""
    known = {frame.number for frame in frames}
    for number in numbers:
        if number not in known:
            accepted = f"1 to {len(known)}" if known else "none: the job has one image"
            raise usage_error("--frame", "no such frame", found=number, accepted=accepted)


def _of_frames(fetch: _Fetch, target: Target, frames: list[Frame]) -> Iterator[Path]:
    """One output of each frame, each to a file with its number."""
    assert target.name is not None
    taken = [frame for frame in frames if any(o.name == target.name for o in frame.outputs)]
    if not taken:
        raise CommandError(f"no frame of job {fetch.job.id} has {target.name}")
    for frame in taken:
        yield fetch(target.name, numbered(target.path, frame.name), frame)


@dataclass(frozen=True)
class _Fetch:
    """Downloads the outputs of one job."""

    client: Client
    job: Job
    exposure: float
    view: str

    def __call__(self, name: str, path: Path, frame: Frame | None = None) -> Path:
        number = None if frame is None else frame.number
        # The PNG image is made for another view only when one is asked for.
        if name == "image.png" and (self.exposure, self.view) != (0.0, "srgb"):
            return self.client.download(
                self.job.id, name, path, frame=number, exposure=self.exposure, view=self.view
            )
        return self.client.download(self.job.id, name, path, frame=number)


def download(
    job: JobArgument,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Outputs to get, such as image.exr, image.png, stats.json, log.txt.",
            metavar="[NAME]...",
        ),
    ] = None,
    server: ServerOption = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="File (.exr, .png, .json) or folder; may repeat [default: this folder]",
            metavar="OUT",
        ),
    ] = None,
    frame: FrameOption = None,
    exposure: ExposureOption = 0.0,
    view: ViewOption = "srgb",
    as_json: JsonOption = False,
) -> None:
    """Download the outputs of a job; those of frames get their number: image.0001.exr."""
    from raykiln_service.client import Client

    check_view(view, exposure)
    targets = download_targets(output or [Path()], names)
    with Client(server) as client:
        found = client.job(job)
        paths = []
        for path in download_all(
            client, found, targets, exposure=exposure, view=view, numbers=frame
        ):
            paths.append(str(path))
            if not as_json:
                print(path)
    if as_json:
        print_json(paths)
