"""Lights that are not shapes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from raykiln.arrays import FloatImage
from raykiln.scene.base import Matrix4, Name, Node, NonNegative, Rgb, Vec3


class PointLight(Node):
    """Equal intensity into all directions."""

    type: Literal["point"] = "point"
    position: Vec3
    intensity: NonNegative | Rgb
    """W / sr."""


class SpotLight(Node):
    """A cone of light: full inside `inner_angle_deg`, none outside `outer_angle_deg`.

    Between them the intensity falls off as in glTF's KHR_lights_punctual: with t linear in the
    cosine from 0 (outer) to 1 (inner), as t squared.
    """

    type: Literal["spot"] = "spot"
    position: Vec3
    direction: Vec3
    """The way the light travels along the axis."""
    intensity: NonNegative | Rgb
    """W / sr, on the axis."""
    inner_angle_deg: Annotated[float, Field(ge=0, lt=180)] = 0.0
    """Half angle of the inner cone."""
    outer_angle_deg: Annotated[float, Field(gt=0, le=180)] = 45.0
    """Half angle of the outer cone."""


class DirectionalLight(Node):
    """Parallel light from infinitely far away."""

    type: Literal["directional"] = "directional"
    direction: Vec3
    """The way the light travels."""
    irradiance: NonNegative | Rgb
    """W / m^2, on a surface that faces the light."""


class ConstantLight(Node):
    """The same radiance from every direction."""

    type: Literal["constant"] = "constant"
    radiance: NonNegative | Rgb


class EnvironmentLight(Node):
    """A latitude-longitude map of the radiance from infinitely far away.

    With d the direction in the light's own frame: u = atan2(d.x, -d.z) / 2 pi (wrapped to 0..1),
    v = acos(d.y) / pi; row 0 of the image is +y.
    """

    type: Literal["environment"] = "environment"
    file: Name | None = None
    pixels: FloatImage | None = None
    scale: NonNegative | Rgb = 1.0
    transform: Matrix4 | None = None
    """world_from_light (its rotation counts)."""

    @model_validator(mode="after")
    def _one_source(self) -> EnvironmentLight:
        if (self.file is None) == (self.pixels is None):
            raise ValueError("an environment light takes exactly one of 'file' and 'pixels'")
        return self


Light = Annotated[
    PointLight | SpotLight | DirectionalLight | ConstantLight | EnvironmentLight,
    Field(discriminator="type"),
]
