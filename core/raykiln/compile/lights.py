"""Lights that are not shapes, and the camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from raykiln.compile.build import Build, Rgb, rgb_of
from raykiln.compile.textures import linear_of_srgb
from raykiln.errors import SceneError, SettingsError
from raykiln.scene import (
    ConstantLight,
    DirectionalLight,
    EnvironmentLight,
    PerspectiveCamera,
    PointLight,
    SpotLight,
    fov_y_rad,
    look_at_matrix,
)
from raykiln.settings import RenderSettings


def add_light(build: Build, light: Any, pointer: str) -> None:
    """Add one of the scene's lights."""
    if isinstance(light, PointLight):
        build.core.add_point_light(light.position, rgb_of(light.intensity))
    elif isinstance(light, SpotLight):
        outer = math.cos(math.radians(light.outer_angle_deg))
        inner = math.cos(math.radians(min(light.inner_angle_deg, light.outer_angle_deg)))
        _check_direction(light.direction, pointer)
        build.core.add_spot_light(
            light.position, light.direction, rgb_of(light.intensity), inner, outer
        )
    elif isinstance(light, DirectionalLight):
        _check_direction(light.direction, pointer)
        build.core.add_directional_light(light.direction, rgb_of(light.irradiance))
    elif isinstance(light, ConstantLight):
        build.core.add_environment_light(rgb_of(light.radiance), -1, _columns(None, pointer))
    else:
        _add_environment(build, light, pointer)


def _add_environment(build: Build, light: EnvironmentLight, pointer: str) -> None:
    pixels = build.image(light, pointer)
    if pixels.dtype != np.float32:
        pixels = linear_of_srgb(pixels)
    if not np.isfinite(pixels).all() or (pixels < 0).any():
        build.warnings.append(f"{pointer}: pixels that are negative or not finite are taken as 0")
        pixels = np.where(np.isfinite(pixels), np.maximum(pixels, 0), 0).astype(np.float32)
    image = build.core.add_image_texture(
        np.ascontiguousarray(pixels),
        srgb=False,
        filter="bilinear",
        wrap_u="repeat",
        wrap_v="clamp",
        uv_transform=None,
    )
    build.core.add_environment_light(rgb_of(light.scale), image, _columns(light.transform, pointer))


def set_camera(build: Build, settings: RenderSettings) -> None:
    """Set the camera that the settings name, or the first."""
    camera = _chosen_camera(build, settings.camera)
    if camera.look_at is not None:
        matrix = look_at_matrix(camera.look_at)
    else:
        matrix = np.eye(4) if camera.transform is None else np.array(camera.transform)
    if not abs(np.linalg.det(matrix[:3, :3])) > 0:
        raise SceneError("the camera's transform is singular", pointer="/cameras")
    tan_y = math.tan(fov_y_rad(camera, settings.width, settings.height) / 2)
    build.core.set_camera(
        matrix.astype(np.float32),
        tan_half_x=tan_y * settings.width / settings.height,
        tan_half_y=tan_y,
        offset_x=camera.principal_offset[0],
        offset_y=camera.principal_offset[1],
        near=camera.near,
        far=camera.far,
    )


def _chosen_camera(build: Build, name: str | None) -> PerspectiveCamera:
    if not build.scene.cameras:
        raise SceneError("the scene has no camera", pointer="/cameras")
    if name is None:
        return build.scene.cameras[0]
    for camera in build.scene.cameras:
        if camera.name == name:
            return camera
    names = ", ".join(c.name for c in build.scene.cameras)
    raise SettingsError(f"camera: no camera is named {name!r}; accepted: {names}")


def _columns(transform: Any, pointer: str) -> list[Rgb]:
    """Orthonormal axes of a light's frame in world space."""
    if transform is None:
        return [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    linear = np.array(transform, np.float64)[:3, :3]
    u, singular, vt = np.linalg.svd(linear)
    if not singular[-1] > 0:
        raise SceneError("the transform is singular", pointer=f"{pointer}/transform")
    return [tuple(float(x) for x in column) for column in (u @ vt).T]  # type: ignore[misc]


def _check_direction(direction: Rgb, pointer: str) -> None:
    if not any(direction):
        raise SceneError(
            "the direction is 0",
            pointer=f"{pointer}/direction",
            found=direction,
            accepted="a vector of any length but 0",
        )
