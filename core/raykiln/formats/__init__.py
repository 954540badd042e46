"""Scene files: the one registry of formats.

`load` picks the reader by the extension, then gives the scene a camera and lights if it has none.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.files import Files, Reader, scene_errors
from raykiln.scene import Scene
from raykiln.studio import complete

# Extension -> module of this package with `read(path, files) -> Scene`.
READERS = {
    ".json": "native",
    ".gltf": "gltf",
    ".glb": "gltf",
    ".xml": "mitsuba",
    ".obj": "obj",
    ".ply": "ply",
    ".stl": "stl",
}
PLANNED = (".usd", ".usda", ".usdc", ".usdz", ".pbrt")


def load(
    path: str | Path, *, base_dir: str | Path | None = None, time_s: float | None = None
) -> Scene:
    """Read a scene file of any supported format.

    Parameters
    ----------
    path
        The file; its extension says the format.
    base_dir
        Folder that the scene's other files must lie in; default: the folder of `path`.
    time_s
        The moment of an animated scene to read it at; None = at rest.

    Returns
    -------
    Scene
        Validated; meshes are arrays; image textures that are files exist.  What the file asks for
        and is not supported, and what was added (a camera, lights), is in `Scene.warnings`.

    Raises
    ------
    SceneError
        The file does not exist, is damaged, or is of no supported format; or it has no animation
        and `time_s` was given.
    """
    return _load(Path(path), None if base_dir is None else Path(base_dir), time_s)[0]


def side_files(path: str | Path, *, base_dir: str | Path | None = None) -> set[Path]:
    """The other files (resolved) that loading a scene file needs; raises as `load` does."""
    files = _load(Path(path), None if base_dir is None else Path(base_dir))[1]
    return files.used - {Path(path).resolve()}


def _load(path: Path, base_dir: Path | None, time_s: float | None = None) -> tuple[Scene, Files]:
    read = reader_of(path)
    if not path.is_file():
        what = "a folder, not a file" if path.is_dir() else "the file does not exist"
        raise SceneError(what, file=path)
    # Numbers out of the range of float32 become infinite, and those are refused by name.
    with scene_errors(path), np.errstate(over="ignore", invalid="ignore"):
        files = Files(path, base_dir, time_s=time_s)
        scene = read(path, files)
        if time_s is not None and scene.time_range_s is None:
            raise SceneError("the scene has no animation, so it is at no time", found=time_s)
        scene.base_dir = files.root
        complete(scene)
    return scene, files


def reader_of(path: Path) -> Reader:
    """The reader for a file's extension."""
    extension = path.suffix.lower()
    if extension in READERS:
        read: Reader = import_module(f"raykiln.formats.{READERS[extension]}").read
        return read
    reason = "not yet supported" if extension in PLANNED else "not a known scene format"
    raise SceneError(
        f"{extension or 'a file without an extension'} is {reason}",
        file=path,
        accepted=" ".join(READERS),
    )
