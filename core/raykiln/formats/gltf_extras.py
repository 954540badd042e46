"""What glTF has no words for, in the application-specific data (`extras`) of a glTF scene.

`{"raykiln": {"name": ..., "description": ..., "settings": {...}, "lights": [...]}}`, each as in
the native format: so a glTF file can bring an environment light and its render settings.
"""

from __future__ import annotations

from typing import Any

from raykiln.errors import SceneError
from raykiln.formats import native
from raykiln.formats.files import Files
from raykiln.formats.json_text import Item
from raykiln.scene import Scene

KEYS = ("name", "description", "settings", "lights")


def add_extras(item: Item, files: Files, scene: Scene) -> None:
    """Add what the extras of the glTF scene `item` hold for raykiln to `scene`."""
    extras = item.data.get("extras")
    if not isinstance(extras, dict) or "raykiln" not in extras:
        return
    own = Item(extras, f"{item.pointer}/extras").item("raykiln")
    unknown = sorted(own.data.keys() - set(KEYS))
    if unknown:
        raise SceneError("an unknown field", pointer=own.pointer, found=unknown[0],
                         accepted=", ".join(KEYS))  # fmt: skip
    part = _read(own, files)
    scene.name = part.name or scene.name
    scene.description = part.description
    scene.settings = part.settings
    scene.lights += part.lights


def _read(own: Item, files: Files) -> Scene:
    values: dict[str, Any] = dict(own.data)
    try:
        return native.from_data(values, files)
    except SceneError as error:
        error.pointer = f"{own.pointer}{error.pointer or ''}"
        raise
