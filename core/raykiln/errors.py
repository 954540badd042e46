"""The errors that raykiln raises on purpose; each one names the place and the mend."""

from __future__ import annotations

from pydantic import ValidationError


class RaykilnError(Exception):
    """Base of every error raised on purpose by raykiln."""


class SceneError(RaykilnError):
    """A scene that cannot be rendered as it stands.

    Parameters
    ----------
    message
        What is wrong, in one sentence.
    file
        The file in which it was found.
    pointer
        Where in it: a JSON pointer (``/materials/gold/alpha``), ``line 12``, or an XML path.
    found, accepted
        What stands there, and what could stand there instead.
    """

    def __init__(
        self,
        message: str,
        *,
        file: object = None,
        pointer: str | None = None,
        found: object = None,
        accepted: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.pointer = pointer
        self.found = None if found is None else shorten(found)
        self.accepted = accepted
        super().__init__(message)

    def __str__(self) -> str:
        where = ": ".join(part for part in (self.file, self.pointer) if part)
        text = f"{where}: {self.message}" if where else self.message
        if self.found is not None:
            text += f" (found {self.found})"
        if self.accepted is not None:
            text += f"; accepted: {self.accepted}"
        return text

    def in_file(self, file: object) -> SceneError:
        """The same error, with the file named if it was not yet."""
        if self.file is None:
            self.file = str(file)
        return self


class SettingsError(RaykilnError):
    """Render settings outside what is accepted."""


class ImageError(RaykilnError):
    """An image file that cannot be read or written."""


class RenderError(RaykilnError):
    """A render that could not go on (a damaged checkpoint, no memory)."""


def shorten(value: object, limit: int = 120) -> str:
    """`value` as text of at most `limit` characters."""
    text = value if isinstance(value, str) else repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def pointer_of(location: tuple[int | str, ...], data: object = None) -> str:
    """The JSON pointer (RFC 6901) of a pydantic error location.

    Pydantic puts the names of union members between the keys; where `data` is given, only those
    parts stay that lead somewhere in it (and the last one, which may name a missing key).
    """
    parts: list[int | str] = []
    for i, part in enumerate(location):
        inside = _member(data, part)
        is_last = i == len(location) - 1
        missing = isinstance(data, dict) and is_last and data.get("type") != part
        if inside is not _ABSENT or data is None or missing:
            parts.append(part)
        if inside is not _ABSENT:
            data = inside
    return "".join("/" + str(p).replace("~", "~0").replace("/", "~1") for p in parts)


_ABSENT = object()


def _member(data: object, key: int | str) -> object:
    if isinstance(data, dict):
        return data.get(key, _ABSENT)
    if isinstance(data, list | tuple) and isinstance(key, int) and key < len(data):
        return data[key]
    return _ABSENT


def scene_error_of(
    error: ValidationError, *, data: object = None, file: object = None
) -> SceneError:
    """The deepest complaint of a pydantic validation of `data`, as a `SceneError`."""
    first = max(error.errors(include_url=False), key=lambda e: len(pointer_of(e["loc"], data)))
    return SceneError(
        first["msg"].removeprefix("Value error, "),
        file=file,
        pointer=pointer_of(first["loc"], data) or None,
        found=first.get("input"),
        accepted=_accepted(first.get("ctx", {})),
    )


def _accepted(context: dict[str, object]) -> str | None:
    for key in ("expected", "expected_tags", "expected_schemes"):
        if key in context:
            return str(context[key])
    return None
