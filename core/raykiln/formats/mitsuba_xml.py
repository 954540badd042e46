"""Mitsuba XML as a tree of objects with typed properties.

The second half of the reader: `mitsuba_objects.py` gives the elements here their meaning.
"""

from __future__ import annotations

import xml.sax
from dataclasses import dataclass, field
from typing import Any

from defusedxml import DefusedXmlException
from defusedxml.sax import parseString

from raykiln.errors import SceneError

MAX_ELEMENTS = 1 << 20
MAX_DEPTH = 64


@dataclass
class XmlNode:
    """An XML element."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[XmlNode] = field(default_factory=list)

    @property
    def pointer(self) -> str:
        """Where it stands, for errors."""
        return f"line {self.line}"


class _Builder(xml.sax.ContentHandler):
    def __init__(self) -> None:
        super().__init__()
        self.top = XmlNode("", {}, 0)
        self.open = [self.top]
        self.count = 0
        self.locator: Any = None

    def setDocumentLocator(self, locator: Any) -> None:  # noqa: N802
        self.locator = locator

    def startElement(self, name: str, attrs: Any) -> None:  # noqa: N802
        self.count += 1
        line = self.locator.getLineNumber()
        if self.count > MAX_ELEMENTS:
            raise SceneError(f"more than {MAX_ELEMENTS} XML elements", pointer=f"line {line}")
        if len(self.open) > MAX_DEPTH:
            raise SceneError("the XML is nested too deeply", pointer=f"line {line}")
        node = XmlNode(name, dict(attrs.items()), line)
        self.open[-1].children.append(node)
        self.open.append(node)

    def endElement(self, name: str) -> None:  # noqa: N802
        self.open.pop()


def parse_xml(data: bytes) -> XmlNode:
    """The root element; a `SceneError` gives line and column of the first fault.

    Document type definitions, and with them entities, are refused.
    """
    builder = _Builder()
    try:
        parseString(data, builder, forbid_dtd=True)
    except xml.sax.SAXParseException as error:
        where = f"line {error.getLineNumber()}, column {(error.getColumnNumber() or 0) + 1}"
        raise SceneError(f"not XML: {error.getMessage()}", pointer=where) from None
    except DefusedXmlException as error:
        raise SceneError(f"XML with {type(error).__name__} is refused") from None
    if not builder.top.children:
        raise SceneError("not XML: no element")
    return builder.top.children[0]
