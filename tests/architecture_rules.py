"""The arrows that `docs/explanation/architecture.md` draws, and the code that reads arrows."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

# A room of the C++ core is a folder of core/src, and `error.h` is open to all of them.
CPP_ARROWS: dict[str, set[str]] = {
    "math": set(),
    "sampling": {"math"},
    "image": {"math"},
    "scene": {"math", "sampling", "image"},
    "bsdf": {"math", "sampling", "image", "scene"},
    "light": {"math", "sampling", "image", "scene"},
    "camera": {"math", "sampling", "image", "scene"},
    "medium": {"math", "sampling", "image", "scene"},
    "texture": {"math", "sampling", "image", "scene"},
    "accel": {"math", "sampling", "image", "scene"},
}
CPP_ARROWS["integrator"] = set(CPP_ARROWS)
CPP_ARROWS["render"] = set(CPP_ARROWS)
CPP_ARROWS["bindings"] = set(CPP_ARROWS)

# Libraries that one room keeps to itself.
CPP_LIBRARIES: dict[str, set[str]] = {
    "embree": {"accel"},
    "OpenImageIO": {"image"},
    "pybind11": {"bindings"},
    "tbb": {"accel", "render"},
}

# A room of the Python packages is a module or a package; the longest name that fits counts.
_SCENE = {"raykiln.errors", "raykiln.arrays", "raykiln.settings", "raykiln.scene"}
_LEAVES = {"raykiln_service.errors", "raykiln_service.jobs", "raykiln_service.settings"}
_STORES = {"raykiln_service.store", "raykiln_service.assets", "raykiln_service.planner"}
PYTHON_ARROWS: dict[str, set[str]] = {
    "raykiln.errors": set(),
    "raykiln.arrays": {"raykiln.errors"},
    "raykiln.settings": {"raykiln.errors"},
    "raykiln.scene": _SCENE,
    "raykiln.image": {"raykiln.errors", "raykiln._core"},
    "raykiln.formats": {*_SCENE, "raykiln.image"},
    "raykiln": {*_SCENE, "raykiln.image", "raykiln.formats", "raykiln._core"},
    "raykiln_service.errors": {"raykiln.errors"},
    "raykiln_service.jobs": {"raykiln_service.errors"},
    "raykiln_service.settings": {"raykiln_service.errors"},
    "raykiln_service.store": {*_LEAVES, "raykiln_service.migrations"},
    "raykiln_service.migrations": set(),
    "raykiln_service.assets": _LEAVES,
    "raykiln_service.planner": _LEAVES,
    "raykiln_service.executors": {*_LEAVES, "raykiln_service.planner", "raykiln"},
    "raykiln_service.dispatcher": {*_LEAVES, *_STORES, "raykiln_service.executors"},
    "raykiln_service.schemas": {*_LEAVES, "raykiln"},
    "raykiln_service.routes": {*_LEAVES, *_STORES, "raykiln_service.schemas", "raykiln"},
    "raykiln_service.app": {
        *_LEAVES,
        *_STORES,
        "raykiln_service.executors",
        "raykiln_service.dispatcher",
        "raykiln_service.schemas",
        "raykiln_service.routes",
        "raykiln",
    },
    "raykiln_service.client": {"raykiln_service.errors", "raykiln_service.jobs", "raykiln"},
    "raykiln_service.commands": {
        "raykiln_service.errors",
        "raykiln_service.settings",
        "raykiln_service.app",
        "raykiln_service.client",
        "raykiln",
    },
    "raykiln_service.cli": {"raykiln_service.commands", "raykiln"},
    "raykiln_service": set(),
}

# Where a library may be imported; the renderer's own needs stay few.
PYTHON_LIBRARIES: dict[str, set[str]] = {
    "sqlalchemy": {"raykiln_service.store", "raykiln_service.migrations"},
    "alembic": {"raykiln_service.store", "raykiln_service.migrations"},
    "fastapi": {"raykiln_service.app", "raykiln_service.routes"},
    "starlette": {"raykiln_service.app", "raykiln_service.routes"},
    "uvicorn": {"raykiln_service.app"},
    "httpx": {"raykiln_service.client"},
    "typer": {"raykiln_service.cli", "raykiln_service.commands"},
    "rich": {"raykiln_service.cli", "raykiln_service.commands"},
}


_INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)


class Arrow(NamedTuple):
    """`file` includes or imports `target`, and with that its room looks into another."""

    file: str
    source: str
    target: str


def cpp_arrows(root: Path) -> Iterator[Arrow]:
    """Every include between rooms of `root`/core, and of a library that has a room."""
    for folder in (root / "core" / "src", root / "core" / "bindings"):
        for path in sorted(folder.rglob("*")):
            if path.suffix not in {".h", ".cpp", ".inl"}:
                continue
            inside = path.relative_to(folder)
            room = "bindings" if folder.name == "bindings" else _first_folder(inside)
            for included in _INCLUDE.findall(path.read_text()):
                target = _cpp_target(included, path, root)
                if target not in (None, room):
                    yield Arrow(str(path.relative_to(root)), room, str(target))


def _first_folder(path: Path) -> str:
    return path.parts[0] if len(path.parts) > 1 else ""


def _cpp_target(included: str, path: Path, root: Path) -> str | None:
    library = re.match(r"(embree|OpenImageIO|pybind11|tbb)", included)
    if library:
        return library[0]
    source = root / "core" / "src"
    for candidate in (path.parent / included, source / included):
        if candidate.is_file() and source in candidate.resolve().parents:
            return _first_folder(candidate.resolve().relative_to(source)) or None
    return None


def wrong_cpp_arrows(root: Path) -> list[str]:
    """What the includes below `root` do that `CPP_ARROWS` and `CPP_LIBRARIES` do not allow."""
    wrong = []
    for arrow in cpp_arrows(root):
        if arrow.target in CPP_LIBRARIES:
            allowed = arrow.source in CPP_LIBRARIES[arrow.target]
        elif arrow.source == "":
            allowed = False
        else:
            allowed = arrow.target in CPP_ARROWS.get(arrow.source, set())
        if not allowed:
            room = arrow.source or "core/src"
            wrong.append(f"{arrow.file}: {room} must not include {arrow.target}")
    return wrong


def python_arrows(root: Path) -> Iterator[Arrow]:
    """Every import between rooms of the Python packages, and of a library that has its rooms."""
    modules = dict(_python_modules(root))
    for module, path in modules.items():
        for imported in _imported_names(ast.parse(path.read_text(), str(path)), module, path):
            target = _python_target(imported, modules)
            if target is not None and target != module:
                yield Arrow(str(path.relative_to(root)), module, target)


def _python_modules(root: Path) -> Iterator[tuple[str, Path]]:
    for folder in (root / "core", root / "service"):
        for package in ("raykiln", "raykiln_service"):
            for path in sorted((folder / package).rglob("*.py")):
                parts = path.relative_to(folder).with_suffix("").parts
                yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def _imported_names(tree: ast.AST, module: str, path: Path) -> Iterator[str]:
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base]).rstrip(".")
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _python_target(imported: str, modules: dict[str, Path]) -> str | None:
    """The module of ours, or the library of `PYTHON_LIBRARIES`, that an import names."""
    if imported.split(".")[0] in PYTHON_LIBRARIES:
        return imported.split(".")[0]
    name = imported
    while name:
        if name in modules or name == "raykiln._core":
            return name
        name = name.rpartition(".")[0]
    return None


def room_of(module: str) -> str:
    """The room of `PYTHON_ARROWS` that a module lies in."""
    while module not in PYTHON_ARROWS and "." in module:
        module = module.rpartition(".")[0]
    return module


def wrong_python_arrows(root: Path) -> list[str]:
    """What the imports below `root` do that the tables above do not allow."""
    wrong = []
    for arrow in python_arrows(root):
        source, target = room_of(arrow.source), room_of(arrow.target)
        if arrow.target in PYTHON_LIBRARIES:
            allowed = source in PYTHON_LIBRARIES[arrow.target]
        elif target == "raykiln.formats" and source != target:
            # Formats are reached through their registry only.
            allowed = target in PYTHON_ARROWS[source] and arrow.target == target
        else:
            allowed = source == target or target in PYTHON_ARROWS.get(source, set())
        if not allowed:
            wrong.append(f"{arrow.file}: {arrow.source} must not import {arrow.target}")
    return wrong
