"""What a batch renders: the scenes of a folder, or the lines of a manifest."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Any

from raykiln_service.commands.batch_run import OUTPUTS, Item
from raykiln_service.commands.console import CommandError
from raykiln_service.commands.options import settings_of
from raykiln_service.commands.scenes import resolve_scene

DESCRIPTIONS = (".json", ".gltf", ".xml")
"""Text formats that refer to other files."""
SCENES = (*DESCRIPTIONS, ".glb", ".obj", ".ply", ".stl")
_PEEK = 1 << 16
_SCENE_KEYS = {"shapes", "groups", "cameras", "lights", "materials"}
_REFERENCE = re.compile(r"""["']([^"'\n]{1,1024}\.(?:xml|obj|ply|stl))["']""", re.IGNORECASE)


def read_inputs(source: Path, folder: Path, settings: dict[str, Any]) -> list[Item]:
    """The items of a folder or a manifest file.

    Parameters
    ----------
    source
        A folder, searched recursively, or a manifest.
    folder
        The output folder, which is not searched.
    settings
        `RenderSettings` fields for all; a manifest's own come first.

    Raises
    ------
    CommandError
        For a manifest that cannot be understood, or if there is nothing to render.
    """
    if source.is_dir():
        items = _folder_items(source, folder, settings)
    elif source.is_file():
        items = _manifest_items(source, settings)
    else:
        raise CommandError(f"{source}: no such file or folder")
    if not items:
        accepted = ", ".join(SCENES)
        raise CommandError(f"{source}: no scenes to render; accepted: {accepted}")
    return items


def _folder_items(source: Path, folder: Path, settings: dict[str, Any]) -> list[Item]:
    found = list(_scene_files(source, folder))
    parts = {part for file in found for part in _referenced(file)}
    files = [file for file in found if file.resolve() not in parts]
    stems = Counter(file.relative_to(source).with_suffix("") for file in files)
    items = []
    for file in files:
        relative = file.relative_to(source)
        stem = relative.with_suffix("")
        # "a.gltf" beside "a.glb" would overwrite each other's outputs.
        name = stem if stems[stem] == 1 else relative
        items.append(Item(str(file), file, name.as_posix(), settings))
    return items


def _scene_files(source: Path, excluded: Path) -> list[Path]:
    found = []
    for root, folders, names in os.walk(source):
        here = Path(root)
        folders[:] = sorted(
            f for f in folders if not f.startswith(".") and not _same(here / f, excluded)
        )
        for name in sorted(names):
            file = here / name
            if file.suffix.lower() in SCENES and not name.startswith(".") and _is_scene(file):
                found.append(file)
    return found


def _same(a: Path, b: Path) -> bool:
    return b.exists() and a.samefile(b)


def _is_scene(file: Path) -> bool:
    """False only for a JSON or XML document that plainly is something else."""
    kind = file.suffix.lower()
    try:
        if kind == ".json":
            if file.name.endswith(".stats.json"):
                return False
            document = json.loads(file.read_bytes())
            return isinstance(document, dict) and not _SCENE_KEYS.isdisjoint(document)
        if kind == ".xml":
            with file.open("rb") as stream:
                root = re.search(rb"<([A-Za-z_][\w.:-]*)", stream.read(_PEEK))
            return root is None or root[1] == b"scene"
    except (OSError, ValueError, RecursionError):
        # Unreadable or broken: let its render say so.
        return True
    return True


def _referenced(file: Path) -> set[Path]:
    """Scene-like files that a description names: its meshes and includes."""
    if file.suffix.lower() not in DESCRIPTIONS:
        return set()
    try:
        text = file.read_text(errors="replace")
    except OSError:
        return set()
    named = (file.parent / match[1] for match in _REFERENCE.finditer(text))
    return {path.resolve() for path in named if _is_file(path)} - {file.resolve()}


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _manifest_items(source: Path, settings: dict[str, Any]) -> list[Item]:
    items: list[Item] = []
    taken: dict[str, str] = {}
    for place, entry in _manifest_entries(source):
        item = _manifest_item(source, place, entry, settings)
        if item.name in taken:
            raise CommandError(
                f"{place}: the same output as {taken[item.name]} (found {item.name}); "
                'accepted: an "output" of its own'
            )
        taken[item.name] = place
        items.append(item)
    return items


def _manifest_entries(source: Path) -> list[tuple[str, Any]]:
    """Each entry with its place: a JSON list, else a line each (JSON objects or plain paths)."""
    try:
        text = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CommandError(f"{source}: not a readable manifest: {error}") from None
    if text.lstrip().startswith("["):
        return [(f"{source}: /{i}", entry) for i, entry in enumerate(_json(text, str(source)))]
    entries: list[tuple[str, Any]] = []
    for number, raw in enumerate(text.splitlines(), 1):
        line, place = raw.strip(), f"{source}: line {number}"
        if line and not line.startswith("#"):
            entries.append((place, _json(line, place) if line[0] in '{"' else line))
    return entries


def _json(text: str, place: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CommandError(f"{place}: not valid JSON: {error}") from None


def _manifest_item(source: Path, place: str, entry: Any, settings: dict[str, Any]) -> Item:
    if isinstance(entry, str):
        entry = {"scene": entry}
    if not isinstance(entry, dict) or not isinstance(entry.get("scene"), str):
        raise CommandError(f'{place}: accepted: a path, or an object with "scene"')
    unknown = sorted(entry.keys() - {"scene", "output", "settings"})
    if unknown:
        raise CommandError(
            f"{place}: unknown field (found {unknown[0]}); accepted: scene, output, settings"
        )
    own = entry.get("settings", {})
    if not isinstance(own, dict):
        raise CommandError(f"{place}: settings: not an object (found {own!r})")
    merged = {**settings, **own}
    settings_of(merged, place)
    scene = entry["scene"]
    beside = source.parent / scene
    file = beside if _is_file(beside) else _bundled(scene, beside)
    name = _output_name(entry.get("output", Path(scene).stem), place)
    return Item(scene, file, name, merged)


def _bundled(scene: str, beside: Path) -> Path:
    """The file of a bundled scene's name; else the path itself, whose render will fail alone."""
    if Path(scene).name != scene or Path(scene).suffix:
        return beside
    try:
        return resolve_scene(scene)
    except CommandError:
        return beside


def _output_name(output: Any, place: str) -> str:
    """The stem of the outputs, inside the output folder."""
    if not isinstance(output, str) or not output:
        raise CommandError(f"{place}: output: not a name (found {output!r})")
    for extension in OUTPUTS:
        output = output.removesuffix("." + extension)
    path = PurePosixPath(output)
    if path.is_absolute() or ".." in path.parts or not path.name or path.parts[0].startswith("."):
        raise CommandError(
            f"{place}: output: leads out of the output folder (found {output}); "
            "accepted: a relative path"
        )
    return str(path)
