"""`raykiln batch`: many scenes to a folder, without a server."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import (
    CommandError,
    duration,
    print_note,
    usage_error,
)
from raykiln_service.commands.options import RenderOptions, with_render_options
from raykiln_service.commands.progress import progress_bar
from raykiln_service.commands.render import (
    ExposureOption,
    IntervalOption,
    QuietOption,
    ViewOption,
    check_interval,
    check_view,
)

if TYPE_CHECKING:
    from raykiln_service.commands.batch_run import Batch, Entry


@with_render_options
def batch(
    *,
    source: Annotated[
        Path,
        typer.Argument(
            help="A folder of scenes, or a manifest: JSON lines, plain paths or a JSON list.",
            metavar="INPUT_DIR_OR_MANIFEST",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the results.", metavar="OUTDIR")
    ],
    resume: Annotated[
        bool, typer.Option("--resume", help="Skip what is finished, go on with the rest.")
    ] = False,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", help="Scenes rendered at a time.", metavar="N")
    ] = 1,
    checkpoint_interval: IntervalOption = 5.0,
    exposure: ExposureOption = 0.0,
    view: ViewOption = "srgb",
    quiet: QuietOption = False,
    options: RenderOptions,
) -> None:
    """Render every scene of a folder or a manifest; one that fails does not stop the others.

    Writes NAME.exr, NAME.png and NAME.stats.json of each scene and report.json. Exit code 0 if
    all are done, 1 if any failed.
    """
    from raykiln_service.commands.batch_inputs import read_inputs
    from raykiln_service.commands.batch_run import Batch

    if not 1 <= jobs <= 256:
        raise usage_error("--jobs", "out of range", found=jobs, accepted="1 to 256")
    check_view(view, exposure)
    check_interval(checkpoint_interval)
    options.settings()
    values = options.values()
    if jobs > 1:
        values.setdefault("threads", max(1, len(os.sched_getaffinity(0)) // jobs))
    folder = _output_folder(output)
    items = read_inputs(source, folder, values)
    show = _Show(len(items), quiet=quiet)
    work = Batch(
        items,
        folder,
        resume=resume,
        jobs=jobs,
        view_arguments=[f"--exposure={exposure}", f"--view={view}"],
        checkpoint_interval_s=checkpoint_interval,
        on_change=show.change,
    )
    with show:
        code = work.run()
    if not quiet:
        _summarise(work, folder)
    raise typer.Exit(code)


def _output_folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"-o: cannot make the folder {path}: {error.strerror}") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise usage_error("-o", "the folder cannot be written to", found=path)
    return path


class _Show:
    """Tells how the batch gets on: bars on a terminal, else a line a scene."""

    def __init__(self, total: int, *, quiet: bool) -> None:
        self._total = total
        self._quiet = quiet
        self._finished = 0
        self._bar = progress_bar() if sys.stderr.isatty() and not quiet else None
        self._tasks: dict[str, Any] = {}

    def __enter__(self) -> _Show:
        if self._bar is not None:
            self._bar.start()
            self._tasks[""] = self._bar.add_task("batch", total=self._total, info="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def change(self, entry: Entry, fraction: float) -> None:
        """Show one entry's new state."""
        if entry.state == "running":
            self._show_running(entry, fraction)
            return
        self._finished += 1
        if self._bar is not None:
            if entry.name in self._tasks:
                self._bar.remove_task(self._tasks.pop(entry.name))
            self._bar.update(self._tasks[""], completed=self._finished)
        if not self._quiet:
            self._line(entry)

    def _show_running(self, entry: Entry, fraction: float) -> None:
        if self._bar is None:
            return
        if entry.name not in self._tasks:
            self._tasks[entry.name] = self._bar.add_task(entry.name, total=1.0, info="")
        self._bar.update(self._tasks[entry.name], completed=fraction)

    def _line(self, entry: Entry) -> None:
        text = f"[{self._finished}/{self._total}] {entry.name}: {entry.state}"
        if entry.skipped:
            text += " before"
        elif entry.seconds is not None:
            text += f" in {duration(entry.seconds)}"
        if entry.error:
            text += f": {entry.error}"
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False)
        else:
            print_note(text)


def _summarise(work: Batch, folder: Path) -> None:
    from raykiln_service.commands.batch_run import REPORT

    states = [entry.state for entry in work.entries]
    counts = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
    print(f"{len(states)} scenes: {counts}")
    print(folder / REPORT)
