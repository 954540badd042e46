"""`raykiln token`: make, list and revoke the bearer tokens of a service.

These work on the service's database itself, whether the service runs or not.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import print_note, usage_error

if TYPE_CHECKING:
    from raykiln_service.tokens import Token, TokenStore

app = typer.Typer(no_args_is_help=True, help="Make, list and revoke bearer tokens.")
_UNITS_S = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 604800, "y": 31_536_000}
_MAX_LIFE_S = 100 * _UNITS_S["y"]

DataDir = Annotated[
    Path,
    typer.Option(
        "--data-dir", help="Folder of the service", metavar="DIR", envvar="RAYKILN_DATA_DIR"
    ),
]
DatabaseUrl = Annotated[
    str | None,
    typer.Option(
        "--database", help="SQLAlchemy URL [default: SQLite in the data folder]", metavar="URL"
    ),
]


def _limit(name: str, text: str) -> Any:
    return typer.Option(f"--{name}", help=text, metavar="N", min=0)


@app.command()
def create(
    name: Annotated[str, typer.Option("--name", help="Whose it is or what for", metavar="NAME")],
    scope: Annotated[
        list[str] | None,
        typer.Option(
            "--scope",
            help="What it may do; may repeat [default: read, submit, manage]",
            metavar="read|submit|manage|admin",
        ),
    ] = None,
    expires: Annotated[
        str | None,
        typer.Option("--expires", help="How long it is good for: 12h, 90d [default: for ever]"),
    ] = None,
    max_jobs: Annotated[
        int | None, _limit("max-jobs", "Jobs that may wait or run at a time")
    ] = None,
    max_bytes: Annotated[int | None, _limit("max-bytes", "Bytes of uploads")] = None,
    max_samples: Annotated[
        int | None, _limit("max-samples", "Pixel samples of jobs that wait or run")
    ] = None,
    max_samples_per_day: Annotated[
        int | None, _limit("max-samples-per-day", "Pixel samples submitted in 24 hours")
    ] = None,
    max_requests_per_minute: Annotated[
        int | None, _limit("max-requests-per-minute", "Requests")
    ] = None,
    data_dir: DataDir = Path("raykiln-data"),
    database: DatabaseUrl = None,
) -> None:
    """Make a token and print it.  It is not kept and cannot be shown again."""
    from raykiln_service.access import Limits

    limits = Limits(max_jobs, max_bytes, max_samples, max_samples_per_day, max_requests_per_minute)
    if max_requests_per_minute == 0:
        raise usage_error("--max-requests-per-minute", "too small", found=0, accepted="1 or more")
    scopes = _scopes(scope or ["read", "submit", "manage"])
    lifetime_ms = None if expires is None else 1000 * _seconds(expires)
    with _tokens(data_dir, database) as store:
        token, text = store.create(_name(name), scopes, limits=limits, lifetime_ms=lifetime_ms)
    until = "" if token.expires_ms is None else f", until {_moment(token.expires_ms)}"
    print_note(f"token {token.id} {token.name!r} may {', '.join(sorted(token.scopes))}{until}")
    print(text)


@app.command("list")
def list_tokens(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    data_dir: DataDir = Path("raykiln-data"),
    database: DatabaseUrl = None,
) -> None:
    """Show the tokens, with their limits and when they were last used; never their text."""
    from raykiln_service.store_base import now_ms

    with _tokens(data_dir, database) as store:
        rows = [_row(token, token.state(now_ms())) for token in store.all()]
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        used = row["last_used"] or "never"
        scopes = ",".join(row["scopes"])
        print(f"{row['id']}  {row['state']:8}  {scopes:20}  used {used}  {row['name']}")


@app.command()
def revoke(
    token: Annotated[str, typer.Argument(help="Id or name", metavar="ID_OR_NAME")],
    data_dir: DataDir = Path("raykiln-data"),
    database: DatabaseUrl = None,
) -> None:
    """End a token for good.  A running service refuses it within a second."""
    from raykiln_service.errors import NotFoundError

    with _tokens(data_dir, database) as store:
        try:
            ended = store.revoke(token)
        except NotFoundError as error:
            raise usage_error("token", error.detail) from None
    print_note(f"token {ended.id} {ended.name!r} is revoked")


@contextmanager
def _tokens(data_dir: Path, database: str | None) -> Iterator[TokenStore]:
    from raykiln_service.beside import open_database
    from raykiln_service.errors import ServiceError
    from raykiln_service.tokens import TokenStore

    try:
        with open_database(data_dir, database) as opened:
            yield TokenStore(opened)
    except ServiceError as error:
        raise usage_error("token", error.detail) from None


def _scopes(names: list[str]) -> list[Any]:
    from raykiln_service.access import Scope

    wanted = [part for name in names for part in name.split(",")]
    try:
        return [Scope(name) for name in wanted]
    except ValueError:
        raise usage_error(
            "--scope", "no such scope", found=",".join(wanted), accepted=", ".join(Scope)
        ) from None


def _name(name: str) -> str:
    if not 0 < len(name) <= 200 or not name.isprintable():
        raise usage_error("--name", "not accepted", accepted="1 to 200 printable characters")
    return name


def _seconds(text: str) -> int:
    found = re.fullmatch(r"(\d{1,6})\s*([smhdwy])", text.strip())
    seconds = 0 if found is None else int(found[1]) * _UNITS_S[found[2]]
    if not 0 < seconds <= _MAX_LIFE_S:
        raise usage_error("--expires", "not a time", found=text, accepted="such as 30m, 12h, 90d")
    return seconds


def _row(token: Token, state: str) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "id": token.id,
        "name": token.name,
        "state": state,
        "scopes": sorted(token.scopes),
        "limits": {
            name: value for name, value in asdict(token.limits).items() if value is not None
        },
        "created": _moment(token.created_ms),
        "expires": _moment(token.expires_ms),
        "last_used": _moment(token.last_used_ms),
        "revoked": _moment(token.revoked_ms),
    }


def _moment(unix_ms: int | None) -> str | None:
    if unix_ms is None:
        return None
    return datetime.fromtimestamp(unix_ms // 1000, UTC).isoformat().replace("+00:00", "Z")
