"""What a submitted job may take, and who is to hear of its end."""

from __future__ import annotations

import os
from typing import Annotated, Any

import typer

from raykiln_service.commands.console import usage_error

TimeoutOption = Annotated[
    float | None,
    typer.Option("--timeout", help="Longest time on a slot, in all.", metavar="SECONDS"),
]
MemoryOption = Annotated[
    str | None,
    typer.Option("--memory", help="Most memory: 512M, 4G.", metavar="SIZE"),
]
WebhookOption = Annotated[
    str | None,
    typer.Option(
        "--webhook",
        help="Post the end of the job there, signed with RAYKILN_JOB_WEBHOOK_SECRET or else the "
        "service's own secret.",
        metavar="URL",
    ),
]
WebhookEventOption = Annotated[
    list[str] | None,
    typer.Option(
        "--webhook-event",
        help="Post only such an end; may repeat.",
        metavar="succeeded|failed|cancelled",
    ),
]


def webhook_of(url: str | None, events: list[str] | None) -> dict[str, Any] | None:
    """The webhook to ask for; a secret on the command line would be seen by everybody."""
    if url is None:
        if events:
            raise usage_error(
                "--webhook-event", "goes with --webhook only", accepted="--webhook URL"
            )
        return None
    hook: dict[str, Any] = {"url": url}
    if events:
        hook["events"] = events
    if secret := os.environ.get("RAYKILN_JOB_WEBHOOK_SECRET"):
        hook["secret"] = secret
    return hook
