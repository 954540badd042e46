"""`raykiln deliveries`: what the webhook of a job has been told, and telling it again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from raykiln_service.commands.console import print_json
from raykiln_service.commands.watch import JobArgument, JsonOption, ServerOption

if TYPE_CHECKING:
    from raykiln_service.client import Delivery


def deliveries(
    job: JobArgument,
    server: ServerOption = None,
    redeliver: Annotated[
        list[str] | None,
        typer.Option(
            "--redeliver", help="Send this message again, at once; may repeat.", metavar="ID"
        ),
    ] = None,
    redeliver_failed: Annotated[
        bool, typer.Option("--redeliver-failed", help="Send again all that were given up.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what the webhook of a job has been told."""
    from raykiln_service.client import Client

    with Client(server) as client:
        found = client.deliveries(job)
        wanted = list(redeliver or [])
        if redeliver_failed:
            wanted += [item.id for item in found.items if item.state == "failed"]
        for delivery_id in dict.fromkeys(wanted):
            found = client.redeliver(job, delivery_id)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    for item in found.items:
        print(_line(item))


def _line(item: Delivery) -> str:
    text = f"{item.id}  {item.event:<13}  {item.state:<9}  {item.attempts} attempts"
    why = item.error or (None if item.status is None else f"status {item.status}")
    return text if why is None else f"{text}  {why}"
