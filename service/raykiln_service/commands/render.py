"""`raykiln render`: one scene to image files, in this process."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from raykiln_service.commands.console import (
    CommandError,
    ExitCode,
    check_writable,
    count,
    duration,
    print_note,
    print_warnings,
    usage_error,
)
from raykiln_service.commands.frame_log import FrameLog, identity_of
from raykiln_service.commands.frames import FrameOptions, Picture, numbered, pictures
from raykiln_service.commands.options import (
    RenderOptions,
    settings_of,
    with_options,
    with_render_options,
)
from raykiln_service.commands.progress import Stop, graceful_stop, reporter
from raykiln_service.commands.scenes import BaseDirOption, SceneArgument, load, naming, stem_of
from raykiln_service.files import write_json

if TYPE_CHECKING:
    from raykiln import RenderResult, RenderSettings
    from raykiln.image import View

VIEWS = ("srgb", "agx", "aces", "raw")
_IMAGES = (".exr", ".png")

OutputOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        help="Image to write (.exr or .png); may repeat. Default: SCENE.exr and SCENE.png here.",
        metavar="FILE",
    ),
]
ExposureOption = Annotated[
    float, typer.Option("--exposure", help="Exposure of PNG images in stops.", metavar="EV")
]
ViewOption = Annotated[
    str, typer.Option("--view", help="View transform of PNG images.", metavar="|".join(VIEWS))
]
IntervalOption = Annotated[
    float,
    typer.Option(
        "--checkpoint-interval", help="Time between checkpoints at least.", metavar="SECONDS"
    ),
]
StatsOption = Annotated[
    Path | None, typer.Option("--stats", help="Write the statistics here.", metavar="FILE.json")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


@with_options(FrameOptions, "frames")
@with_render_options
def render(
    *,
    scene: SceneArgument,
    output: OutputOption = None,
    exposure: ExposureOption = 0.0,
    view: ViewOption = "srgb",
    half: Annotated[bool, typer.Option("--half", help="16-bit floats in the EXR.")] = False,
    stats: StatsOption = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option("--checkpoint", help="Keep the state of the render here.", metavar="FILE"),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoint, if it exists.")
    ] = False,
    checkpoint_interval: IntervalOption = 5.0,
    base_dir: BaseDirOption = None,
    quiet: QuietOption = False,
    settings_json: Annotated[str | None, typer.Option("--settings-json", hidden=True)] = None,
    progress_json: Annotated[bool, typer.Option("--progress-json", hidden=True)] = False,
    frames: FrameOptions,
    options: RenderOptions,
) -> None:
    """Render a scene to EXR and PNG files.

    Of many pictures each file gets its number in place of ####, or before its extension.

    Ctrl-C stops at once, writes the image so far (marked as partial) and the checkpoint, and exits
    with code 130.
    """
    targets = output_paths(output, stem_of(scene))
    check_outputs(targets, stats, checkpoint, resume)
    check_view(view, exposure)
    check_interval(checkpoint_interval)
    settings = _settings(options, settings_json)
    request = frames.request()
    log = None
    if request is not None and checkpoint is not None:
        log = FrameLog(checkpoint, resume=resume)
    loaded = load(scene, base_dir)
    job = _Job(
        scene,
        _Files(targets, stats, exposure, view, half),
        _Keeping(checkpoint, resume, checkpoint_interval, log),
        quiet=quiet,
        progress_json=progress_json,
        to_say=[] if quiet else list(loaded.warnings),
    )
    with naming(scene), graceful_stop() as stop:
        if request is None:
            job.render(Picture(None, loaded, settings), scene, stop)
        else:
            count, wanted = pictures(
                request, loaded, settings, lambda time_s: load(scene, base_dir, time_s=time_s)
            )
            for i, picture in enumerate(wanted):
                job.render(picture, f"{scene} {i + 1}/{count}", stop)
                if stop.requested:
                    break
    if stop.requested:
        if not quiet and checkpoint is not None:
            print_note(f"interrupted: go on with --checkpoint {checkpoint} --resume")
        raise typer.Exit(ExitCode.INTERRUPTED)


@dataclass(frozen=True)
class _Files:
    """What to write of an image, and how."""

    targets: list[Path]
    stats: Path | None
    exposure: float
    view: str
    half: bool

    def how(self) -> dict[str, Any]:
        """What decides the bytes of the files, besides the image."""
        return {"exposure": self.exposure, "view": self.view, "half": self.half}


@dataclass(frozen=True)
class _Keeping:
    """How the state of a render is kept."""

    checkpoint: Path | None
    resume: bool
    interval_s: float
    log: FrameLog | None
    """Which of many pictures are finished."""


@dataclass
class _Job:
    """The renders of one command."""

    scene: str
    files: _Files
    keeping: _Keeping
    quiet: bool
    progress_json: bool
    to_say: list[str]
    said: set[str] = field(default_factory=set)

    def render(self, picture: Picture, label: str, stop: Stop) -> None:
        """Render one picture and write it, unless that was done before."""
        import raykiln

        checkpoint = self.keeping.checkpoint
        files = self.files
        targets = [numbered(path, picture.name) for path in files.targets]
        stats = None if files.stats is None else numbered(files.stats, picture.name)
        written = [*targets, *([stats] if stats else [])]
        log, scene, identity = self.keeping.log, picture.scene, ""
        if log is not None and picture.name is not None and checkpoint is not None:
            checkpoint = numbered(checkpoint, picture.name)
            if isinstance(scene, raykiln.Scene):
                scene = raykiln.prepare(scene)
            identity = identity_of(scene, picture.settings, files.how())
            if self.keeping.resume and log.is_finished(picture.name, identity, written):
                self._say_kept(label)
                return
        with reporter(label, quiet=self.quiet, as_json=self.progress_json) as shown:

            def on_progress(progress: raykiln.Progress) -> bool:
                # Not before the scene is built: an error is told without them.
                self._warn(self.to_say)
                shown.update(progress)
                return not stop.requested

            result = raykiln.render(
                scene,
                picture.settings,
                on_progress,
                checkpoint=checkpoint,
                resume=self.keeping.resume,
                checkpoint_interval_s=self.keeping.interval_s,
            )
            if not self.quiet:
                self._warn(result.warnings)
            _write(
                result,
                targets,
                stats,
                exposure=files.exposure,
                view=files.view,
                half=files.half,
            )
        if log is not None and picture.name is not None and result.complete:
            log.note(picture.name, identity, written)
            if checkpoint is not None:
                checkpoint.unlink(missing_ok=True)
        if not self.quiet:
            _summarise(result, written)

    def _say_kept(self, label: str) -> None:
        self._warn(self.to_say)
        if not self.quiet:
            print_note(f"{label} is finished, and kept")

    def _warn(self, warnings: list[str]) -> None:
        print_warnings([text for text in warnings if text not in self.said])
        self.said.update(warnings)


def output_paths(given: list[Path] | None, stem: str) -> list[Path]:
    """The images to write, each once, with their extensions checked."""
    paths = list(dict.fromkeys(given or [Path(stem + ".exr"), Path(stem + ".png")]))
    for path in paths:
        if path.suffix.lower() not in _IMAGES:
            raise usage_error(
                "-o", f"cannot write a file of this kind: {path}", accepted=".exr, .png"
            )
    return paths


def check_outputs(
    targets: list[Path], stats: Path | None, checkpoint: Path | None, resume: bool
) -> None:
    """Raise now for what could not be written after the render."""
    for path in targets:
        check_writable(path, "-o")
    for option, extra in (("--stats", stats), ("--checkpoint", checkpoint)):
        if extra is not None:
            check_writable(extra, option)
            if extra.resolve() in [path.resolve() for path in targets]:
                raise usage_error(option, "the file is an output too", found=extra)
    if resume and checkpoint is None:
        raise usage_error("--resume", "needs the file to go on from", accepted="--checkpoint FILE")


def check_view(view: str, exposure: float) -> None:
    """Raise for an unknown view transform or an exposure out of range."""
    if view not in VIEWS:
        raise usage_error("--view", "no such view", found=view, accepted=", ".join(VIEWS))
    if not -100 <= exposure <= 100:
        raise usage_error("--exposure", "out of range", found=exposure, accepted="-100 to 100")


def check_interval(seconds: float) -> None:
    """Raise for a time between checkpoints that is none."""
    if not seconds >= 0:
        raise usage_error("--checkpoint-interval", "out of range", found=seconds, accepted="0 up")


def _settings(options: RenderOptions, settings_json: str | None) -> RenderSettings:
    if settings_json is None:
        return options.settings()
    try:
        base: dict[str, Any] = json.loads(settings_json)
    except ValueError as error:
        raise CommandError(f"--settings-json: not JSON: {error}") from None
    return settings_of({**base, **options.values()})


def _write(
    result: RenderResult,
    targets: list[Path],
    stats: Path | None,
    *,
    exposure: float,
    view: str,
    half: bool,
) -> None:
    from raykiln import ImageError

    for path in targets:
        try:
            result.save(path, exposure=exposure, view=cast("View", view), half=half)
        except (OSError, ImageError) as error:
            raise CommandError(f"{path}: cannot write: {error}", ExitCode.FAILED) from None
    if stats is not None:
        write_json(stats, result.stats.as_dict())


def _summarise(result: RenderResult, written: list[Path]) -> None:
    stats = result.stats
    rate = stats.samples / stats.render_s if stats.render_s > 0 else 0.0
    settings = result.settings
    state = "rendered" if result.complete else "partial image:"
    print(
        f"{state} {settings.width}x{settings.height}, {stats.spp}/{settings.spp} spp "
        f"in {duration(stats.total_s)}: {count(rate)} samples/s, {count(stats.rays_per_s)} rays/s"
    )
    for path in written:
        print(path)
