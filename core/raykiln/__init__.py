"""raykiln: a path tracer for pipelines.

>>> import raykiln as rk
>>> scene = rk.load_scene("cornell_box")
>>> result = rk.render(scene, rk.RenderSettings(width=64, height=64, spp=4))
>>> result.image.shape
(64, 64, 3)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from raykiln._core import __version__

if TYPE_CHECKING:
    from raykiln.bundled import bundled_scenes, load_scene
    from raykiln.compile import PreparedScene, prepare
    from raykiln.errors import ImageError, RaykilnError, RenderError, SceneError, SettingsError
    from raykiln.frames import turntable
    from raykiln.rendering import Progress, SceneReport, check, render
    from raykiln.result import RenderResult, RenderStats
    from raykiln.scene import (
        CheckerTexture,
        Conductor,
        ConstantLight,
        Cube,
        Dielectric,
        Diffuse,
        DirectionalLight,
        Disk,
        Emission,
        EnvironmentLight,
        ImageTexture,
        Instance,
        LookAt,
        Mesh,
        NormalMap,
        PerspectiveCamera,
        Plastic,
        PointLight,
        Principled,
        Rectangle,
        Scene,
        Sphere,
        SpotLight,
        TextureRef,
    )
    from raykiln.settings import RenderSettings

__all__ = [
    "CheckerTexture",
    "Conductor",
    "ConstantLight",
    "Cube",
    "Dielectric",
    "Diffuse",
    "DirectionalLight",
    "Disk",
    "Emission",
    "EnvironmentLight",
    "ImageError",
    "ImageTexture",
    "Instance",
    "LookAt",
    "Mesh",
    "NormalMap",
    "PerspectiveCamera",
    "Plastic",
    "PointLight",
    "PreparedScene",
    "Principled",
    "Progress",
    "RaykilnError",
    "Rectangle",
    "RenderError",
    "RenderResult",
    "RenderSettings",
    "RenderStats",
    "Scene",
    "SceneError",
    "SceneReport",
    "SettingsError",
    "Sphere",
    "SpotLight",
    "TextureRef",
    "__version__",
    "bundled_scenes",
    "check",
    "load_scene",
    "prepare",
    "render",
    "turntable",
]

# Where the names are: each is imported when it is first used, so that `import raykiln` does not
# wait for what a program may never ask for.
_NAMES = {
    "raykiln.bundled": ("bundled_scenes", "load_scene"),
    "raykiln.compile": ("PreparedScene", "prepare"),
    "raykiln.errors": ("ImageError", "RaykilnError", "RenderError", "SceneError", "SettingsError"),
    "raykiln.frames": ("turntable",),
    "raykiln.rendering": ("Progress", "SceneReport", "check", "render"),
    "raykiln.result": ("RenderResult", "RenderStats"),
    "raykiln.scene": (
        "CheckerTexture",
        "Conductor",
        "ConstantLight",
        "Cube",
        "Dielectric",
        "Diffuse",
        "DirectionalLight",
        "Disk",
        "Emission",
        "EnvironmentLight",
        "ImageTexture",
        "Instance",
        "LookAt",
        "Mesh",
        "NormalMap",
        "PerspectiveCamera",
        "Plastic",
        "PointLight",
        "Principled",
        "Rectangle",
        "Scene",
        "Sphere",
        "SpotLight",
        "TextureRef",
    ),
    "raykiln.settings": ("RenderSettings",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
_SUBMODULES = ("denoise", "formats", "image", "metals", "scene")


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return import_module(f"raykiln.{name}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBMODULES})
