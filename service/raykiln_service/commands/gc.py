"""`raykiln gc`: remove what is old or too much from a service's data folder."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import print_json, usage_error

if TYPE_CHECKING:
    from raykiln_service.retention import Sweep

_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 604800}
BYTES = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}

KeepResults = Annotated[
    str | None,
    typer.Option(
        "--keep-results",
        help="Remove ended jobs after this time: 12h, 30d [default: never]",
        metavar="TIME",
    ),
]
KeepAssets = Annotated[
    str | None,
    typer.Option(
        "--keep-assets",
        help="Remove uploads that no job refers to this long after their last use [default: never]",
        metavar="TIME",
    ),
]
MaxResults = Annotated[
    str | None,
    typer.Option(
        "--max-results",
        help="Remove the oldest ended jobs past this size of all: 500M, 20G [default: no limit]",
        metavar="SIZE",
    ),
]
MaxAssets = Annotated[
    str | None,
    typer.Option(
        "--max-assets",
        help="Remove uploads that no job refers to past this size of all [default: no limit]",
        metavar="SIZE",
    ),
]


def gc(
    data_dir: Annotated[
        Path,
        typer.Option(
            "--data-dir", help="Folder of the service", metavar="DIR", envvar="RAYKILN_DATA_DIR"
        ),
    ] = Path("raykiln-data"),
    database: Annotated[
        str | None,
        typer.Option(
            "--database", help="SQLAlchemy URL [default: SQLite in the data folder]", metavar="URL"
        ),
    ] = None,
    keep_results: KeepResults = None,
    keep_assets: KeepAssets = None,
    max_results: MaxResults = None,
    max_assets: MaxAssets = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only tell what would be removed.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Clean a service's data folder up, whether the service runs or not.

    Jobs that wait or run are never touched, nor uploads that a job refers to. Without limits only
    what a crash left behind is removed.
    """
    limits = retention_of(keep_results, keep_assets, max_results, max_assets)
    if not data_dir.is_dir():
        raise usage_error("--data-dir", "there is no such folder", found=data_dir)
    sweep = _sweep(data_dir, database, limits, dry_run)
    if as_json:
        print_json({"dry_run": dry_run, **asdict(sweep)})
        return
    verb = "would remove" if dry_run else "removed"
    print(
        f"{verb} {len(sweep.jobs)} jobs, {len(sweep.assets)} uploads and "
        f"{len(sweep.stray_files)} stray files: {sweep.bytes / (1 << 20):.1f} MiB"
    )


def retention_of(
    keep_results: str | None,
    keep_assets: str | None,
    max_results: str | None,
    max_assets: str | None,
) -> dict[str, float | int | None]:
    """The options above as service settings; a usage error for what is no time or size."""
    return {
        "keep_results_s": quantity("--keep-results", keep_results, _SECONDS, "12h or 30d"),
        "keep_assets_s": quantity("--keep-assets", keep_assets, _SECONDS, "12h or 30d"),
        "max_results_bytes": quantity("--max-results", max_results, BYTES, "500M or 20G"),
        "max_assets_bytes": quantity("--max-assets", max_assets, BYTES, "500M or 20G"),
    }


def quantity(option: str, text: str | None, units: dict[str, int], examples: str) -> int | None:
    """A whole number with a unit of `units`; a usage error for what is none."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,15})\s*([a-zA-Z]?)(?:i?[bB])?", text.strip())
    unit = None if found is None else units.get(found[2].lower())
    if found is None or unit is None:
        raise usage_error(
            option, "not understood", found=text, accepted=f"a whole number with a unit: {examples}"
        )
    return int(found[1]) * unit


def _sweep(data_dir: Path, database: str | None, limits: dict[str, Any], dry_run: bool) -> Sweep:
    from raykiln_service.assets import AssetStore
    from raykiln_service.beside import open_database
    from raykiln_service.bundles import BundleLimits
    from raykiln_service.retention import Keeper
    from raykiln_service.settings import ServiceSettings
    from raykiln_service.store import Store

    settings = ServiceSettings.create(data_dir=data_dir, **limits)
    with open_database(data_dir, database) as opened:
        store = Store(opened)
        bundles = BundleLimits(
            settings.max_bundle_bytes, settings.max_bundle_entries, settings.max_bundle_ratio
        )
        assets = AssetStore(data_dir.resolve(), store, bundles)
        return Keeper(store, assets, settings).sweep(dry_run=dry_run)
