"""`raykiln queue`: how the queue of a service stands, pausing and resuming it."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from raykiln_service.commands.console import count, duration, print_json, usage_error
from raykiln_service.commands.watch import JsonOption, ServerOption

_ACTIONS = ("show", "pause", "resume")


def queue(
    action: Annotated[
        str, typer.Argument(help="show, pause or resume", metavar="[show|pause|resume]")
    ] = "show",
    reason: Annotated[
        str | None, typer.Option("--reason", help="Why it is paused; shown to all.", metavar="TEXT")
    ] = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the queue of a service, or pause or resume it.

    A pause begins no further jobs, also after a restart; those that run go on.
    """
    from raykiln_service.client import Client

    if action not in _ACTIONS:
        raise usage_error(
            "ACTION", "there is no such action", found=action, accepted=", ".join(_ACTIONS)
        )
    if reason is not None and action != "pause":
        raise usage_error("--reason", "goes with pause only")
    with Client(server) as client:
        match action:
            case "pause":
                view = client.pause_queue(reason)
            case "resume":
                view = client.resume_queue()
            case _:
                view = client.queue()
    if as_json:
        print_json(view)
        return
    print(_text(view))


def _text(view: dict[str, Any]) -> str:
    lines = [f"{view['queued']} waiting, {view['running']} running in {view['slots']} slots"]
    if view["paused"]:
        reason = f": {view['pause_reason']}" if view["pause_reason"] else ""
        lines.append(f"paused since {view['paused_at']}{reason}")
    elif view["queued"] or view["running"]:
        lines.append(f"done in {duration(view['drained_in_s'])}")
    if view["samples_per_s"]:
        lines.append(f"{count(view['samples_per_s'])}samples/s")
    return "\n".join(lines)
