"""Mitsuba XML scenes: version 3, and older ones in the words of their day."""

from __future__ import annotations

from pathlib import Path

from raykiln.formats.files import MAX_TEXT_BYTES, Files, scene_errors
from raykiln.formats.mitsuba_bsdfs import Materials
from raykiln.formats.mitsuba_lights import add_light
from raykiln.formats.mitsuba_objects import Document, MitsubaObject
from raykiln.formats.mitsuba_sensor import add_camera, use_integrator
from raykiln.formats.mitsuba_shapes import Shapes
from raykiln.formats.mitsuba_textures import Context
from raykiln.scene import Scene


def read(path: Path, files: Files) -> Scene:
    """The scene of a Mitsuba XML file."""
    document = Document(files)
    root = document.read(path, files.read(path, limit=MAX_TEXT_BYTES))
    document.scene.name = path.stem
    with scene_errors(path):
        _build(document, root)
    return document.scene


def _build(document: Document, root: MitsubaObject) -> None:
    scene = document.scene
    context = Context(document)
    materials = Materials(context)
    shapes = Shapes(context, materials)
    for _, child in root.children:
        if child.tag == "shape":
            shapes.add(child)
        elif child.tag == "emitter":
            add_light(context, child)
        elif child.tag == "sensor":
            add_camera(context, child, first=not scene.cameras)
        elif child.tag == "integrator":
            use_integrator(context, child)
        elif child.tag in ("medium", "volume", "phase"):
            context.warn(child, "media are not supported and not used")
    shapes.finish()
    for child in _reachable(root):
        if child.tag in ("shape", "bsdf", "texture", "emitter", "sensor") and child.used:
            context.warn_unused(child)


def _reachable(root: MitsubaObject) -> list[MitsubaObject]:
    found: dict[int, MitsubaObject] = {}
    stack = [root]
    while stack:
        current = stack.pop()
        if id(current) not in found:
            found[id(current)] = current
            stack.extend(child for _, child in reversed(current.children))
    return list(found.values())
