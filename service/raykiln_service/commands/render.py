"""`raykiln render`: one scene to image files, in this process."""

from __future__ import annotations

import json
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
from raykiln_service.commands.options import RenderOptions, settings_of, with_render_options
from raykiln_service.commands.progress import graceful_stop, reporter
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
    options: RenderOptions,
) -> None:
    """Render a scene to EXR and PNG files.

    Ctrl-C stops at once, writes the image so far (marked as partial) and the checkpoint, and exits
    with code 130.
    """
    import raykiln

    targets = output_paths(output, stem_of(scene))
    check_outputs(targets, stats, checkpoint, resume)
    check_view(view, exposure)
    check_interval(checkpoint_interval)
    settings = _settings(options, settings_json)
    loaded = load(scene, base_dir)
    to_say = [] if quiet else list(loaded.warnings)
    with graceful_stop() as stop, reporter(scene, quiet=quiet, as_json=progress_json) as shown:

        def on_progress(progress: raykiln.Progress) -> bool:
            # Not before the scene is built: an error is told without them.
            print_warnings(to_say)
            to_say.clear()
            shown.update(progress)
            return not stop.requested

        with naming(scene):
            result = raykiln.render(
                loaded,
                settings,
                on_progress,
                checkpoint=checkpoint,
                resume=resume,
                checkpoint_interval_s=checkpoint_interval,
            )
        if not quiet:
            print_warnings([text for text in result.warnings if text not in loaded.warnings])
        _write(result, targets, stats, exposure=exposure, view=view, half=half)
    if not quiet:
        _summarise(result, [*targets, *([stats] if stats else [])])
    if stop.requested:
        if not quiet and checkpoint is not None:
            print_note(f"interrupted: go on with --checkpoint {checkpoint} --resume")
        raise typer.Exit(ExitCode.INTERRUPTED)


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
