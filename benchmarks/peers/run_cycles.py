"""Render one job with Cycles, in Blender as a module; the scene is kept as a .blend file."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from child import Clock, finish, job

given = job()
clock = Clock()
with clock.phase("import_s"):
    bpy: Any = importlib.import_module("bpy")
    mathutils: Any = importlib.import_module("mathutils")

folder = Path(given["scene"])
blend = folder / "cycles.blend"


def build() -> None:
    """Make the scene and save it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    told = json.loads((folder / "neutral.json").read_text())
    for part in told["parts"]:
        thing = imported(folder / part["file"])
        thing.data.materials.clear()
        thing.data.materials.append(material(part))
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.camera = camera(told)
    bpy.context.collection.objects.link(scene.camera)
    scene.world = world(told["sky"])
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=False)


def imported(path: Path) -> Any:
    """A mesh with its y turned to Blender's z."""
    bpy.ops.wm.ply_import(filepath=str(path), up_axis="Y", forward_axis="NEGATIVE_Z")
    return bpy.context.object


def nodes_of(owner: Any) -> tuple[Any, Any]:
    """An empty node tree, and a function that adds a node to it."""
    owner.use_nodes = True
    tree = owner.node_tree
    tree.nodes.clear()
    return tree, tree.nodes.new


def material(part: dict[str, Any]) -> Any:
    """Diffuse, metal, glass, or light from the front side."""
    made = bpy.data.materials.new(part["name"])
    tree, new = nodes_of(made)
    told, output = part["material"], new("ShaderNodeOutputMaterial")
    if part["radiance"] is not None:
        surface = one_sided_light(tree, new, part["radiance"])
        made.cycles.emission_sampling = "FRONT"
    elif told["kind"] == "metal":
        node = new("ShaderNodeBsdfMetallic")
        node.fresnel_type, node.distribution = "PHYSICAL_CONDUCTOR", "GGX"
        node.inputs["IOR"].default_value = [told["eta"]] * 3
        node.inputs["Extinction"].default_value = [told["k"]] * 3
        node.inputs["Roughness"].default_value = told["alpha"] ** 0.5
        surface = node.outputs[0]
    elif told["kind"] == "glass":
        node = new("ShaderNodeBsdfGlass")
        node.inputs["Color"].default_value = (1, 1, 1, 1)
        node.inputs["Roughness"].default_value = 0.0
        node.inputs["IOR"].default_value = told["eta"]
        surface = node.outputs[0]
    else:
        node = new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (*told["reflectance"], 1)
        surface = node.outputs[0]
    tree.links.new(surface, output.inputs["Surface"])
    return made


def one_sided_light(tree: Any, new: Any, radiance: list[float]) -> Any:
    """Emission where the front is seen, black elsewhere."""
    light, mix, geometry = (
        new("ShaderNodeEmission"),
        new("ShaderNodeMixShader"),
        new("ShaderNodeNewGeometry"),
    )
    black = new("ShaderNodeBsdfDiffuse")
    black.inputs["Color"].default_value = (0, 0, 0, 1)
    strength = max(radiance)
    light.inputs["Color"].default_value = (*(c / strength for c in radiance), 1)
    light.inputs["Strength"].default_value = strength
    tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    tree.links.new(light.outputs[0], mix.inputs[1])
    tree.links.new(black.outputs[0], mix.inputs[2])
    return mix.outputs[0]


def camera(told: dict[str, Any]) -> Any:
    """A pinhole that looks along its -z."""
    data = bpy.data.cameras.new("camera")
    data.angle = np.radians(told["fov_deg"])
    data.clip_start, data.clip_end = 1e-3, 1e3
    made = bpy.data.objects.new("camera", data)
    origin, target = (
        mathutils.Vector((p[0], -p[2], p[1])) for p in (told["origin"], told["target"])
    )
    made.location = origin
    made.rotation_mode = "QUATERNION"
    made.rotation_quaternion = (target - origin).to_track_quat("-Z", "Y")
    return made


def world(sky: str | None) -> Any:
    """The sky, or darkness."""
    made = bpy.data.worlds.new("world")
    tree, new = nodes_of(made)
    background, output = new("ShaderNodeBackground"), new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (0, 0, 0, 1)
    if sky is not None:
        texture = new("ShaderNodeTexEnvironment")
        texture.image = bpy.data.images.load(str(folder / sky))
        # Numbers as they are, without a colour transform.
        texture.image.colorspace_settings.name = "Non-Color"
        tree.links.new(texture.outputs[0], background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    return made


def set_up(spp: int) -> None:
    """The job's settings; nothing clamped, nothing filtered, nothing denoised."""
    scene = bpy.context.scene
    cycles, render = scene.cycles, scene.render
    render.resolution_x = render.resolution_y = given["size"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", given["threads"]
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.dither_intensity = 0.0
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    cycles.device, cycles.samples, cycles.seed = "CPU", spp, given["seed"]
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    # Its bounces begin after direct light, which is a path of two segments.
    bounces = given["depth"] - 2
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.transmission_bounces = bounces
    # Russian roulette may end what is longer than this (its default: 0).
    cycles.min_light_bounces = bounces + 1 if given["rr"] == -1 else (given["rr"] or 0)
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.light_sampling_threshold = 0.0
    cycles.use_light_tree, cycles.use_guiding = True, False
    cycles.use_auto_tile = False


def rendered(spp: int, path: str | None) -> None:
    """Render; write an EXR if there is a name for it."""
    set_up(spp)
    if path is not None:
        bpy.context.scene.render.filepath = path
    bpy.ops.render.render(write_still=path is not None)


def pixels_of(path: str) -> Any:
    """The image of an EXR, first row on top."""
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    flat = np.empty(given["size"] ** 2 * 4, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(given["size"], given["size"], 4)[::-1, :, :3].copy()


if given["task"] == "prepare":
    build()
    finish(given, {"version": bpy.app.version_string})
elif given["task"] == "load":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with clock.phase("read_s"):
        for file in sorted(folder.glob("*.ply")):
            imported(file)
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.camera = camera(json.loads((folder / "neutral.json").read_text()))
        bpy.context.collection.objects.link(scene.camera)
        rendered(1, None)
    finish(given, {**clock.seconds, "version": bpy.app.version_string})
else:
    with clock.phase("read_s"):
        bpy.ops.wm.open_mainfile(filepath=str(blend))
    path = given["exr"] or given["result"] + ".exr"
    if given["task"] == "render":
        # What goes before the first sample is done once here, and measured again to be taken off.
        rendered(1, path)
        with clock.phase("first_sample_s"):
            rendered(1, path)
    with clock.phase("render_s"):
        rendered(given["spp"], path)
    if given["task"] == "render":
        share = (given["spp"] - 1) / given["spp"]
        spent = clock.seconds["render_s"] - clock.seconds["first_sample_s"]
        clock.seconds["render_s"] = spent / share
    if given["image"] is not None:
        np.save(given["image"], pixels_of(path))
    if given["exr"] is None:
        Path(path).unlink()
    finish(given, {**clock.seconds, "version": bpy.app.version_string, "spp": given["spp"]})
