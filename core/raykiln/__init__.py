"""raykiln: a path tracer for pipelines.

>>> import raykiln as rk
>>> scene = rk.load_scene("cornell_box")
>>> result = rk.render(scene, rk.RenderSettings(width=64, height=64, spp=4))
>>> result.image.shape
(64, 64, 3)
"""

from __future__ import annotations

from raykiln._core import __version__
from raykiln.bundled import bundled_scenes, load_scene
from raykiln.compile import PreparedScene, prepare
from raykiln.errors import ImageError, RaykilnError, RenderError, SceneError, SettingsError
from raykiln.frames import turntable
from raykiln.render import Progress, SceneReport, check, render
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
