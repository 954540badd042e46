"""Reading files for a format: inside one folder, below a size, and never by an absolute path."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from raykiln.errors import SceneError, scene_error_of

if TYPE_CHECKING:
    from raykiln.scene import Scene

MAX_FILE_BYTES = 1 << 33
MAX_TEXT_BYTES = 1 << 29


class Files:
    """The files that a scene file may read.

    Parameters
    ----------
    scene_file
        The file that names the others; they are found beside it.
    base_dir
        Folder that nothing may be read outside of; default: the folder of `scene_file`.
    time_s
        The moment at which an animated scene is read; None = at rest.
    """

    def __init__(
        self, scene_file: Path, base_dir: Path | None = None, *, time_s: float | None = None
    ) -> None:
        if time_s is not None and not math.isfinite(time_s):
            raise SceneError("not a time", found=time_s, accepted="a finite number of seconds")
        self.time_s = time_s
        self.scene_file = scene_file
        self.folder = scene_file.resolve().parent
        self.root = self.folder if base_dir is None else Path(base_dir).resolve()
        self.used: set[Path] = set()
        """The files that were resolved so far."""
        if not self.folder.is_relative_to(self.root):
            raise SceneError("the scene file lies outside the base folder", file=scene_file)

    def resolve(self, name: str, pointer: str | None = None, *, folder: Path | None = None) -> Path:
        """The existing file that a relative name means; symlinks are followed and checked."""
        if not name or "\0" in name or len(name) > 4096:
            raise self._refusal("not a file name", name, pointer)
        if "://" in name or name.startswith(("file:", "data:", "http:", "https:")):
            raise self._refusal(
                "a file must be named by a relative path, not by a URI", name, pointer
            )
        portable = name.replace("\\", "/")
        if PurePosixPath(portable).is_absolute() or portable[1:2] == ":":
            raise self._refusal("an absolute path is not accepted", name, pointer)
        try:
            path = ((folder or self.folder) / portable).resolve()
        except (OSError, RuntimeError):
            raise self._refusal("the path cannot be followed", name, pointer) from None
        if not path.is_relative_to(self.root):
            raise self._refusal("the path leads out of the scene's folder", name, pointer)
        if not path.is_file():
            raise SceneError(
                "the file does not exist" if not path.exists() else "not a regular file",
                file=self.scene_file,
                pointer=pointer,
                found=name,
            )
        self.used.add(path)
        return path

    def resolve_uri(self, uri: str, pointer: str | None = None) -> Path:
        """Like `resolve`, for a percent-encoded relative reference (as in glTF)."""
        return self.resolve(unquote(uri), pointer)

    def relative(self, path: Path) -> str:
        """A resolved path as the scene names it: relative to the base folder."""
        return path.relative_to(self.root).as_posix()

    def read(self, path: Path, *, limit: int = MAX_FILE_BYTES) -> bytes:
        """The bytes of a resolved file."""
        return read_bytes(path, limit=limit)

    def _refusal(self, message: str, name: str, pointer: str | None) -> SceneError:
        accepted = "a relative path inside the scene's folder"
        return SceneError(
            message, file=self.scene_file, pointer=pointer, found=name, accepted=accepted
        )


def read_bytes(path: Path, *, limit: int = MAX_FILE_BYTES) -> bytes:
    """The bytes of a file of at most `limit` bytes; a `SceneError` if it cannot be read."""
    with _opened(path, limit) as (file, size):
        # Reading takes as much memory at once as it is told to.
        return file.read(limit + 1 if size is None else size)


def read_array(path: Path, *, limit: int = MAX_FILE_BYTES) -> NDArray[np.uint8]:
    """Like `read_bytes`, as an array (n,) that may be written to."""
    with _opened(path, limit) as (file, size):
        if size is None:
            return np.frombuffer(bytearray(file.read(limit + 1)), np.uint8)
        data = np.empty(size, np.uint8)
        return data[: file.readinto(data.data)]


@contextmanager
def _opened(path: Path, limit: int) -> Iterator[tuple[BufferedReader, int | None]]:
    """A file, and its size in bytes if that is known."""
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if status.st_size > limit:
                raise SceneError(
                    f"the file has {status.st_size} bytes; the limit is {limit}", file=path
                )
            yield file, status.st_size if stat.S_ISREG(status.st_mode) else None
    except FileNotFoundError:
        raise SceneError("the file does not exist", file=path) from None
    except IsADirectoryError:
        raise SceneError("a folder, not a file", file=path) from None
    except OSError as error:
        raise SceneError(f"the file cannot be read: {error.strerror}", file=path) from None


@contextmanager
def scene_errors(path: object) -> Iterator[None]:
    """Turn whatever a broken file makes a reader raise into a `SceneError` that names the file."""
    try:
        yield
    except SceneError as error:
        raise error.in_file(path) from None
    except ValidationError as error:
        raise scene_error_of(error, file=path) from None
    except RecursionError:
        raise SceneError("the file is nested too deeply", file=path) from None
    except MemoryError:
        raise SceneError("the file asks for more memory than there is", file=path) from None
    except UnicodeDecodeError as error:
        raise SceneError(f"not text in {error.encoding}", file=path) from None
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        text = f"{type(error).__name__}: {error}"
        raise SceneError(f"the file is damaged ({text})", file=path) from None


Reader = Callable[[Path, Files], "Scene"]
