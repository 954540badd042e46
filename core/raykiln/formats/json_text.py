"""JSON text with errors that say where, and typed access that names the pointer."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from raykiln.errors import SceneError


def parse_json(text: str) -> Any:
    """Parsed JSON; a `SceneError` gives line and column of the first fault."""
    try:
        return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise SceneError(f"not JSON: {error.msg}", pointer=where) from None
    except RecursionError:
        raise SceneError("the JSON is nested too deeply") from None


def _no_constant(name: str) -> float:
    raise SceneError("not JSON", found=name, accepted="finite numbers")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise SceneError("a JSON object has a name twice", found=key)
        result[key] = value
    return result


class Item:
    """A JSON object and its pointer; every getter checks the type."""

    def __init__(self, data: Any, pointer: str) -> None:
        if not isinstance(data, dict):
            raise SceneError("not a JSON object", pointer=pointer or "/", found=data)
        self.data: dict[str, Any] = data
        self.pointer = pointer

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def _at(self, name: object) -> str:
        return f"{self.pointer}/{name}"

    def _bad(self, name: str, accepted: str) -> SceneError:
        value = self.data.get(name)
        what = "a value is missing" if value is None else "a value is of the wrong kind"
        return SceneError(what, pointer=self._at(name), found=value, accepted=accepted)

    def number(self, name: str, default: float | None = None) -> float:
        """A finite number; needed if there is no default."""
        value = self.data.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._bad(name, "a number")
        if not math.isfinite(value):
            raise self._bad(name, "a finite number")
        return float(value)

    def numbers(self, name: str, size: int, default: list[float] | None = None) -> list[float]:
        """A list of `size` finite numbers."""
        value = self.data.get(name, default)
        if not isinstance(value, list) or len(value) != size:
            raise self._bad(name, f"{size} numbers")
        return [Item({name: x}, self.pointer).number(name) for x in value]

    def integer(self, name: str, default: int | None = None) -> int:
        """A whole number of at least 0; needed if there is no default."""
        value = self.data.get(name, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self._bad(name, "a whole number from 0")
        return value

    def string(self, name: str, default: str | None = None) -> str:
        """A text; needed if there is no default."""
        value = self.data.get(name, default)
        if not isinstance(value, str):
            raise self._bad(name, "a text")
        return value

    def boolean(self, name: str, default: bool) -> bool:
        """True or false."""
        value = self.data.get(name, default)
        if not isinstance(value, bool):
            raise self._bad(name, "true or false")
        return value

    def item(self, name: str) -> Item:
        """The object of this name; an empty one if there is none."""
        return Item(self.data.get(name, {}), self._at(name))

    def sequence(self, name: str) -> list[Any]:
        """The list of this name; an empty one if there is none."""
        value = self.data.get(name, [])
        if not isinstance(value, list):
            raise self._bad(name, "a list")
        return value

    def items(self, name: str) -> Iterator[Item]:
        """The objects of the list of this name."""
        for i, value in enumerate(self.sequence(name)):
            yield Item(value, f"{self._at(name)}/{i}")

    def indices(self, name: str) -> list[int]:
        """The whole numbers of the list of this name."""
        return [Item({name: x}, self.pointer).integer(name) for x in self.sequence(name)]

    def entry(self, name: str, index: int, pointer: str) -> Item:
        """Entry `index` of the list of this name, referred to from `pointer`."""
        values = self.sequence(name)
        if not 0 <= index < len(values):
            raise SceneError(
                f"a reference to no entry of '{name}'",
                pointer=pointer,
                found=index,
                accepted=f"0 to {len(values) - 1}" if values else "none",
            )
        return Item(values[index], f"{self._at(name)}/{index}")
