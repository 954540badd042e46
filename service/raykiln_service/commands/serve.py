"""`raykiln serve`: the service in the foreground."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from raykiln_service.commands.gc import (
    KeepAssets,
    KeepResults,
    MaxAssets,
    MaxResults,
    retention_of,
)


def serve(
    host: Annotated[
        str | None,
        typer.Option(
            "--host",
            help="Address to listen on; 0.0.0.0 = all [default: 127.0.0.1]",
            metavar="ADDR",
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option("--port", help="Port; 0 = any free one [default: 8000]", metavar="N"),
    ] = None,
    data_dir: Annotated[
        Path | None,
        typer.Option(
            "--data-dir", help="Folder of jobs and assets [default: raykiln-data]", metavar="DIR"
        ),
    ] = None,
    database: Annotated[
        str | None,
        typer.Option(
            "--database", help="SQLAlchemy URL [default: SQLite in the data folder]", metavar="URL"
        ),
    ] = None,
    slots: Annotated[
        int | None,
        typer.Option("--slots", help="Jobs rendered at a time [default: 1]", metavar="N"),
    ] = None,
    executor: Annotated[
        str | None,
        typer.Option(
            "--executor", help="Where jobs are rendered [default: local]", metavar="local|dask"
        ),
    ] = None,
    require_token: Annotated[
        bool,
        typer.Option("--require-token", help="Ask for a token on loopback too."),
    ] = False,
    keep_results: KeepResults = None,
    keep_assets: KeepAssets = None,
    max_results: MaxResults = None,
    max_assets: MaxAssets = None,
    insecure: Annotated[
        bool,
        typer.Option("--insecure", help="Let other machines in without a token."),
    ] = False,
) -> None:
    """Serve the HTTP API and the job page until SIGINT or SIGTERM.

    Addresses other than loopback need a bearer token: `raykiln token create` makes one, or
    RAYKILN_TOKEN holds one that may do everything.
    """
    from raykiln_service.app import serve as serve_http
    from raykiln_service.settings import ServiceSettings

    settings = ServiceSettings.create(
        host=host,
        port=port,
        data_dir=data_dir,
        database_url=database,
        slots=slots,
        executor=executor,
        require_token=require_token or None,
        insecure=insecure or None,
        **retention_of(keep_results, keep_assets, max_results, max_assets),
    )
    # The service ends by its own handling of these signals.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    serve_http(settings)
