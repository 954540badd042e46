"""Mitsuba emitters that are not shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from raykiln.formats.mitsuba_objects import MitsubaObject
from raykiln.formats.mitsuba_textures import Context
from raykiln.scene import (
    ConstantLight,
    DirectionalLight,
    EnvironmentLight,
    PointLight,
    SpotLight,
)
from raykiln.studio import rows


def add_light(context: Context, owner: MitsubaObject) -> None:
    """Add the light of a top-level emitter object."""
    owner.used.update(("sampling_weight", "samples"))
    maker = _MAKERS.get(owner.type)
    if maker is None:
        context.warn(owner, "this emitter is not supported and left out")
        owner.used.update(owner.properties, (name for name, _ in owner.children))
        return
    context.scene.lights.append(maker(context, owner))


def _matrix(owner: MitsubaObject) -> Any:
    matrix = owner.matrix("to_world")
    return np.eye(4) if matrix is None else matrix


def _point(context: Context, owner: MitsubaObject) -> PointLight:
    position = owner.get("position", list, None)
    if position is None:
        position = _matrix(owner)[:3, 3].tolist()
    intensity = context.constant_color(owner, "intensity", 1.0, "emission")
    return PointLight(position=tuple(position), intensity=intensity)


def _spot(context: Context, owner: MitsubaObject) -> SpotLight:
    matrix = _matrix(owner)
    cutoff = owner.float("cutoff_angle", 20.0)
    beam = owner.float("beam_width", cutoff * 0.75)
    if owner.child("texture") is not None:
        context.warn(owner, "a texture of a spot light is not supported")
    if beam < cutoff:
        context.warn(owner, "the fall-off of the spot light has a slightly different shape")
    return SpotLight(
        position=tuple(matrix[:3, 3].tolist()),
        direction=tuple(matrix[:3, 2].tolist()),
        intensity=context.constant_color(owner, "intensity", 1.0, "emission"),
        inner_angle_deg=min(beam, cutoff),
        outer_angle_deg=cutoff,
    )


def _directional(context: Context, owner: MitsubaObject) -> DirectionalLight:
    direction = owner.get("direction", list, None)
    if direction is None:
        direction = _matrix(owner)[:3, 2].tolist()
    irradiance = context.constant_color(owner, "irradiance", 1.0, "emission")
    return DirectionalLight(direction=tuple(direction), irradiance=irradiance)


def _constant(context: Context, owner: MitsubaObject) -> ConstantLight:
    return ConstantLight(radiance=context.constant_color(owner, "radiance", 1.0, "emission"))


def _environment(context: Context, owner: MitsubaObject) -> EnvironmentLight:
    path = context.document.resolve(
        owner.string("filename", ""), owner, f"{owner.pointer}, filename"
    )
    matrix = owner.matrix("to_world")
    return EnvironmentLight(
        file=context.document.files.relative(path),
        scale=owner.float("scale", 1.0),
        transform=None if matrix is None else rows(matrix),
    )


_MAKERS: dict[str, Any] = {
    "point": _point,
    "spot": _spot,
    "directional": _directional,
    "constant": _constant,
    "envmap": _environment,
}
