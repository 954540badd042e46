"""Finding and loading the scene that a command names, and the commands that only look at it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import (
    CommandError,
    ExitCode,
    print_error,
    print_json,
    print_warnings,
)

if TYPE_CHECKING:
    from raykiln import Scene

SCENE_HELP = "Scene file, or the name of a bundled scene (see `raykiln scenes`)."
SceneArgument = Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")]

BaseDirOption = Annotated[
    Path | None,
    typer.Option(
        "--base-dir",
        help="Folder that the scene's files must lie in [default: the scene file's folder]",
        metavar="DIR",
    ),
]


def resolve_scene(text: str) -> Path:
    """The scene file that `text` names: a file if there is one, else a bundled scene."""
    from raykiln import bundled_scenes

    path = Path(text)
    try:
        if path.is_file():
            return path
        if path.is_dir():
            raise CommandError(f"{text}: is a folder, not a scene file (see `raykiln batch`)")
        if path.exists():
            raise CommandError(f"{text}: is not a regular file")
    except (OSError, ValueError) as error:
        raise CommandError(f"{text[:200]}: not a usable path: {error}") from None
    bundled = bundled_scenes()
    if text in bundled:
        return bundled[text]
    message = f"{text}: no such file"
    if path.name == text and not path.suffix:
        message += f", nor a bundled scene; bundled: {', '.join(sorted(bundled))}"
    raise CommandError(message)


def load(text: str, base_dir: Path | None = None, *, time_s: float | None = None) -> Scene:
    """The scene that `text` names; raises `SceneError` or `CommandError`.

    `time_s` is the moment of its animation, None = at rest.
    """
    import raykiln

    if base_dir is not None and not base_dir.is_dir():
        raise CommandError(f"--base-dir: no such folder (found {base_dir})")
    path = resolve_scene(text)
    return raykiln.load_scene(path, base_dir=base_dir, time_s=time_s)


@contextmanager
def naming(scene: str) -> Iterator[None]:
    """Name the scene in errors that are found only when it is built."""
    from raykiln import SceneError

    try:
        yield
    except SceneError as error:
        raise error.in_file(scene) from None


def stem_of(text: str) -> str:
    """The name for outputs of the scene that the user gave as `text`."""
    return Path(text).stem or "image"


def scenes(
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List the bundled scenes; their names work wherever SCENE does."""
    from raykiln.bundled import bundled_scenes, heading_of

    rows = []
    for name, path in sorted(bundled_scenes().items()):
        rows.append({"name": name, "description": heading_of(path)[1] or "", "path": str(path)})
    if as_json:
        print_json(rows)
        return
    width = max((len(row["name"]) for row in rows), default=0)
    for row in rows:
        print(f"{row['name']:<{width}}  {row['description'] or row['path']}")


def inspect(
    scene: SceneArgument,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
    base_dir: BaseDirOption = None,
) -> None:
    """Show what would be loaded, and every feature of the file that is not supported.

    Exit code 0 if it can be rendered (with or without warnings), else 2.
    """
    import raykiln

    try:
        with naming(scene):
            summary = raykiln.check(load(scene, base_dir)).summary()
    except raykiln.SceneError as error:
        if not as_json:
            raise
        print_json({"renderable": False, "error": error_document(error)})
        print_error(str(error))
        raise typer.Exit(ExitCode.USAGE) from None
    if as_json:
        print_json({"renderable": True, **summary})
        return
    _print_summary(summary)
    print_warnings(summary.get("warnings", []))


def error_document(error: Any) -> dict[str, Any]:
    """A `SceneError` as the fields that the HTTP API uses too."""
    document = {
        "detail": error.message,
        "file": error.file,
        "pointer": error.pointer,
        "found": error.found,
        "accepted": error.accepted,
    }
    return {key: value for key, value in document.items() if value is not None}


def _print_summary(summary: dict[str, Any]) -> None:
    width = max(map(len, summary), default=0)
    for name, value in summary.items():
        if name != "warnings":
            print(f"{name.replace('_', ' '):<{width}}  {_text(value)}")


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none"
    if isinstance(value, dict):
        given = ((key, item) for key, item in value.items() if item is not None)
        return ", ".join(f"{key} {_text(item)}" for key, item in given) or "none"
    return str(value)
