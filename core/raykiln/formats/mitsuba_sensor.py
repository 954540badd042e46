"""Mitsuba sensors, films, samplers and integrators."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.mitsuba_objects import MitsubaObject
from raykiln.formats.mitsuba_textures import Context
from raykiln.formats.names import unique_name
from raykiln.scene import PerspectiveCamera
from raykiln.studio import rows

# Mitsuba's cameras look along +z with +x to the left.
_MITSUBA_FROM_OURS = np.diag([-1.0, 1.0, -1.0, 1.0])
# Half the diagonal of 35 mm film.
_HALF_DIAGONAL_MM = math.hypot(36.0, 24.0) / 2
MAX_CAMERAS = 1024
_AXES = ("x", "y", "diagonal", "smaller", "larger")
_FILTERS = {"box": "box", "tent": "tent", "gaussian": "gaussian"}
_PATHS = ("path", "volpath_simple", "volpath", "volpathmis", "bdpt", "mlt", "pssmlt", "erpt", "prb",
          "ptracer", "ppm", "sppm", "photonmapper", "prb_basic", "prbvolpath")  # fmt: skip
_WRAPPERS = ("aov", "moment", "stokes", "adaptive", "irrcache", "multichannel")
_AOVS = {"albedo": "albedo", "depth": "depth", "sh_normal": "normal"}
_IGNORED = {"focus_distance", "aperture_radius", "shutter_open", "shutter_close", "srf"}
_FILM_IGNORED = {
    "pixel_format", "component_format", "file_format", "banner", "high_quality_edges",
    "sample_border", "attach_log", "compensate", "exposure", "gamma", "tonemap_method",
}  # fmt: skip


def add_camera(context: Context, owner: MitsubaObject, *, first: bool) -> None:
    """Add the camera of a sensor object; the first sensor's film is the scene's."""
    if owner.type not in ("perspective", "thinlens"):
        context.warn(owner, "this sensor is not supported and left out")
        owner.used.update(owner.properties, (name for name, _ in owner.children))
        return
    if owner.type == "thinlens":
        context.warn(owner, "depth of field is not supported: all is in focus")
    owner.used.update(_IGNORED)
    if len(context.scene.cameras) >= MAX_CAMERAS:
        raise SceneError(f"more than {MAX_CAMERAS} sensors", pointer=owner.pointer)
    name = unique_name(owner.id or "camera", {c.name for c in context.scene.cameras})
    matrix = owner.matrix("to_world")
    fov_deg, fov_axis = _field_of_view(owner)
    context.scene.cameras.append(
        PerspectiveCamera(
            name=name,
            fov_deg=fov_deg,
            fov_axis=fov_axis,
            transform=rows((np.eye(4) if matrix is None else matrix) @ _MITSUBA_FROM_OURS),
            near=owner.float("near_clip", 1e-2),
            far=owner.float("far_clip", 1e4),
            principal_offset=(
                0.0 - owner.float("principal_point_offset_x", 0.0),
                0.0 - owner.float("principal_point_offset_y", 0.0),
            ),
        )
    )
    owner.used.update(name for name, child in owner.children if child.tag in ("film", "sampler"))
    if first:
        _film(context, owner)
        _sampler(context, owner)


def _field_of_view(owner: MitsubaObject) -> tuple[float, Any]:
    axis = owner.string("fov_axis", "x")
    if axis not in _AXES:
        raise SceneError("not a field of view axis", pointer=owner.pointer, found=axis,
                         accepted=" ".join(_AXES))  # fmt: skip
    if "fov" in owner.properties:
        fov = owner.float("fov", 0.0)
        if not 0 < fov < 180:
            raise SceneError("'fov' must be between 0 and 180", pointer=owner.pointer, found=fov)
        return fov, axis
    text = owner.string("focal_length", "50mm")
    match = re.fullmatch(r"\s*([0-9.]+)\s*(mm)?\s*", text)
    if match is None or not float(match[1]) > 0:
        raise SceneError("not a focal length", pointer=owner.pointer, found=text, accepted="50mm")
    return math.degrees(2 * math.atan(_HALF_DIAGONAL_MM / float(match[1]))), "diagonal"


def _film(context: Context, sensor: MitsubaObject) -> None:
    settings = context.scene.settings
    settings.update(width=768, height=576)
    for film in sensor.tagged("film"):
        film.used.update(_FILM_IGNORED)
        width, height = film.integer("width", 768), film.integer("height", 576)
        settings.update(width=width, height=height)
        crop = [
            film.integer("crop_offset_x", 0),
            film.integer("crop_offset_y", 0),
            film.integer("crop_width", width),
            film.integer("crop_height", height),
        ]
        if crop != [0, 0, width, height]:
            settings["crop"] = (crop[0], crop[1], crop[0] + crop[2], crop[1] + crop[3])
        for rfilter in film.tagged("rfilter"):
            _filter(context, rfilter)
        film.used.update(name for name, _ in film.children)
        context.warn_unused(film)


def _filter(context: Context, rfilter: MitsubaObject) -> None:
    name = _FILTERS.get(rfilter.type)
    if name is None:
        context.warn(rfilter, "this filter is not supported; gaussian is used")
    standard = {"stddev": 0.5, "radius": 1.0}
    for key, value in rfilter.properties.items():
        if value != standard.get(key):
            context.warn(rfilter, f"'{key}' of the filter is not supported and not used")
    context.scene.settings["filter"] = name or "gaussian"


def _sampler(context: Context, sensor: MitsubaObject) -> None:
    for sampler in sensor.tagged("sampler"):
        if "sample_count" in sampler.properties:
            context.scene.settings["spp"] = sampler.integer("sample_count", 4)
        sampler.used.update(("seed", "dimension", "scramble", "jitter", "dimensions"))
        context.warn_unused(sampler)


def use_integrator(context: Context, owner: MitsubaObject) -> None:
    """Take the scene's depth and estimator from an integrator object."""
    settings = context.scene.settings
    if owner.type in _WRAPPERS:
        _use_aovs(context, owner)
        inner = owner.tagged("integrator")
        if len(inner) > 1:
            context.warn(owner, "only the first of its integrators is used")
        for nested in inner[:1]:
            use_integrator(context, nested)
        return
    owner.used.update(("samples_per_pass", "block_size", "timeout", "strict_normals"))
    if owner.boolean("hide_emitters", False):
        context.warn(owner, "'hide_emitters' is not supported: lights are seen by the camera")
    if owner.type in ("direct", "ao"):
        settings["integrator"] = owner.type
        owner.used.update(("shading_samples", "emitter_samples", "bsdf_samples", "ray_length"))
    else:
        if owner.type not in _PATHS:
            context.warn(owner, "this integrator is not supported; path is used")
            owner.used.update(owner.properties)
        elif owner.type not in ("path", "volpath"):
            context.warn(owner, "this integrator is replaced by path")
        settings["integrator"] = "path"
        settings["max_depth"] = owner.integer("max_depth", -1)
        settings["rr_depth"] = owner.integer("rr_depth", 5)
    context.warn_unused(owner)


def _use_aovs(context: Context, owner: MitsubaObject) -> None:
    wanted = [pair.rpartition(":")[2].strip() for pair in owner.string("aovs", "").split(",")]
    known = [_AOVS[name] for name in wanted if name in _AOVS]
    for name in wanted:
        if name and name not in _AOVS:
            context.warn(owner, f"the layer '{name}' is not supported and left out")
    if known:
        context.scene.settings["aovs"] = list(dict.fromkeys(known))
