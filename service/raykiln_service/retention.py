"""Clean-ups: ended jobs and idle uploads go when they are old, or when they take too much room.

A job that waits or runs is never touched, nor an upload that any job refers to, nor a file that
another job shares.  The row goes first and the files after it, so what a crash leaves behind are
files that nobody knows; those go too.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from raykiln_service.assets import AssetStore
from raykiln_service.files import remove_tree
from raykiln_service.logs import get_logger
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.store_retention import ASSET_GRACE_MS, EndedJob


@dataclass
class Sweep:
    """What a clean-up removed, or would remove."""

    jobs: list[str] = field(default_factory=list)
    assets: list[str] = field(default_factory=list)
    stray_files: list[str] = field(default_factory=list)
    """Left behind by a crash, relative to the data folder."""
    bytes: int = 0
    """Disk space of all that."""


class Keeper:
    """Cleans a data folder up.

    Parameters
    ----------
    forget
        Called with the id of each removed job.
    """

    def __init__(
        self,
        store: Store,
        assets: AssetStore,
        settings: ServiceSettings,
        forget: Callable[[str], None] = lambda job_id: None,
    ) -> None:
        self._store = store
        self._assets = assets
        self._settings = settings
        self._forget = forget
        self._lock = threading.Lock()

    def sweep(self, *, dry_run: bool = False) -> Sweep:
        """Remove what is due; with `dry_run` only tell what would be."""
        with self._lock:
            sweep = Sweep()
            self._sweep_jobs(sweep, dry_run)
            self._sweep_assets(sweep, dry_run)
            self._sweep_strays(sweep, dry_run)
            return sweep

    # Jobs

    def _sweep_jobs(self, sweep: Sweep, dry_run: bool) -> None:
        ended = self._store.ended_jobs()
        due = {job.id for job in ended if self._is_old(job)}
        freed = self._past_the_cap(ended, due)
        for job in ended:
            if job.id not in due or not (dry_run or self._store.delete_ended(job)):
                continue
            sweep.jobs.append(job.id)
            sweep.bytes += freed.get(job.id, 0)
            if not dry_run:
                self._forget(job.id)
                self._assets.remove_job(job.id)

    def _is_old(self, job: EndedJob) -> bool:
        keep_s = self._settings.keep_results_s
        return keep_s is not None and job.finished_ms <= self._store.clock() - keep_s * 1000

    def _past_the_cap(self, ended: list[EndedJob], due: set[str]) -> dict[str, int]:
        """Add the oldest jobs that are too much to `due`; what each of these frees in bytes.

        A file that several jobs share is counted with the newest of them.
        """
        cap = self._settings.max_results_bytes
        freed: dict[str, int] = {}
        if cap is None and not due:
            return freed
        counted: set[tuple[int, int]] = set()
        final = {job.id for job in ended}
        live = [
            folder for folder in _entries(self._assets.root / "jobs") if folder.name not in final
        ]
        total = sum(_measure(folder, counted) for folder in live)
        kept = [job for job in reversed(ended) if job.id not in due]
        for job in kept:
            size = _measure(self._assets.job_dir(job.id), counted)
            total += size
            if cap is not None and total > cap:
                due.add(job.id)
                freed[job.id] = size
        for job in ended:
            if job.id in due and job.id not in freed:
                freed[job.id] = _measure(self._assets.job_dir(job.id), counted)
        return freed

    # Uploads

    def _sweep_assets(self, sweep: Sweep, dry_run: bool) -> None:
        keep_s, cap = self._settings.keep_assets_s, self._settings.max_assets_bytes
        if keep_s is None and cap is None:
            return
        total = self._store.asset_bytes()
        for asset in self._store.idle_assets():
            old = keep_s is not None and asset.used_ms <= self._store.clock() - keep_s * 1000
            if not old and (cap is None or total <= cap):
                continue
            if dry_run or self._assets.drop(asset.id, partial(self._store.delete_idle, asset)):
                total -= asset.size_bytes
                sweep.assets.append(asset.id)
                sweep.bytes += asset.size_bytes

    # Strays

    def _sweep_strays(self, sweep: Sweep, dry_run: bool) -> None:
        known_assets, known_jobs = self._store.known_assets(), self._store.job_ids()
        for path in self._strays(known_assets, known_jobs):
            sweep.stray_files.append(path.relative_to(self._assets.root).as_posix())
            sweep.bytes += _measure(path, set())
            if not dry_run:
                remove_tree(path) if path.is_dir() else path.unlink(missing_ok=True)

    def _strays(self, known_assets: set[str], known_jobs: set[str]) -> Iterator[Path]:
        # What is new may be about to be noted.
        newest_s = time.time() - ASSET_GRACE_MS / 1000
        root = self._assets.root
        for folder in _entries(root / "assets"):
            for path in _entries(folder):
                if f"sha256:{folder.name}{path.name}" not in known_assets and _is_older(
                    path, newest_s
                ):
                    yield path
        for path in _entries(root / "jobs"):
            if path.name not in known_jobs and _is_older(path, newest_s):
                yield path


class Rounds:
    """Cleans up every so often, in a thread of its own."""

    def __init__(
        self, keeper: Keeper, interval_s: float, done: Callable[[int, int, int], None]
    ) -> None:
        self._keeper = keeper
        self._interval_s = interval_s
        self._done = done
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True, name="raykiln-keeper")

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """End after the round under way."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _work(self) -> None:
        while not self._stop.wait(self._interval_s):
            try:
                found = self._keeper.sweep()
                self._done(len(found.jobs), len(found.assets), found.bytes)
            except Exception:
                # The next round may do better.
                get_logger().exception("clean-up not done")


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []


def _is_older(path: Path, than_s: float) -> bool:
    try:
        return path.stat().st_mtime < than_s
    except FileNotFoundError:
        return False


def _measure(path: Path, counted: set[tuple[int, int]]) -> int:
    """Disk space of a file or a folder, without files that are `counted` already."""
    total = 0
    with contextlib.suppress(FileNotFoundError):
        stat = path.lstat()
        place = (stat.st_dev, stat.st_ino)
        if place in counted:
            return 0
        counted.add(place)
        total = stat.st_blocks * 512
        if path.is_dir() and not path.is_symlink():
            with os.scandir(path) as entries:
                for entry in entries:
                    total += _measure(Path(entry.path), counted)
    return total
