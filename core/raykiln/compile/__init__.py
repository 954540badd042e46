"""From a scene description to a scene of the core: references resolved, images read, BVH built."""

from __future__ import annotations

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
from raykiln.scene import Scene
from raykiln.settings import RenderSettings

__all__ = ["CompiledScene", "compile_scene", "scene_sha256"]


class CompiledScene(NamedTuple):
    """A scene that is ready to render."""

    core: _core.Scene
    sha256: str
    warnings: list[str]
    load_s: float
    """Reading images, transforming, handing over."""
    bvh_s: float
    """Building the hierarchies and the tables of the lights."""


def compile_scene(scene: Scene, settings: RenderSettings) -> CompiledScene:
    """Check a scene wholly and build it; raises `SceneError` at the first bad place."""
    start = time.perf_counter()
    if not scene.shapes:
        raise SceneError("the scene is empty", pointer="/shapes", accepted="at least one shape")
    build = Build(_completed(scene))
    _add_parts(build, settings)
    loaded = time.perf_counter()
    build.core.build()
    return CompiledScene(
        build.core,
        scene_sha256(build.scene, build.files_read),
        [*build.scene.warnings, *build.warnings],
        loaded - start,
        time.perf_counter() - loaded,
    )


def _completed(scene: Scene) -> Scene:
    """The scene with a camera and lights; one from a file has them, one made in code may not."""
    lists = ("cameras", "lights", "warnings")
    copy = scene.model_copy(update={name: list(getattr(scene, name)) for name in lists})
    studio.complete(copy)
    return copy


def _add_parts(build: Build, settings: RenderSettings) -> None:
    set_camera(build, settings)
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
    digest = hashlib.sha256()
    _hash_value(digest, scene.model_dump(exclude={"base_dir", "warnings", "settings"}))
    for path in sorted(set(files)):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
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
