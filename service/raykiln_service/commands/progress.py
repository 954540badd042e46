"""Progress of a render: a bar on a terminal, one line a pass elsewhere, or JSON lines."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Protocol

from raykiln_service.commands.console import count, duration, print_note

if TYPE_CHECKING:
    from raykiln import Progress


class Reporter(AbstractContextManager["Reporter"]):
    """Takes the progress of one render; this one keeps silent."""

    def update(self, progress: Progress) -> None:
        """Show where the render stands."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the terminal as it was."""


class LineReporter(Reporter):
    """One line on stderr at the end of each pass."""

    def __init__(self) -> None:
        self._pass = 0
        self._spp = 0

    def update(self, progress: Progress) -> None:
        if progress.spp_done <= self._spp:
            return
        self._pass += 1
        self._spp = progress.spp_done
        print_note(
            f"pass {self._pass}: {progress.spp_done}/{progress.spp} spp, "
            f"{progress.fraction:.0%}, {duration(progress.elapsed_s)}, "
            f"{count(_rate(progress))} samples/s, ETA {duration(progress.eta_s)}"
        )


class JsonReporter(Reporter):
    """One JSON object a line on stderr, for a program that watches."""

    def update(self, progress: Progress) -> None:
        record = {
            "fraction": progress.fraction,
            "spp_done": progress.spp_done,
            "spp": progress.spp,
            "elapsed_s": progress.elapsed_s,
            "eta_s": progress.eta_s,
        }
        print(json.dumps({"progress": record}), file=sys.stderr, flush=True)


class BarReporter(Reporter):
    """A bar on the terminal."""

    def __init__(self, label: str) -> None:
        self._bar = progress_bar()
        self._task = self._bar.add_task(label, total=1.0, info="")

    def update(self, progress: Progress) -> None:
        info = f"{progress.spp_done}/{progress.spp} spp  {count(_rate(progress))} samples/s"
        if progress.eta_s is not None:
            info += f"  ETA {duration(progress.eta_s)}"
        self._bar.start()
        self._bar.update(self._task, completed=progress.fraction, info=info)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()


def progress_bar() -> Any:
    """A `rich.progress.Progress` on stderr whose tasks have a field `info`."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[info]}", markup=False),
        console=Console(stderr=True),
        transient=True,
    )


def reporter(label: str, *, quiet: bool, as_json: bool = False) -> Reporter:
    """The reporter that fits where stderr goes."""
    if as_json:
        return JsonReporter()
    if quiet:
        return Reporter()
    return BarReporter(label) if sys.stderr.isatty() else LineReporter()


def _rate(progress: Progress) -> float:
    return progress.samples / progress.elapsed_s if progress.elapsed_s > 0 else 0.0


class Stop(Protocol):
    """Tells whether the user asked to stop."""

    requested: bool


class _Stop:
    requested = False


@contextmanager
def graceful_stop() -> Iterator[Stop]:
    """Turn the first SIGINT or SIGTERM into a flag; a second one interrupts at once."""
    stop = _Stop()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.requested:
            raise KeyboardInterrupt
        stop.requested = True

    before = {n: signal.signal(n, handle) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
