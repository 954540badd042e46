"""The one folder that a confined child may write in, and what is carried from and to it.

A child cannot be given the folder of another job later on, since its rights only shrink.  So it
keeps its desk for life, and the supervisor carries: the checkpoint there, and what was made away.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from raykiln_service.files import remove_tree, sync_dir, sync_file

# Where a link cannot be made, a copy can. A file that its writer replaces between the look-up of
# its name and the link is "not found"; opened, it stays.
_COPIED = (errno.EXDEV, errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK, errno.ENOENT)
_OUTPUT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,150}")


class Desk:
    """A folder with `out/` for outputs, `checkpoint` and `preview.png`."""

    def __init__(self, root: Path) -> None:
        self.path = root / f"desk-{secrets.token_hex(8)}"
        self.out = self.path / "out"
        self.checkpoint = self.path / "checkpoint"
        self.preview = self.path / "preview.png"
        self._carried: tuple[int, int] | None = None
        self.path.mkdir(mode=0o700, parents=True)

    def clear(self) -> None:
        """Take everything off it."""
        for left in self.path.iterdir():
            if left.is_dir() and not left.is_symlink():
                remove_tree(left)
            else:
                left.unlink(missing_ok=True)

    def lay_out(self, checkpoint: Path) -> None:
        """Clear it, and put a task's checkpoint on it if there is one."""
        self.clear()
        self.out.mkdir()
        if checkpoint.exists():
            _put(checkpoint, self.checkpoint, _link)
        self._carried = self._version()

    def take_checkpoint(self, place: Path) -> bool:
        """Carry a checkpoint away, durably, if there is a new one."""
        version = self._version()
        if version is None or version == self._carried:
            return False
        _put(self.checkpoint, place, _link, durably=True)
        sync_dir(place.parent)
        self._carried = version
        return True

    def take_preview(self, place: Path) -> bool:
        """Carry the preview away."""
        if not _is_file(self.preview):
            return False
        _put(self.preview, place, os.replace)
        return True

    def take_outputs(self, folder: Path) -> None:
        """Carry the finished outputs away; anything but plain files stays."""
        with suppress(FileNotFoundError):
            for path in sorted(self.out.iterdir()):
                # A temporary name, with a dot in front, is a file that was not finished.
                if _OUTPUT.fullmatch(path.name) and _is_file(path):
                    _put(path, folder / path.name, os.replace)

    def remove(self) -> None:
        """Remove it."""
        remove_tree(self.path)

    def _version(self) -> tuple[int, int] | None:
        try:
            found = self.checkpoint.lstat()
        except OSError:
            return None
        return (found.st_ino, found.st_mtime_ns) if stat.S_ISREG(found.st_mode) else None


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _link(source: Path, target: Path) -> None:
    os.link(source, target, follow_symlinks=False)


def _put(
    source: Path, place: Path, way: Callable[[Path, Path], object], *, durably: bool = False
) -> None:
    """Make `place` the file `source` at once: `way` if the file systems allow, else a copy."""
    temporary = place.with_name(f".{place.name}.{secrets.token_hex(6)}")
    try:
        try:
            way(source, temporary)
        except OSError as error:
            if error.errno not in _COPIED:
                raise
            shutil.copyfile(source, temporary, follow_symlinks=False)
        if durably:
            sync_file(temporary)
        temporary.replace(place)
    finally:
        # It is still there after a failure, and where `place` was the same file before.
        temporary.unlink(missing_ok=True)
