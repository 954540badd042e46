"""Answering a job with the result of an identical one, file by file as hard links.

Identical means: the same scene by its hash, the same resolved settings, the same outputs, made by
the same build of the renderer with the same instruction set.  Each of the two jobs owns its links,
so that either can be deleted without harm to the other.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import secrets
import shutil
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import raykiln as rk
from raykiln.rendering import isa

from raykiln_service.assets import AssetStore
from raykiln_service.files import remove_tree, sha256_of, sync_dir
from raykiln_service.logs import JobLog, get_logger
from raykiln_service.rows import dump
from raykiln_service.store import Store

# What does not decide the bits of an image that is complete.
_FREE = frozenset({"threads"})


@cache
def engine() -> str:
    """The renderer that would render here: version, build and instruction set."""
    spec = importlib.util.find_spec("raykiln._core")
    assert spec is not None
    assert spec.origin is not None
    return f"{rk.__version__} {sha256_of(Path(spec.origin))[:16]} {isa()}"


def result_key(
    scene_sha256: str, settings: Mapping[str, Any], outputs: Sequence[str]
) -> str | None:
    """Names a result; None where it is not the same each time.

    Parameters
    ----------
    settings
        All render settings, as they will be.
    """
    if settings.get("time_budget_s") is not None:
        # How far it comes in that time depends on the machine.
        return None
    deciding = {name: value for name, value in settings.items() if name not in _FREE}
    parts = [engine(), scene_sha256, deciding, sorted(outputs)]
    return hashlib.sha256(dump(parts).encode()).hexdigest()


class ResultCache:
    """Results of earlier jobs, found by their keys."""

    def __init__(self, store: Store, assets: AssetStore) -> None:
        self._store = store
        self._assets = assets

    def answer(self, job_id: str, key: str) -> dict[str, Any] | None:
        """Put the result that has this key into a job's folder.

        Returns
        -------
        What the job's row is to say of it, or None if there is no such result (any more).
        """
        found = self._store.result_of_key(key)
        if found is None or found[0] == job_id:
            return None
        source_id, result = found
        source, folder = self._assets.job_dir(source_id), self._assets.job_dir(job_id)
        place = folder / f"result-{secrets.token_hex(16)}"
        try:
            folder.mkdir(exist_ok=True)
            _link_folder(source / result["dir"], place)
            if (source / "preview.png").exists():
                (folder / "preview.png").unlink(missing_ok=True)
                _link(source / "preview.png", folder / "preview.png")
            sync_dir(folder)
            sync_dir(folder.parent)
        except OSError as error:
            # It is being deleted just now, or there is no room for a folder: then it is rendered.
            get_logger().info("result not taken from the cache", job=job_id, error=str(error))
            remove_tree(place)
            return None
        JobLog(folder / "log.txt", 0).write("answered with the result of an identical job")
        origin = result.get("cached_from") or source_id
        return {**result, "dir": place.name, "cached_from": origin}


def _link_folder(source: Path, place: Path) -> None:
    place.mkdir()
    for path in source.iterdir():
        if path.is_dir():
            _link_folder(path, place / path.name)
        else:
            _link(path, place / path.name)
    sync_dir(place)


def _link(source: Path, place: Path) -> None:
    try:
        os.link(source, place)
    except FileNotFoundError:
        raise
    except OSError:
        # Too many links, or a file system without them.
        shutil.copy2(source, place)
