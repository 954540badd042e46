"""A camera and lights for scenes that come without."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln.scene import (
    Cube,
    EnvironmentLight,
    Instance,
    Mesh,
    PerspectiveCamera,
    Rectangle,
    Scene,
    Sphere,
    look_at_matrix,
)

Array = NDArray[np.float64]

FOV_DEG = 35.0
AZIMUTH_DEG = 35.0
ELEVATION_DEG = 20.0
# Share of the image that the scene fills along the tighter side.
FILL = 0.85
MAX_POINTS_PER_SHAPE = 20_000


def complete(scene: Scene) -> None:
    """Give a scene a three-quarter view and studio light where it has no camera or no light."""
    if not scene.cameras:
        scene.cameras.append(three_quarter_camera(scene))
        scene.warn("the scene has no camera: a three-quarter view of its bounds is used")
    if not has_light(scene):
        scene.lights.append(studio_light(scene.cameras[0]))
        scene.warn("the scene has no light: a soft neutral studio environment is used")


def three_quarter_camera(scene: Scene) -> PerspectiveCamera:
    """A camera that sees all of the scene from its front right, slightly from above.

    The scene fits the smaller side of the image, so it is whole at any aspect ratio.
    """
    points = scene_points(scene)
    azimuth, elevation = math.radians(AZIMUTH_DEG), math.radians(ELEVATION_DEG)
    back = np.array(
        [
            math.sin(azimuth) * math.cos(elevation),
            math.sin(elevation),
            math.cos(azimuth) * math.cos(elevation),
        ]
    )
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    basis = np.stack([right, np.cross(back, right), back])
    eye = basis.T @ _fitting_eye(points @ basis.T)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = basis.T, eye
    return PerspectiveCamera(
        name="three_quarter", fov_deg=FOV_DEG, fov_axis="smaller", transform=rows(matrix)
    )


def _fitting_eye(points: Array) -> Array:
    """The nearest eye, in the camera's axes, whose square frustum along -z holds all points.

    A point (x, y, z) is inside if |x - ex| <= t (ez - z), and so for y; each bound on ex is
    linear in ez, which gives the least ez at once.
    """
    size = float(np.ptp(points, axis=0).max()) or 1.0
    t = math.tan(math.radians(FOV_DEG) / 2) * FILL
    high = (points[:, :2] + t * points[:, 2:]).max(axis=0)
    low = (points[:, :2] - t * points[:, 2:]).min(axis=0)
    distance = max(float((high - low).max()) / (2 * t), float(points[:, 2].max()) + 0.01 * size)
    if float((high - low).max()) <= 0.0:
        distance += size
    return np.array([*(high + low) / 2, distance])


def scene_points(scene: Scene) -> Array:
    """Points (n, 3) that span the scene in world space; the origin's neighbourhood if empty."""
    parts = [p for shape in scene.shapes for p in _shape_points(scene, shape)]
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        return points
    return np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


def shape_points(scene: Scene) -> Iterator[list[Array]]:
    """Points that span each shape of a scene that has any, in world space."""
    for shape in scene.shapes:
        parts = [p[np.isfinite(p).all(axis=1)] for p in _shape_points(scene, shape)]
        if any(len(part) for part in parts):
            yield parts


def _shape_points(scene: Scene, shape: Any) -> Iterator[Array]:
    if isinstance(shape, Instance):
        inner = [p for s in scene.groups.get(shape.group, []) for p in _shape_points(scene, s)]
        if not inner:
            return
        corners = _box(np.concatenate(inner))
        matrices = np.asarray(shape.transforms, np.float64)
        yield _placed(corners, matrices).reshape(-1, 3)
        return
    points = _local_points(shape)
    if points is not None and len(points):
        matrix = np.eye(4) if shape.transform is None else np.array(shape.transform)
        yield _placed(points, matrix[None])[0]


def _local_points(shape: Any) -> Array | None:
    if isinstance(shape, Mesh):
        if shape.vertices is None or not len(shape.vertices):
            return None
        step = max(1, len(shape.vertices) // MAX_POINTS_PER_SHAPE)
        vertices = np.asarray(shape.vertices)
        extremes = [vertices[:, k].argmin() for k in range(3)] + [
            vertices[:, k].argmax() for k in range(3)
        ]
        return np.concatenate([vertices[::step], vertices[extremes]]).astype(np.float64)
    if isinstance(shape, Sphere):
        axes = np.concatenate(
            [np.eye(3), -np.eye(3), _box(np.array([[-1.0] * 3, [1.0] * 3])) / 3**0.5]
        )
        return np.array(shape.center) + shape.radius * axes
    depth = 1.0 if isinstance(shape, Cube) else 0.0
    points = _box(np.array([[-1.0, -1.0, -depth], [1.0, 1.0, depth]]))
    return points if isinstance(shape, Cube | Rectangle) else points / 2**0.5


def _box(points: Array) -> Array:
    """The eight corners of the bounds of points."""
    low, high = points.min(axis=0), points.max(axis=0)
    choice = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    corners: Array = np.where(choice, high, low)
    return corners


def _placed(points: Array, matrices: Array) -> Array:
    """(m, n, 3): each of n points by each of m matrices."""
    placed: Array = np.einsum("mij,nj->mni", matrices[:, :3, :3], points) + matrices[:, None, :3, 3]
    return placed


def rows(matrix: Any) -> Any:
    """A 4 x 4 array as the nested tuples of the scene description."""
    return tuple(tuple(float(x) for x in row) for row in np.asarray(matrix, np.float64))


def has_light(scene: Scene) -> bool:
    """Whether anything in a scene gives light: a light, or a shape that emits."""
    if scene.lights:
        return True
    used = {s.group for s in scene.shapes if isinstance(s, Instance)}
    shapes: list[Any] = [s for s in scene.shapes if not isinstance(s, Instance)]
    shapes += [s for name in used for s in scene.groups.get(name, [])]
    return any(s.emission is not None for s in shapes)


def studio_light(camera: PerspectiveCamera) -> EnvironmentLight:
    """A soft environment of mean radiance 1, with its key light to the left of the camera."""
    matrix = (
        look_at_matrix(camera.look_at)
        if camera.look_at is not None
        else np.array(camera.transform if camera.transform is not None else np.eye(4))
    )
    back = matrix[:3, 2]
    yaw = math.atan2(back[0], back[2])
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return EnvironmentLight(pixels=studio_pixels(), transform=rows(turn))


def studio_pixels(height: int = 64) -> NDArray[np.float32]:
    """Radiance (height, 2 height, 3): a gradient, a large key and a weaker fill.

    In the light's own frame the camera is at +z: the key is up, left and in front, the fill right.
    The mean over the sphere is 1.
    """
    v = (np.arange(height) + 0.5) / height * math.pi
    u = (np.arange(2 * height) + 0.5) / (2 * height) * 2 * math.pi
    y = np.cos(v)[:, None] + np.zeros_like(u)
    x, z = np.sin(v)[:, None] * np.sin(u), -np.sin(v)[:, None] * np.cos(u)
    radiance = 0.4 + 0.3 * y
    for direction, strength, width in (((-0.6, 0.7, 0.6), 16.0, 0.3), ((0.9, 0.2, 0.4), 1.5, 0.6)):
        axis = np.array(direction) / np.linalg.norm(direction)
        cosine = x * axis[0] + y * axis[1] + z * axis[2]
        radiance = radiance + strength * np.exp((cosine - 1) / width**2 * 2)
    weight = np.sin(v)[:, None] + np.zeros_like(u)
    radiance /= float((radiance * weight).sum() / weight.sum())
    return np.repeat(radiance[:, :, None], 3, axis=2).astype(np.float32)
