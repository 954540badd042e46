"""The render options, declared once for `render`, `batch` and `submit`."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from raykiln_service.commands.console import CommandError, usage_error

if TYPE_CHECKING:
    from pydantic import ValidationError
    from raykiln.settings import RenderSettings

_PANEL = "Render settings (default: what the scene asks for, then the defaults)"


def _option(*names: str, help: str, metavar: str | None = None) -> Any:
    return typer.Option(*names, help=help, metavar=metavar, rich_help_panel=_PANEL)


@dataclass(frozen=True)
class RenderOptions:
    """The settings given on a command line; None = not given."""

    spp: Annotated[int | None, _option("--spp", help="Samples per pixel.", metavar="N")] = None
    size: Annotated[str | None, _option("--size", help="Image size in pixels.", metavar="WxH")] = (
        None
    )
    max_depth: Annotated[
        int | None,
        _option(
            "--max-depth",
            help="Path segments at most: 1 = emission only, 2 = direct light, -1 = no limit.",
            metavar="N",
        ),
    ] = None
    rr_depth: Annotated[
        int | None,
        _option(
            "--rr-depth",
            help="Path length from which Russian roulette may end a path; -1 = never.",
            metavar="N",
        ),
    ] = None
    integrator: Annotated[
        str | None,
        _option("--integrator", help="The estimator.", metavar="path|whitted|direct|ao"),
    ] = None
    sampler: Annotated[
        str | None, _option("--sampler", help="Sample sequence.", metavar="sobol|independent")
    ] = None
    filter: Annotated[
        str | None,
        _option("--filter", help="Pixel filter.", metavar="box|tent|gaussian|blackman_harris"),
    ] = None
    camera: Annotated[
        str | None, _option("--camera", help="Camera of the scene.", metavar="NAME")
    ] = None
    crop: Annotated[
        str | None,
        _option("--crop", help="Render only this part, in pixels.", metavar="X0,Y0,X1,Y1"),
    ] = None
    seed: Annotated[int | None, _option("--seed", help="Sample seed.", metavar="N")] = None
    threads: Annotated[
        int | None, _option("--threads", help="Worker threads; 0 = all.", metavar="N")
    ] = None
    time_budget: Annotated[
        float | None,
        _option(
            "--time-budget",
            help="Stop after the pass in which this time is over.",
            metavar="SECONDS",
        ),
    ] = None
    noise_threshold: Annotated[
        float | None,
        _option(
            "--noise-threshold",
            help="Stop when the mean relative standard error falls below this.",
            metavar="X",
        ),
    ] = None
    aov: Annotated[
        list[str] | None,
        _option(
            "--aov",
            help="A further layer of the EXR; may repeat.",
            metavar="albedo|normal|depth|variance",
        ),
    ] = None
    denoise: Annotated[
        bool | None,
        _option("--denoise/--no-denoise", help="Denoise the result (extra `denoise`)."),
    ] = None

    def settings(self) -> RenderSettings:
        """`RenderSettings` with only the given fields set; a `CommandError` names the option."""
        return settings_of(self.values())

    def values(self) -> dict[str, Any]:
        """The given options as `RenderSettings` fields."""
        values: dict[str, Any] = {}
        for name, value in ((f.name, getattr(self, f.name)) for f in fields(self)):
            if value is None or value == []:
                continue
            if name == "size":
                values["width"], values["height"] = parse_size(value)
            elif name == "crop":
                values["crop"] = parse_crop(value)
            elif name == "aov":
                values["aovs"] = [part.strip() for text in value for part in text.split(",")]
            else:
                values[_FIELD_OF.get(name, name)] = value
        return values


_FIELD_OF = {"time_budget": "time_budget_s"}
_OPTION_OF = {
    "width": "--size",
    "height": "--size",
    "aovs": "--aov",
    "time_budget_s": "--time-budget",
}


def option_of(field: str) -> str:
    """The command-line option that sets a field of `RenderSettings`."""
    return _OPTION_OF.get(field) or "--" + field.replace("_", "-")


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of a text such as ``1920x1080``."""
    match = re.fullmatch(r"\s*(-?\d{1,18})\s*[xX×]\s*(-?\d{1,18})\s*", text)
    if match is None:
        raise usage_error("--size", "not a size", found=text, accepted="WIDTHxHEIGHT in pixels")
    return int(match[1]), int(match[2])


def parse_crop(text: str) -> list[int]:
    """The four numbers of a text such as ``0,0,64,64``."""
    if re.fullmatch(r"\s*\d{1,9}\s*(,\s*\d{1,9}\s*){3}", text) is None:
        raise usage_error(
            "--crop", "not a crop window", found=text, accepted="X0,Y0,X1,Y1 in pixels"
        )
    return [int(part) for part in text.split(",")]


def settings_of(values: dict[str, Any], place: str = "") -> RenderSettings:
    """`RenderSettings` of the given fields.

    Parameters
    ----------
    values
        Fields of `RenderSettings`; those left out stay unset.
    place
        Where the values come from, if not from the command line (named in the error).
    """
    from pydantic import ValidationError
    from raykiln.settings import RenderSettings

    try:
        return RenderSettings.model_validate(values)
    except ValidationError as error:
        raise _settings_error(error, place) from None
    except TypeError as error:
        raise CommandError(f"{place or 'settings'}: {error}") from None


def _settings_error(error: ValidationError, place: str) -> CommandError:
    from raykiln.settings import RenderSettings

    first = error.errors(include_url=False)[0]
    message = first["msg"].removeprefix("Value error, ")
    if not first["loc"]:
        # A complaint about several fields begins with the name of the first.
        named = message.partition(" ")[0]
        option = option_of(named) if named in RenderSettings.model_fields else "--size"
        return CommandError(f"{place or option}: {message}")
    field = str(first["loc"][0])
    where = f"{place}: {field}" if place else option_of(field)
    if first["type"] == "extra_forbidden":
        known = ", ".join(RenderSettings.model_fields)
        return usage_error(where, "no such setting", accepted=known)
    return usage_error(
        where, message, found=repr(first.get("input")), accepted=accepted_values(field)
    )


def accepted_values(field: str) -> str | None:
    """What a field of `RenderSettings` accepts, in words, from its JSON Schema."""
    from raykiln.settings import RenderSettings

    schema = RenderSettings.model_json_schema()["properties"].get(field, {})
    parts = [schema, *schema.get("anyOf", []), schema.get("items", {})]
    merged = {key: value for part in reversed(parts) for key, value in part.items()}
    if "enum" in merged:
        return ", ".join(map(str, merged["enum"]))
    if "minimum" in merged:
        high = merged.get("maximum", merged.get("exclusiveMaximum"))
        return f"{merged['minimum']} to {high}" if high is not None else f"{merged['minimum']} up"
    if "exclusiveMinimum" in merged:
        return f"a number above {merged['exclusiveMinimum']}"
    return None


def with_render_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command one option for each field of `RenderOptions`, passed as `options`."""
    return with_options(RenderOptions, "options")(command)


def with_options(
    kind: type[Any], name: str
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command one option for each field of a dataclass, passed as `name`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        hints = get_type_hints(kind, include_extras=True)
        own = inspect.signature(command, eval_str=True)
        shared = [
            inspect.Parameter(
                f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=hints[f.name]
            )
            for f in fields(kind)
        ]

        @functools.wraps(command)
        def wrapper(**arguments: Any) -> None:
            given = {f.name: arguments.pop(f.name) for f in fields(kind)}
            command(**arguments, **{name: kind(**given)})

        kept = [
            p.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter, p in own.parameters.items()
            if parameter != name
        ]
        parameters = [*kept, *shared]
        wrapper.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
        return wrapper

    return decorate
