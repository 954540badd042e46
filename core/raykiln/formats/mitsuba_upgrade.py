"""Scenes of Mitsuba 0.x in the words of Mitsuba 2 and later."""

from __future__ import annotations

import re

from raykiln.formats.mitsuba_xml import XmlNode

# Old names of elements (0.2 and 0.3).
_TAGS = {"luminaire": "emitter", "camera": "sensor"}
_RENAMED = {
    ("diffuse", "diffuse_reflectance"): "reflectance",
}
_HUMP = re.compile(r"(?<=[a-z])([A-Z]+)")


def snake_case(name: str) -> str:
    """toWorld -> to_world, intIOR -> int_ior."""
    return _HUMP.sub(lambda match: "_" + match.group(1).lower(), name)


def version_of(root: XmlNode) -> tuple[int, ...]:
    """The version of the format that a file is written in; a missing one is 3."""
    text = root.attributes.get("version", "3.0.0")
    parts = re.findall(r"\d+", text)[:3]
    return tuple(int(part) for part in parts) or (3,)


def upgrade(node: XmlNode, parent_type: str = "") -> None:
    """Rename tags and properties, in place, for a file of a version before 2."""
    node.tag = _TAGS.get(node.tag, node.tag)
    if "name" in node.attributes and node.tag != "default":
        name = snake_case(node.attributes["name"])
        node.attributes["name"] = _RENAMED.get((parent_type, name), name)
    for child in node.children:
        upgrade(child, node.attributes.get("type", ""))
    _gather_uv_transform(node)


def _gather_uv_transform(node: XmlNode) -> None:
    """uscale, vscale, uoffset and voffset of a texture become one to_uv transform."""
    values: dict[str, str] = {}
    kept = []
    for child in node.children:
        name = child.attributes.get("name", "")
        if child.tag == "float" and name in ("uscale", "vscale", "uoffset", "voffset"):
            values[name] = child.attributes.get("value", "")
        else:
            kept.append(child)
    if not values:
        return
    offset = {"x": values.get("uoffset", "0"), "y": values.get("voffset", "0"), "z": "0"}
    scale = {"x": values.get("uscale", "1"), "y": values.get("vscale", "1"), "z": "1"}
    steps = [XmlNode("translate", offset, node.line), XmlNode("scale", scale, node.line)]
    node.children = [*kept, XmlNode("transform", {"name": "to_uv"}, node.line, steps)]
