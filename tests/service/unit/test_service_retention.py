"""Clean-ups: what goes, and above all what stays."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from raykiln_service.access import LOCAL
from raykiln_service.assets import AssetStore
from raykiln_service.bundles import BundleLimits
from raykiln_service.cache import ResultCache
from raykiln_service.jobs import JobSpec
from raykiln_service.retention import Keeper, Sweep
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.store_queue import Traits
from raykiln_service.store_retention import ASSET_GRACE_MS

HOUR_MS = 3_600_000
ERROR = {"reason": "crashed", "detail": "it broke"}


class Folder:
    """A data folder with jobs and uploads in it."""

    def __init__(self, root: Path, store: Store, clock: Any) -> None:
        self.store = store
        self.clock = clock
        self.assets = AssetStore(root, store, BundleLimits(1 << 20, 10, 100))
        self.assets.prepare()
        self.forgotten: list[str] = []

    def upload(self, data: bytes) -> str:
        upload = self.assets.upload(1 << 20)
        upload.write(data)
        asset = upload.finish("scene.json")
        upload.close()
        return asset.id

    def job(
        self, job_id: str, *, size: int = 4096, asset: str | None = None, key: str = ""
    ) -> None:
        scene = {"name": "cornell_box"} if asset is None else {"asset": asset, "entry": "s.json"}
        traits = Traits(cache_key=key or None)
        self.store.create_job(job_id, JobSpec(scene, {}), traits=traits)
        folder = self.assets.job_dir(job_id)
        (folder / "result-x").mkdir(parents=True)
        (folder / "result-x" / "image.exr").write_bytes(os.urandom(size))

    def end(self, job_id: str) -> None:
        job = self.store.claim("me", 30.0)
        assert job is not None
        assert job.id == job_id
        assert job.lease is not None
        self.store.succeed(job.lease, {"dir": "result-x", "files": []})

    def ended(self, job_id: str, **options: Any) -> None:
        self.job(job_id, **options)
        self.end(job_id)

    def sweep(self, *, dry_run: bool = False, **limits: Any) -> Sweep:
        settings = ServiceSettings.create(data_dir=self.assets.root, **limits)
        keeper = Keeper(self.store, self.assets, settings, self.forgotten.append)
        return keeper.sweep(dry_run=dry_run)

    def left(self) -> set[str]:
        return self.store.job_ids()


@pytest.fixture
def folder(tmp_path: Path, store: Store, clock: Any) -> Folder:
    return Folder(tmp_path / "data", store, clock)


@pytest.fixture(autouse=True)
def _data(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()


def test_nothing_goes_without_a_limit(folder: Folder) -> None:
    folder.upload(b"idle")
    folder.ended("a")
    folder.clock.ms += 10_000 * HOUR_MS
    assert folder.sweep() == Sweep()
    assert folder.left() == {"a"}


def test_old_results_go_and_younger_and_live_ones_stay(folder: Folder) -> None:
    folder.ended("old")
    folder.clock.ms += HOUR_MS
    folder.ended("young")
    folder.job("running")
    claimed = folder.store.claim("me", 30.0)
    folder.job("queued")
    folder.clock.ms += HOUR_MS
    preview = folder.sweep(keep_results_s=7200, dry_run=True)
    assert folder.left() == {"old", "young", "running", "queued"}
    found = folder.sweep(keep_results_s=7200)
    assert found == preview
    assert (found.jobs, folder.forgotten) == (["old"], ["old"])
    assert found.bytes >= 4096
    assert folder.left() == {"young", "running", "queued"}
    assert not folder.assets.job_dir("old").exists()
    folder.clock.ms += 1000 * HOUR_MS
    assert folder.sweep(keep_results_s=0).jobs == ["young"]
    assert claimed is not None
    assert folder.left() == {"running", "queued"}


def test_a_retried_job_is_live_again(folder: Folder) -> None:
    folder.job("a")
    job = folder.store.claim("me", 30.0)
    assert job is not None
    assert job.lease is not None
    folder.store.fail(job.lease, ERROR)
    seen = folder.store.ended_jobs()[0]
    folder.store.retry("a")
    assert not folder.store.delete_ended(seen)
    assert folder.sweep(keep_results_s=0).jobs == []


def test_the_oldest_go_when_there_is_too_much(folder: Folder) -> None:
    for name in ("a", "b", "c"):
        folder.ended(name, size=100_000)
        folder.clock.ms += 1
    folder.job("live", size=100_000)
    assert folder.sweep(max_results_bytes=450_000).jobs == []
    found = folder.sweep(max_results_bytes=350_000)
    assert found.jobs == ["a"]
    assert 100_000 <= found.bytes <= 120_000
    # Live jobs count, and stay even if they alone are too much.
    assert folder.sweep(max_results_bytes=1).jobs == ["b", "c"]
    assert folder.left() == {"live"}


def test_what_jobs_share_counts_once_and_stays_for_the_others(folder: Folder) -> None:
    folder.ended("first", size=200_000, key="k")
    folder.clock.ms += HOUR_MS
    answer = ResultCache(folder.store, folder.assets).answer("second", "k")
    assert answer is not None
    folder.store.create_job("second", JobSpec({"name": "x"}, {}), answer=answer)
    assert folder.sweep(max_results_bytes=250_000).jobs == []
    found = folder.sweep(keep_results_s=3600)
    assert found.jobs == ["first"]
    assert found.bytes < 100_000
    kept = folder.assets.job_dir("second") / answer["dir"] / "image.exr"
    assert kept.stat().st_size == 200_000


def test_uploads_go_once_no_job_refers_to_them(folder: Folder) -> None:
    used, idle = folder.upload(b"used"), folder.upload(b"idle")
    folder.ended("a", asset=used)
    folder.clock.ms += HOUR_MS
    found = folder.sweep(keep_assets_s=3600)
    assert found.assets == [idle]
    assert not folder.assets.path_of(idle).exists()
    assert folder.assets.path_of(used).read_bytes() == b"used"
    folder.store.delete("a")
    assert folder.sweep(keep_assets_s=3600).assets == [used]


@pytest.mark.parametrize(
    "use",
    [
        lambda folder, asset: folder.upload(b"idle"),
        lambda folder, asset: folder.assets.resolve({"asset": asset, "entry": "s.json"}),
        lambda folder, asset: folder.store.missing_assets([asset], LOCAL),
    ],
    ids=["uploaded again", "about to be rendered", "asked for"],
)
def test_an_upload_that_was_just_used_stays(
    folder: Folder, use: Callable[[Folder, str], object]
) -> None:
    asset = folder.upload(b"idle")
    folder.clock.ms += HOUR_MS
    seen = folder.store.idle_assets()[0]
    use(folder, asset)
    assert not folder.store.delete_idle(seen)
    assert folder.sweep(keep_assets_s=0, max_assets_bytes=0).assets == []
    folder.clock.ms += ASSET_GRACE_MS + 1
    assert folder.sweep(keep_assets_s=0).assets == [asset]


def test_the_least_recently_used_uploads_go_when_there_is_too_much(folder: Folder) -> None:
    assets = []
    for i in range(4):
        assets.append(folder.upload(bytes([65 + i]) * 1000))
        folder.clock.ms += HOUR_MS
    folder.ended("a", asset=assets[0])
    assert folder.sweep(max_assets_bytes=2500).assets == assets[1:3]
    # The one that is used is over the cap by itself, and stays.
    assert folder.sweep(max_assets_bytes=0).assets == [assets[3]]
    assert folder.assets.path_of(assets[0]).exists()


def test_the_same_bytes_can_come_again(folder: Folder) -> None:
    asset = folder.upload(b"again")
    folder.clock.ms += HOUR_MS
    assert folder.sweep(keep_assets_s=0).assets == [asset]
    assert folder.upload(b"again") == asset
    assert folder.assets.path_of(asset).read_bytes() == b"again"


def test_what_a_crash_left_behind_goes_when_it_is_old(folder: Folder) -> None:
    root = folder.assets.root
    stray = root / "assets" / "ab" / "cdef"
    stray.parent.mkdir()
    stray.write_bytes(b"x")
    lost = root / "jobs" / "job-lost"
    lost.mkdir()
    assert folder.sweep().stray_files == []
    for path in (stray, lost):
        os.utime(path, (1, 1))
    assert folder.sweep().stray_files == ["assets/ab/cdef", "jobs/job-lost"]
    assert not stray.exists()
    assert not lost.exists()


def test_a_removal_that_breaks_off_half_way_is_finished_later(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.ended("a")
    folder.clock.ms += HOUR_MS

    def broken(_job_id: str) -> None:
        raise OSError("half-way")

    with monkeypatch.context() as patch:
        patch.setattr(folder.assets, "remove_job", broken)
        with pytest.raises(OSError, match="half-way"):
            folder.sweep(keep_results_s=0)
    assert folder.left() == set()
    os.utime(folder.assets.job_dir("a"), (1, 1))
    assert folder.sweep().stray_files == ["jobs/a"]
    assert not folder.assets.job_dir("a").exists()


def test_a_last_line_of_a_log_brings_no_folder_back(folder: Folder) -> None:
    folder.job("a")
    log = folder.assets.job_dir("a") / "log.txt"
    stop = threading.Event()

    def write() -> None:
        while not stop.is_set():
            with suppress(FileNotFoundError), log.open("a") as file:
                file.write("ends\n")

    writer = threading.Thread(target=write)
    writer.start()
    try:
        while not log.exists():
            pass
        folder.assets.remove_job("a")
        assert not log.parent.exists()
    finally:
        stop.set()
        writer.join()
    assert list(folder.assets.tmp.iterdir()) == []
