"""Watching a job of a service until it ends: `raykiln watch`, and `raykiln submit --wait`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import (
    CommandError,
    ExitCode,
    duration,
    print_json,
    print_note,
)
from raykiln_service.commands.progress import progress_bar

if TYPE_CHECKING:
    from raykiln_service.client import Client, Event, Job

ServerOption = Annotated[
    str | None,
    typer.Option(
        "--server",
        help="Address of the service [default: http://127.0.0.1:8000]",
        envvar="RAYKILN_SERVER",
        metavar="URL",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="As JSON.")]
JobArgument = Annotated[str, typer.Argument(help="Id of the job.", metavar="JOB")]


def watch(
    job: JobArgument,
    server: ServerOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON event a line.")] = False,
) -> None:
    """Follow a job until it ends: exit code 0 if it succeeded, else 1.

    Ctrl-C only stops watching; the job goes on.
    """
    from raykiln_service.client import Client

    with Client(server) as client:
        found = client.job(job)
        if not found.is_final:
            with WatchReporter(as_json=as_json) as shown:
                found = client.wait(job, on_event=shown.event)
    if as_json:
        print_json(found.model_dump(mode="json"))
    conclude(found, quiet=as_json)


def conclude(job: Job, *, quiet: bool = False) -> None:
    """Say how a job ended; raises unless it succeeded."""
    if job.state == "failed":
        raise CommandError(f"job {job.id} failed: {job.error_text or 'unknown'}", ExitCode.FAILED)
    if job.state == "cancelled":
        raise CommandError(f"job {job.id} was cancelled", ExitCode.FAILED)
    if not quiet:
        print(f"{job.id} succeeded")


class WatchReporter:
    """Shows a job's events: a bar on a terminal, else a line a pass, or JSON lines."""

    def __init__(self, *, as_json: bool = False, quiet: bool = False) -> None:
        self._json = as_json
        self._quiet = quiet
        self._spp = -1
        self._frame: int | None = None
        self._state = ""
        self._bar = progress_bar() if sys.stderr.isatty() and not (as_json or quiet) else None
        self._task: Any = None

    def __enter__(self) -> WatchReporter:
        if self._bar is not None:
            self._bar.start()
            self._task = self._bar.add_task("queued", total=1.0, info="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def event(self, event: Event) -> None:
        """Show one event."""
        if self._json:
            import json

            print(json.dumps({"event": event.type, "id": event.id, "data": event.data}), flush=True)
        elif isinstance(event.data, dict):
            if event.type == "state":
                self._show_state(event.data)
            elif event.type == "progress":
                self._show_progress(event.data)

    def _show_state(self, data: dict[str, Any]) -> None:
        state = str(data.get("state", ""))
        if state == self._state:
            return
        self._state = state
        if self._bar is not None:
            self._bar.update(self._task, description=state)
        elif not self._quiet:
            print_note(state)

    def _show_progress(self, data: dict[str, Any]) -> None:
        fraction, spp = float(data.get("fraction") or 0.0), int(data.get("spp_done") or 0)
        if data.get("frame") != self._frame:
            self._frame, self._spp = data.get("frame"), -1
        info = f"{data.get('phase', '')} {spp}/{data.get('spp') or '?'} spp"
        if data.get("frames"):
            info = f"frame {data.get('frame')}/{data['frames']}, {info}"
        if data.get("eta_s") is not None:
            info += f", ETA {duration(data['eta_s'])}"
        if self._bar is not None:
            self._bar.update(self._task, completed=fraction, info=info)
        elif not self._quiet and spp > self._spp:
            print_note(f"{fraction:.0%}, {info}")
        self._spp = max(spp, self._spp)


def wait_or_leave(client: Client, job: Job, reporter: WatchReporter) -> Job:
    """Watch a job of one's own; Ctrl-C asks whether to cancel it or leave it running."""
    try:
        with reporter:
            return client.wait(job.id, on_event=reporter.event)
    except KeyboardInterrupt:
        if _wants_cancel():
            client.cancel(job.id)
            print_note(f"job {job.id} is being cancelled")
        else:
            print_note(
                f"job {job.id} goes on; follow it with: "
                f"raykiln watch {job.id} --server {client.server}"
            )
        raise typer.Exit(ExitCode.INTERRUPTED) from None


def _wants_cancel() -> bool:
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print("\nCancel the job, or leave it running? [c/L] ", end="", file=sys.stderr, flush=True)
    try:
        return sys.stdin.readline().strip().lower().startswith("c")
    except KeyboardInterrupt:
        return False
