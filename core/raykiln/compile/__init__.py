"""From a scene description to a scene of the core: references resolved, images read, BVH built."""

from __future__ import annotations

import copy
import hashlib
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from raykiln import _core, studio
from raykiln.compile.build import Build
from raykiln.compile.lights import add_light, set_camera
from raykiln.compile.materials import Materials
from raykiln.compile.shapes import Shapes
from raykiln.compile.textures import Textures
from raykiln.errors import SceneError
from raykiln.scene import Camera, Scene
from raykiln.settings import RenderSettings

__all__ = ["CompiledScene", "PreparedScene", "compile_scene", "prepare", "scene_sha256"]


class CompiledScene(NamedTuple):
    """A scene that is ready to render by one camera."""

    core: _core.Scene
    sha256: str
    warnings: list[str]
    load_s: float
    """Reading images, transforming, handing over."""
    bvh_s: float
    """Building the hierarchies and the tables of the lights."""
    warm: bool = False
    """All that was done before, for an earlier render."""


class PreparedScene:
    """A scene in memory, built once, that any number of renders can start from at once.

    Made by `prepare`; `render` takes it in place of a `Scene`, and gives the same bits. Later
    changes of the `Scene` it was made from do not show. Not for use by two threads at a time.

    Attributes
    ----------
    scene
        As it was prepared.
    sha256
        Hash of all that the scene says.
    load_s, bvh_s
        What preparing took, in seconds.
    """

    def __init__(self, scene: Scene, build: Build, load_s: float, bvh_s: float) -> None:
        self.scene = scene
        self.load_s = load_s
        self.bvh_s = bvh_s
        self._build = build
        self._digests = _digests(build.scene, build.files_read)
        self.sha256 = _combined(self._digests)

    @property
    def memory_bytes(self) -> int:
        """Of the bounding volume hierarchies."""
        return self._build.core.memory_bytes

    def with_camera(self, camera: Camera) -> PreparedScene:
        """The scene as `Scene.set_camera` makes it, without building it again.

        A scene without any light is built again: its studio light stands by its camera.
        """
        scene = self.scene.model_copy()
        scene.set_camera(camera)
        if not studio.has_light(scene):
            return prepare(scene)
        other = copy.copy(self)
        other.scene = scene
        other._build = copy.copy(self._build)
        other._build.scene = _completed(scene)
        other._digests = {**self._digests, **_digests(other._build.scene, only={"cameras"})}
        other.sha256 = _combined(other._digests)
        return other

    def view(self, settings: RenderSettings) -> CompiledScene:
        """The scene by the camera and shape of image that the settings name."""
        set_camera(self._build, settings)
        build = self._build
        warnings = [*build.scene.warnings, *build.warnings]
        return CompiledScene(build.core, self.sha256, warnings, 0.0, 0.0, warm=True)


def prepare(scene: Scene) -> PreparedScene:
    """Check a scene wholly and build it, to render it more than once.

    Raises
    ------
    SceneError
        Names the first bad place.
    """
    return _prepared(scene, Build(_completed(scene)), time.perf_counter())


def compile_scene(scene: Scene, settings: RenderSettings) -> CompiledScene:
    """Check a scene wholly and build it; raises `SceneError` at the first bad place."""
    start = time.perf_counter()
    _check_not_empty(scene)
    build = Build(_completed(scene))
    set_camera(build, settings)
    prepared = _prepared(scene, build, start)
    return prepared.view(settings)._replace(
        load_s=prepared.load_s, bvh_s=prepared.bvh_s, warm=False
    )


def _prepared(scene: Scene, build: Build, start: float) -> PreparedScene:
    _check_not_empty(scene)
    _add_parts(build)
    loaded = time.perf_counter()
    build.core.build()
    kept = scene.model_copy(update={"settings": dict(scene.settings)})
    return PreparedScene(kept, build, loaded - start, time.perf_counter() - loaded)


def _check_not_empty(scene: Scene) -> None:
    if not scene.shapes:
        raise SceneError("the scene is empty", pointer="/shapes", accepted="at least one shape")


def _completed(scene: Scene) -> Scene:
    """The scene with a camera and lights; one from a file has them, one made in code may not."""
    lists = ("cameras", "lights", "warnings")
    completed = scene.model_copy(update={name: list(getattr(scene, name)) for name in lists})
    studio.complete(completed)
    return completed


def _add_parts(build: Build) -> None:
    with build.reading_images():
        textures = Textures(build)
        materials = Materials(build, textures)
        for name in build.scene.textures:
            # Also those that nothing uses: a missing file is an error all the same.
            textures.index(name, color=False, pointer=f"/textures/{name}")
        Shapes(build, textures, materials).add_all()
        for i, light in enumerate(build.scene.lights):
            add_light(build, light, f"/lights/{i}")


def scene_sha256(scene: Scene, files: Iterable[Path] = ()) -> str:
    """SHA-256 of all that the scene says, arrays and image files included."""
    return _combined(_digests(scene, files))


def _digests(
    scene: Scene, files: Iterable[Path] = (), only: set[str] | None = None
) -> dict[str, bytes]:
    """Hashes of the parts of a scene, so that a change of one does not hash all others again."""
    unsaid = {"base_dir", "warnings", "time_range_s", "settings"}
    digests = {}
    for name, value in scene.model_dump(include=only, exclude=unsaid).items():
        digest = hashlib.sha256()
        _hash_value(digest, value)
        digests[name] = digest.digest()
    if only is None:
        # No field is named so.
        names = sorted(set(files))
        digests["(files)"] = b"".join(hashlib.sha256(f.read_bytes()).digest() for f in names)
    return digests


def _combined(digests: dict[str, bytes]) -> str:
    digest = hashlib.sha256()
    _hash_value(digest, {name: value.hex() for name, value in digests.items()})
    return digest.hexdigest()


def _hash_value(digest: Any, value: Any) -> None:
    # Each kind of value opens with its own mark, so that no two scenes spell the same bytes.
    if isinstance(value, dict):
        digest.update(b"{%d" % len(value))
        for key, item in value.items():
            _hash_value(digest, key)
            _hash_value(digest, item)
    elif isinstance(value, list | tuple):
        digest.update(b"[%d" % len(value))
        for item in value:
            _hash_value(digest, item)
    elif isinstance(value, np.ndarray):
        digest.update(f"a{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).data)
    else:
        text = repr(value).encode()
        digest.update(b"v%d:" % len(text) + text)
