"""Uploads by content, and where the scene of a job lies on disk.

The data folder:

    assets.lock                 held while an upload is kept or removed
    lock                        held by the one service that uses the folder
    raykiln.db, -wal, -shm      the database (unless it is elsewhere)
    assets/ab/cdef...           uploads, named by the SHA-256 of their bytes
    bundles/                    assets as folders, ready to load; made anew when needed
    tmp/                        plain uploads under way; emptied at start
    uploads/                    resumable uploads under way; they outlive the service
    jobs/ID/scene.json          an inline scene
    jobs/ID/checkpoint          the film after the last finished pass
    jobs/ID/preview.png         the image so far
    jobs/ID/log.txt             what happened
    jobs/ID/work-TOKEN/         outputs being written by an attempt
    jobs/ID/result-TOKEN/       outputs of the attempt that was committed
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import secrets
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import raykiln as rk
from raykiln.formats import READERS

from raykiln_service.access import LOCAL, Caller
from raykiln_service.bundles import BundleLimits, is_zip, unpack
from raykiln_service.errors import (
    ChecksumError,
    InvalidAssetError,
    InvalidSceneError,
    NotFoundError,
    TooLargeError,
)
from raykiln_service.files import remove_tree, sha256_of, sync_dir, sync_file, write_durably
from raykiln_service.rows import Asset
from raykiln_service.store import Store

SCENE_SUFFIXES = tuple(READERS)
_LOCKS = 64
_MAGIC = ((b"glTF", ".glb"), (b"ply", ".ply"), (b"PK", ".zip"), (b"{", ".json"), (b"<", ".xml"))


@dataclass(frozen=True, slots=True)
class SceneFile:
    """A scene on disk: the file, and the folder that it may read from."""

    path: Path
    base_dir: Path
    alone: bool = False
    """It lies among other things, and reads no other file."""


class Upload:
    """An upload under way; nothing is kept unless `finish` is called."""

    def __init__(self, store: AssetStore, limit_bytes: int, caller: Caller = LOCAL) -> None:
        self._store = store
        self._caller = caller
        self._limit = limit_bytes
        self._path = store.tmp / f"upload-{secrets.token_hex(8)}"
        self._file: BinaryIO = self._path.open("xb")
        self._hash = hashlib.sha256()
        self._size = 0

    def write(self, chunk: bytes) -> None:
        """Take the next bytes; `TooLargeError` past the limit."""
        self._size += len(chunk)
        if self._size > self._limit:
            raise TooLargeError("the upload is too large", accepted=f"at most {self._limit} bytes")
        self._hash.update(chunk)
        self._file.write(chunk)

    def finish(self, filename: str | None, expected: str | None = None) -> Asset:
        """Keep the bytes under their hash, durably, and note them in the database.

        Parameters
        ----------
        expected
            SHA-256 in hex that the sender gave; `ChecksumError` if the bytes have another.
        """
        if self._size == 0:
            raise InvalidAssetError("the upload is empty", accepted="a file of at least one byte")
        name = None if filename is None else safe_filename(filename)
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        digest = self._hash.hexdigest()
        if expected is not None and digest != expected:
            raise ChecksumError(found=digest, accepted=expected)
        self._store.store.check_room(self._caller, self._size, f"sha256:{digest}")
        return self._store.keep_file(self._path, digest, name, self._caller)

    def close(self) -> None:
        """Drop what was not kept."""
        self._file.close()
        self._path.unlink(missing_ok=True)


class AssetStore:
    """Assets and scenes in the data folder."""

    def __init__(self, data_dir: Path, store: Store, limits: BundleLimits) -> None:
        self.store = store
        self.limits = limits
        self.root = data_dir
        self.tmp = data_dir / "tmp"
        self._bundles = data_dir / "bundles"
        # Unpacking may take long: it must not hold up the scenes of others.
        self._locks = [threading.Lock() for _ in range(_LOCKS)]

    def prepare(self) -> None:
        """Make the folders, and drop what an earlier service left unfinished."""
        for folder in (self.tmp, self._bundles):
            remove_tree(folder)
        for name in ("tmp", "bundles", "assets", "jobs"):
            (self.root / name).mkdir(exist_ok=True)
        known = self.store.job_ids()
        for folder in (self.root / "jobs").iterdir():
            if folder.name not in known:
                remove_tree(folder)

    def job_dir(self, job_id: str) -> Path:
        """The folder of a job."""
        return self.root / "jobs" / job_id

    def remove_job(self, job_id: str) -> None:
        """Remove the folder of a job; who still writes its last log line must not bring it back."""
        gone = self.tmp / f"gone-{secrets.token_hex(8)}"
        with suppress(OSError):
            self.job_dir(job_id).rename(gone)
        remove_tree(gone)
        remove_tree(self.job_dir(job_id))

    def path_of(self, asset_id: str) -> Path:
        """Where an asset's bytes lie."""
        digest = asset_id.removeprefix("sha256:")
        return self.root / "assets" / digest[:2] / digest[2:]

    def upload(self, limit_bytes: int, caller: Caller = LOCAL) -> Upload:
        """Begin an upload of at most so many bytes."""
        return Upload(self, limit_bytes, caller)

    def keep_file(
        self, path: Path, digest: str, name: str | None, caller: Caller, *, counted: bool = False
    ) -> Asset:
        """Make an asset of a synced file, which stays where it is for the caller to remove.

        Parameters
        ----------
        counted
            The bytes are part of the caller's stored bytes already.
        """
        place = self.path_of(f"sha256:{digest}")
        size = path.stat().st_size
        with self._no_clean_up():
            if not place.exists():
                if not place.parent.exists():
                    place.parent.mkdir(exist_ok=True)
                    sync_dir(place.parent.parent)
                work = self.tmp / f"asset-{secrets.token_hex(8)}"
                _link(path, work)
                work.chmod(0o444)
                sync_file(work)
                work.replace(place)
                sync_dir(place.parent)
            return self.store.add_asset(f"sha256:{digest}", size, name, caller, counted=counted)

    def drop(self, asset_id: str, commit: Callable[[], bool]) -> bool:
        """Remove an asset's files if `commit` says that its row is gone; whether it did."""
        with self._no_clean_up():
            if not commit():
                return False
            self.path_of(asset_id).unlink(missing_ok=True)
            for folder in self._bundles.glob(asset_id.removeprefix("sha256:") + "*"):
                remove_tree(folder)
        return True

    @contextmanager
    def _no_clean_up(self) -> Iterator[None]:
        """Between the look at an asset's file and the note in the database no one removes it.

        The lock is on a file: `raykiln gc` is a process of its own.
        """
        with (self.root / "assets.lock").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def keep_inline(self, job_id: str, scene: Mapping[str, Any]) -> None:
        """Write the inline scene of a new job."""
        folder = self.job_dir(job_id)
        folder.mkdir()
        write_durably(folder / "scene.json", json.dumps(scene).encode())
        sync_dir(folder.parent)

    def resolve(self, scene: Mapping[str, Any], caller: Caller = LOCAL) -> dict[str, Any]:
        """What a job keeps of a named or uploaded scene: the asset's entry is filled in."""
        if "name" in scene:
            names = rk.bundled_scenes()
            if scene["name"] not in names:
                raise InvalidSceneError(
                    f"there is no bundled scene {scene['name']!r}",
                    pointer="/scene/name",
                    found=str(scene["name"]),
                    accepted=", ".join(sorted(names)),
                )
            return {"name": scene["name"]}
        try:
            asset = self.store.asset(scene["asset"], caller)
            self.store.touch_assets([asset.id])
        except NotFoundError as error:
            raise InvalidSceneError(
                error.detail, pointer="/scene/asset", accepted="the id that an upload answered"
            ) from None
        return {"asset": asset.id, "entry": self._entry(asset, scene.get("entry"))}

    def locate(self, job_id: str, scene: Mapping[str, Any]) -> SceneFile:
        """The file of a resolved scene, unpacked if need be."""
        if scene.get("inline"):
            path = self.job_dir(job_id) / "scene.json"
            return SceneFile(path, path.parent, alone=True)
        if "name" in scene:
            path = rk.bundled_scenes()[scene["name"]]
            return SceneFile(path, path.parent)
        asset = self.store.asset(scene["asset"])
        if self._is_bundle(asset):
            folder = self._unpacked(asset)
        else:
            folder = self._linked(asset, scene["entry"])
        return SceneFile(folder.joinpath(*PurePosixPath(scene["entry"]).parts), folder)

    def key_of(self, scene: Mapping[str, Any], place: SceneFile) -> str:
        """Names a resolved scene by its content: the same name, the same scene."""
        if "asset" in scene:
            # Unpacked anew it is another folder, for which a process has no rights.
            folder = place.base_dir.stat()
            return f"{scene['asset']}/{scene['entry']}/{folder.st_ino}/{folder.st_mtime_ns}"
        if "name" in scene:
            # A file of the installation, which may be exchanged.
            found = place.path.stat()
            return f"{scene['name']}/{found.st_mtime_ns}/{found.st_size}"
        return f"inline/{sha256_of(place.path)}"

    def _entry(self, asset: Asset, entry: str | None) -> str:
        if not self._is_bundle(asset):
            return _single_entry(asset, entry, self.path_of(asset.id))
        folder = self._unpacked(asset)
        files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        scenes = sorted(
            (f for f in files if PurePosixPath(f).suffix.lower() in SCENE_SUFFIXES),
            key=lambda f: (f.count("/"), f),
        )
        if entry is not None and entry in files:
            return entry
        if entry is None and len(scenes) == 1:
            return scenes[0]
        raise InvalidSceneError(
            "the bundle has no such file" if entry else "the bundle's scene file must be named",
            pointer="/scene/entry",
            found=entry,
            accepted=", ".join(scenes[:20]) or f"a bundle with a file {' '.join(SCENE_SUFFIXES)}",
        )

    def _is_bundle(self, asset: Asset) -> bool:
        suffix = PurePosixPath(asset.filename or "").suffix.lower()
        return suffix in ("", ".zip") and is_zip(self.path_of(asset.id))

    def _unpacked(self, asset: Asset) -> Path:
        place = self._bundles / asset.id.removeprefix("sha256:")
        with self._locks[hash(place.name) % _LOCKS]:
            if not place.exists():
                work = self.tmp / f"bundle-{secrets.token_hex(8)}"
                work.mkdir()
                try:
                    unpack(self.path_of(asset.id), work, self.limits)
                    work.replace(place)
                finally:
                    remove_tree(work)
        return place

    def _linked(self, asset: Asset, entry: str) -> Path:
        name_hash = hashlib.sha256(entry.encode()).hexdigest()[:16]
        place = self._bundles / f"{asset.id.removeprefix('sha256:')}-{name_hash}"
        with self._locks[hash(place.name) % _LOCKS]:
            if not place.exists():
                work = self.tmp / f"link-{secrets.token_hex(8)}"
                work.mkdir()
                _link(self.path_of(asset.id), work / entry)
                work.replace(place)
        return place


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        # Not every file system has hard links.
        shutil.copyfile(source, target)


def _single_entry(asset: Asset, entry: str | None, path: Path) -> str:
    name = entry or asset.filename or f"scene{_suffix_of(path)}"
    if PurePosixPath(name).suffix.lower() not in SCENE_SUFFIXES:
        raise InvalidSceneError(
            "the asset's file name does not say which format it has",
            pointer="/scene/entry",
            found=name,
            accepted=f"a name that ends in one of {' '.join(SCENE_SUFFIXES)}, or a zip bundle",
        )
    return safe_filename(name, pointer="/scene/entry")


def _suffix_of(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(256).lstrip(b"\xef\xbb\xbf \t\r\n")
    return next((suffix for magic, suffix in _MAGIC if head.startswith(magic)), "")


def safe_filename(name: str, pointer: str | None = None) -> str:
    """The last part of a path, if it can be a file's name; else `InvalidAssetError`."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    if last in ("", ".", "..") or not last.isprintable() or len(last.encode()) > 200:
        raise InvalidAssetError(
            "the file name is not accepted",
            pointer=pointer,
            found=repr(name[:200]),
            accepted="a printable name of at most 200 bytes",
        )
    return last
