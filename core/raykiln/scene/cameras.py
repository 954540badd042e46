"""Cameras, and the numbers that follow from them."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from raykiln.scene.base import Finite, Matrix4, Name, Node, NonNegative, Positive, Vec3


class LookAt(Node):
    """A camera placed by points."""

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)

    @model_validator(mode="after")
    def _not_degenerate(self) -> LookAt:
        forward = np.subtract(self.target, self.origin)
        if not np.linalg.norm(np.cross(forward, self.up)) > 0:
            raise ValueError("origin, target and up must not lie on one line")
        return self


class PerspectiveCamera(Node):
    """A pinhole camera: in its own frame it looks along -z, with +x right and +y up."""

    type: Literal["perspective"] = "perspective"
    name: Name = "camera"
    fov_deg: Annotated[float, Field(gt=0, lt=180)] = 40.0
    """Full field of view along `fov_axis`."""
    fov_axis: Literal["x", "y", "smaller", "larger", "diagonal"] = "smaller"
    transform: Matrix4 | None = None
    """world_from_camera; a scale in it is ignored."""
    look_at: LookAt | None = None
    """In place of `transform`."""
    near: NonNegative = 0.0
    """Nothing nearer than this (along the view axis) is seen."""
    far: Positive = 1e30
    principal_offset: tuple[Finite, Finite] = (0.0, 0.0)
    """Shift of the principal point, in image widths and heights, to the right and down."""

    @model_validator(mode="after")
    def _placed_once(self) -> PerspectiveCamera:
        if self.transform is not None and self.look_at is not None:
            raise ValueError("a camera takes 'transform' or 'look_at', not both")
        return self


Camera = PerspectiveCamera


def look_at_matrix(look_at: LookAt) -> np.ndarray[Any, np.dtype[np.float64]]:
    """world_from_camera (4, 4) of a camera that looks along its -z from origin to target."""
    back = np.subtract(look_at.origin, look_at.target).astype(np.float64)
    back /= np.linalg.norm(back)
    right = np.cross(look_at.up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(back, right), back
    matrix[:3, 3] = look_at.origin
    return matrix


def fov_y_rad(camera: PerspectiveCamera, width: int, height: int) -> float:
    """Vertical field of view in radians for an image of the given size in pixels."""
    half = math.tan(math.radians(camera.fov_deg) / 2)
    aspect = width / height
    axis = camera.fov_axis
    if axis == "smaller":
        axis = "x" if aspect < 1 else "y"
    elif axis == "larger":
        axis = "y" if aspect < 1 else "x"
    if axis == "diagonal":
        half /= math.hypot(aspect, 1.0)
    elif axis == "x":
        half /= aspect
    return 2 * math.atan(half)
