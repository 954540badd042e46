"""The scenes that come with raykiln, and loading by name or path."""

from __future__ import annotations

import json
from pathlib import Path

from raykiln import _core, formats
from raykiln.scene import Scene


def bundled_scenes() -> dict[str, Path]:
    """The bundled scenes: name -> scene file, in the order of their names."""
    files = (f for f in _folder().iterdir() if f.suffix in formats.READERS)
    return {f.stem: f for f in sorted(files)}


def find_scene(scene: str | Path) -> Path:
    """The file of a scene given by path or by bundled name; a file of that name wins."""
    path = Path(scene)
    if path.exists() or path.suffix or len(path.parts) != 1:
        return path
    return bundled_scenes().get(str(scene), path)


def load_scene(
    scene: str | Path, *, base_dir: str | Path | None = None, time_s: float | None = None
) -> Scene:
    """Read a scene file, or a bundled scene by its name.

    Parameters
    ----------
    scene
        A path with one of the known extensions, or a name from `bundled_scenes`.
    base_dir
        Folder that the scene's other files must lie in; default: the folder of the file.
    time_s
        The moment of an animated scene (glTF) to show, in seconds; None = at rest.
        `Scene.time_range_s` says how long the animation is.

    Raises
    ------
    SceneError
        There is no such file, it is damaged, its format is not known, or `time_s` was given for a
        scene that is not animated.
    """
    return formats.load(find_scene(scene), base_dir=base_dir, time_s=time_s)


def heading_of(path: Path) -> tuple[str | None, str | None]:
    """Name and description of a scene file; one in the native format is not built for it."""
    if path.suffix == ".json":
        data = json.loads(path.read_bytes())
        return data.get("name"), data.get("description")
    scene = load_scene(path)
    return scene.name, scene.description


def _folder() -> Path:
    # Installed: beside the compiled module. From a checkout: at its root.
    installed = Path(_core.__file__).parent / "scenes"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "scenes"
