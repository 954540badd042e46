"""What the steps of compiling share: the scene, the core's scene, and where files may lie."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln import _core
from raykiln.errors import ImageError, SceneError
from raykiln.image import read_image
from raykiln.image.ahead import reading_ahead
from raykiln.scene import EnvironmentLight, ImageTexture, Scene

Rgb = tuple[float, float, float]


class Build:
    """A scene on its way into the core."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.core = _core.Scene()
        self.warnings: list[str] = []
        self.files_read: list[Path] = []
        self._read: Callable[[Path], NDArray[Any]] = read_image

    @contextmanager
    def reading_images(self) -> Iterator[None]:
        """Within this, the image files of the scene are read by several threads."""
        files: dict[Path, Path] = {}
        for node in (*self.scene.textures.values(), *self.scene.lights):
            if isinstance(node, ImageTexture | EnvironmentLight) and node.file is not None:
                with suppress(SceneError):  # raised again when the image is asked for
                    path = self._path(node.file, "")
                    files[path] = path
        with reading_ahead(files) as self._read:
            yield
        self._read = read_image

    def image(self, node: ImageTexture | EnvironmentLight, pointer: str) -> NDArray[Any]:
        if node.pixels is not None:
            return node.pixels
        assert node.file is not None
        path = self._path(node.file, f"{pointer}/file")
        self.files_read.append(path)
        try:
            return np.ascontiguousarray(self._read(path))
        except ImageError as error:
            raise SceneError(str(error), pointer=f"{pointer}/file", found=node.file) from None

    def _path(self, file: str, pointer: str) -> Path:
        root = (self.scene.base_dir or Path.cwd()).resolve()
        path = (root / file).resolve()
        if not path.is_relative_to(root):
            raise SceneError(
                "a file outside the scene's folder",
                pointer=pointer,
                found=file,
                accepted="a relative path inside it",
            )
        if not path.is_file():
            raise SceneError("the file does not exist", pointer=pointer, found=file)
        return path


def rgb_of(value: float | Rgb) -> Rgb:
    """A colour given as one number or three."""
    if isinstance(value, tuple):
        return value
    return (value, value, value)


def names_of(entries: Iterable[str]) -> str:
    """The first names of a table, for an error message."""
    return ", ".join(sorted(entries)[:20]) or "none are defined"
