"""Packing a scene for upload: one file as it is, or a zip of all that the scene reads."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

MAX_BUNDLE_BYTES = 8 << 30
_TEXT = {".gltf", ".json", ".mtl", ".obj", ".ply", ".stl", ".xml"}
# A fixed date: the same files give the same archive, so they are stored once.
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Package:
    """What to upload."""

    path: Path
    """The scene file, or an archive."""
    entry: str
    """The scene file's name in it."""


@contextmanager
def package(scene: Path, base_dir: Path | None = None) -> Iterator[Package]:
    """The upload for a scene file; an archive is removed afterwards.

    Raises
    ------
    SceneError
        The scene cannot be read, or refers to files that are not there.
    ValueError
        The files are too large for one bundle.
    """
    from raykiln.formats import side_files

    others = side_files(scene, base_dir=base_dir)
    if not others:
        yield Package(scene, scene.name)
        return
    root = (base_dir or scene.parent).resolve()
    files = sorted({scene.resolve(), *others})
    total = sum(file.stat().st_size for file in files)
    if total > MAX_BUNDLE_BYTES:
        raise ValueError(
            f"{scene}: the scene and its {len(others)} files are too large to upload "
            f"(found {total} bytes); accepted: at most {MAX_BUNDLE_BYTES} bytes"
        )
    with tempfile.TemporaryDirectory(prefix="raykiln-") as folder:
        archive = Path(folder) / f"{scene.stem}.zip"
        _write_archive(archive, root, files)
        yield Package(archive, scene.resolve().relative_to(root).as_posix())


def _write_archive(archive: Path, root: Path, files: list[Path]) -> None:
    with zipfile.ZipFile(archive, "w") as bundle:
        for file in files:
            info = zipfile.ZipInfo(file.relative_to(root).as_posix(), _DATE)
            info.external_attr = 0o100644 << 16
            # Images and buffers hardly shrink, so only text is worth the time.
            text = file.suffix.lower() in _TEXT
            info.compress_type = zipfile.ZIP_DEFLATED if text else zipfile.ZIP_STORED
            info.file_size = file.stat().st_size
            with file.open("rb") as source, bundle.open(info, "w") as target:
                shutil.copyfileobj(source, target, 1 << 20)
