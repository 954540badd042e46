"""Many pictures of one scene: cameras on a turntable, and the moments of an animation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import SettingsError
from raykiln.scene import LookAt, PerspectiveCamera, Scene, Vec3, look_at_matrix
from raykiln.studio import rows, scene_points, shape_points, three_quarter_camera

__all__ = ["frame_times", "orbit", "targets_of", "turntable"]

Axis = Literal["x", "y", "z"]
Matrix = NDArray[np.float64]

MAX_COUNT = 100_000


def turntable(
    scene: Scene,
    count: int,
    *,
    axis: Axis = "y",
    degrees: float = 360.0,
    start_degrees: float = 0.0,
    elevation_degrees: float | None = None,
    target: Vec3 | None = None,
    camera: str | None = None,
) -> list[PerspectiveCamera]:
    """Cameras that go round a scene; the scene and its lights stay where they are.

    Camera i (from 0) is the scene's camera turned by ``start_degrees + i * degrees / count``
    about the axis through `target`, counter-clockwise as seen from the axis's tip.  The end of
    the turn is left out, so that a full turn loops without a doubled frame.

    Parameters
    ----------
    scene
        Add a camera of the result with `Scene.set_camera` to render by it.
    count
        Number of cameras; they are named ``turntable_0001`` and so on.
    axis
        World axis to turn about.
    degrees, start_degrees
        The whole turn, and where it begins: 0 is the scene's own camera, unchanged.
    elevation_degrees
        Angle of the camera above the plane through `target` across the axis: the camera is put
        there at its distance, and looks at `target`.  None = it keeps its height and direction.
    target
        What to turn about; None = what the camera looks at, see `targets_of`.
    camera
        Name of the scene's camera to start from; None = the first.

    Raises
    ------
    SettingsError
        No such camera, a number out of range, or no direction to put an elevated camera in.
    """
    base = _camera_of(scene, camera)
    return orbit(
        base,
        count,
        axis=axis,
        degrees=degrees,
        start_degrees=start_degrees,
        elevation_degrees=elevation_degrees,
        target=targets_of(scene, [base])[0] if target is None else target,
    )


def orbit(
    camera: PerspectiveCamera,
    count: int,
    *,
    axis: Axis = "y",
    degrees: float = 360.0,
    start_degrees: float = 0.0,
    elevation_degrees: float | None = None,
    target: Vec3,
) -> list[PerspectiveCamera]:
    """The cameras of `turntable` from a camera alone."""
    if not 1 <= count <= MAX_COUNT:
        raise SettingsError(f"count: out of range (found {count}); accepted: 1 to {MAX_COUNT}")
    if axis not in ("x", "y", "z"):
        raise SettingsError(f"axis: no such axis (found {axis!r}); accepted: x, y, z")
    for name, value in (("degrees", degrees), ("start_degrees", start_degrees)):
        if not math.isfinite(value):
            raise SettingsError(f"{name}: not a finite number (found {value})")
    unit = np.eye(3)["xyz".index(axis)]
    center = np.array(target, np.float64)
    start = _world_from_camera(camera)
    if elevation_degrees is not None:
        start = _elevated(start, center, unit, elevation_degrees)
    made = []
    for i in range(count):
        angle = start_degrees + i * degrees / count
        values: dict[str, Any] = {"name": f"turntable_{i + 1:04d}"}
        if angle % 360.0 != 0.0 or elevation_degrees is not None:
            matrix = _turned(start, center, unit, angle)
            values |= {"transform": rows(matrix), "look_at": None}
        made.append(camera.model_copy(update=values))
    return made


def targets_of(scene: Scene, cameras: Sequence[PerspectiveCamera]) -> list[Vec3]:
    """What each camera looks at.

    That is the target of its `look_at`; else the centre of the scene's bounds, if the scene is
    something to look at from outside; else the centre of what stands in the middle of the image,
    where a floor, a backdrop or a room that surrounds the view does not count.
    """
    boxes = [
        np.stack([points.min(axis=0), points.max(axis=0)])
        for points in (np.concatenate(parts) for parts in shape_points(scene))
    ]
    points = scene_points(scene)
    whole = np.stack([points.min(axis=0), points.max(axis=0)])
    return [_vector(_target(camera, whole, boxes)) for camera in cameras]


def _target(camera: PerspectiveCamera, whole: Matrix, boxes: list[Matrix]) -> Matrix:
    if camera.look_at is not None:
        return np.array(camera.look_at.target, np.float64)
    matrix = _world_from_camera(camera)
    eye, forward = matrix[:3, 3], -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    center: Matrix = whole.mean(axis=0)
    if not _surrounds(whole, eye):
        return center
    hits = [(t, box) for box in boxes if (t := _entry(box, eye, forward)) is not None]
    hits = [(t, box) for t, box in hits if not _surrounds(box, eye)]
    if not hits:
        # The point of the line of sight that is nearest to the middle of it all.
        return eye + forward * max(float((center - eye) @ forward), 1e-3)
    nearest = min(hits, key=lambda hit: hit[0])[1]
    # A label on a mug is a thing of its own: take the largest of what overlaps.
    touching = [box for _, box in hits if _overlap(box, nearest)]
    chosen: Matrix = max(touching, key=_diagonal).mean(axis=0)
    return chosen


def _diagonal(box: Matrix) -> float:
    return float(np.linalg.norm(box[1] - box[0]))


def _surrounds(box: Matrix, eye: Matrix) -> bool:
    """Whether a box is so near and large that one looks from within rather than at it."""
    return _diagonal(box) > 2 * float(np.linalg.norm(box.mean(axis=0) - eye))


def _overlap(one: Matrix, other: Matrix) -> bool:
    return bool((one[0] <= other[1]).all() and (other[0] <= one[1]).all())


def _entry(box: Matrix, eye: Matrix, forward: Matrix) -> float | None:
    """Where a ray enters a box, as a distance; None if it does not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (box - eye) / forward
    low, high = np.fmin(t[0], t[1]), np.fmax(t[0], t[1])
    enters, leaves = float(np.nanmax(low)), float(np.nanmin(high))
    return enters if max(enters, 0.0) <= leaves else None


def frame_times(start_s: float, end_s: float, fps: float) -> list[float]:
    """The moments of an animation's frames: from the start on, the end included if it is one."""
    if not (math.isfinite(start_s) and math.isfinite(end_s) and start_s <= end_s):
        raise SettingsError(f"end: before the start (found {start_s} to {end_s})")
    if not 0 < fps < math.inf:
        raise SettingsError(f"fps: out of range (found {fps}); accepted: a number above 0")
    # A length such as 0.1 s times 30 is not quite 3.
    steps = math.floor((end_s - start_s) * fps + 1e-6)
    if steps >= MAX_COUNT:
        raise SettingsError(f"end: {steps + 1} frames; accepted: at most {MAX_COUNT}")
    return [start_s + i / fps for i in range(steps + 1)]


def _camera_of(scene: Scene, name: str | None) -> PerspectiveCamera:
    cameras = scene.cameras or [three_quarter_camera(scene)]
    for camera in cameras:
        if name is None or camera.name == name:
            return camera
    known = ", ".join(camera.name for camera in cameras[:20])
    raise SettingsError(f"camera: no camera is named {name!r}; accepted: {known}")


def _world_from_camera(camera: PerspectiveCamera) -> Matrix:
    if camera.look_at is not None:
        return look_at_matrix(camera.look_at)
    return np.eye(4) if camera.transform is None else np.array(camera.transform, np.float64)


def _elevated(start: Matrix, center: Matrix, axis: Matrix, elevation_degrees: float) -> Matrix:
    """The camera at its distance from `center`, raised to an angle, looking at it."""
    if not -90 < elevation_degrees < 90:
        raise SettingsError(
            f"elevation_degrees: out of range (found {elevation_degrees}); "
            "accepted: above -90 and below 90"
        )
    away = start[:3, 3] - center
    distance = float(np.linalg.norm(away))
    outward = away - axis * (away @ axis)
    length = float(np.linalg.norm(outward))
    if not length > 1e-9 * distance:
        raise SettingsError(
            "elevation_degrees: the camera stands on the axis of the turn, so there is no "
            "direction to put it in; accepted: another target, axis or camera"
        )
    angle = math.radians(elevation_degrees)
    eye = center + distance * (math.cos(angle) * outward / length + math.sin(angle) * axis)
    return look_at_matrix(LookAt(origin=_vector(eye), target=_vector(center), up=_vector(axis)))


def _turned(start: Matrix, center: Matrix, axis: Matrix, degrees: float) -> Matrix:
    """`start` turned about the axis through `center` (Rodrigues)."""
    angle = math.radians(degrees % 360.0)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    matrix = np.array(start)
    matrix[:3, :3] = turn @ start[:3, :3]
    matrix[:3, 3] = center + turn @ (start[:3, 3] - center)
    return matrix


def _vector(values: Matrix) -> Vec3:
    x, y, z = values.tolist()
    return (x, y, z)
