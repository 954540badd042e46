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
    "memory": set(),
    "sampling": {"math", "memory"},
    "image": {"math"},
    "scene": {"math", "memory", "sampling", "image"},
    "texture": {"math", "sampling", "image", "scene"},
    "bsdf": {"math", "sampling", "image", "scene", "texture"},
    "light": {"math", "sampling", "image", "scene", "texture"},
    "camera": {"math", "sampling", "image", "scene"},
    "medium": {"math", "sampling", "image", "scene"},
    "guide": {"math", "memory", "sampling"},
    "isa": set(),
    "accel": {"math", "memory", "sampling", "image", "scene", "isa"},
}
CPP_ARROWS["integrator"] = set(CPP_ARROWS)
CPP_ARROWS["wide"] = set(CPP_ARROWS)
CPP_ARROWS["render"] = set(CPP_ARROWS)
CPP_ARROWS["bindings"] = set(CPP_ARROWS)

# Libraries that one room keeps to itself.
CPP_LIBRARIES: dict[str, set[str]] = {
    "embree": {"accel"},
    "OpenImageIO": {"image"},
    "Imf": {"image"},
    "png.h": {"image"},
    "pybind11": {"bindings"},
    "tbb": {"accel", "render"},
}


class Room(NamedTuple):
    """Modules that belong together (with all below them), and the rooms they may import."""

    modules: set[str]
    may_import: set[str]


_CORE = {"errors", "scene", "image", "formats", "_core"}
_COMPILED = ("raykiln._core", "raykiln._image", "raykiln._oiio")
# The longest module name that fits says in which room a module is.
PYTHON_ROOMS: dict[str, Room] = {
    "_core": Room({"raykiln._core"}, set()),
    "errors": Room({"raykiln.errors"}, set()),
    "scene": Room(
        {
            f"raykiln.{name}"
            for name in ("arrays", "frames", "metals", "primitives", "scene", "settings", "studio")
        },
        {"errors"},
    ),
    "_image": Room({"raykiln._image", "raykiln._oiio"}, set()),
    "image": Room({"raykiln.image"}, {"errors", "_image"}),
    "formats": Room({"raykiln.formats"}, {"errors", "scene", "image"}),
    "renderer": Room({"raykiln"}, _CORE),
    "jobs": Room(
        {f"raykiln_service.{name}" for name in ("errors", "files", "jobs", "logs", "planner")}
        | {"raykiln_service.access"}
        | {"raykiln_service", "raykiln_service.settings"}
        | {f"raykiln_service.webhooks.{name}" for name in ("addresses", "signatures")},
        set(),
    ),
    "store": Room(
        {f"raykiln_service.{name}" for name in ("database", "leases", "rows", "store")}
        | {f"raykiln_service.{name}" for name in ("beside", "idempotency", "ownership", "quotas")}
        | {f"raykiln_service.{name}" for name in ("tables_access", "tokens", "upload_rows")}
        | {f"raykiln_service.{name}" for name in ("migrations", "store_base", "store_queue")}
        | {"raykiln_service.store_retention", "raykiln_service.outbox", "raykiln_service.replies"}
        | {
            f"raykiln_service.{name}"
            for name in ("tables", "tables_frames", "tables_webhooks", "units")
        },
        {"jobs"},
    ),
    "assets": Room(
        {f"raykiln_service.{name}" for name in ("assets", "bundles", "cache", "retention")}
        | {"raykiln_service.uploads"},
        {"jobs", "store", "renderer", "formats"},
    ),
    "events": Room(
        {f"raykiln_service.{name}" for name in ("events", "metrics", "queueing", "telemetry")},
        {"jobs", "store"},
    ),
    "webhooks": Room({"raykiln_service.webhooks"}, {"jobs", "store", "events", "renderer"}),
    "executors": Room(
        {"raykiln_service.executors"},
        {"jobs", "sandbox", "assets", "renderer", "scene", "image"},
    ),
    "sandbox": Room({"raykiln_service.sandbox"}, set()),
    "dispatcher": Room(
        {f"raykiln_service.{name}" for name in ("attempt", "attempt_frames", "dispatcher")},
        {"jobs", "store", "assets", "events", "executors"},
    ),
    "routes": Room(
        {f"raykiln_service.{name}" for name in ("framing", "routes", "schemas", "schemas_frames")}
        | {
            "raykiln_service.archive",
            "raykiln_service.submission",
            "raykiln_service.schemas_webhooks",
        },
        {"jobs", "store", "assets", "events", "renderer", "errors", "scene", "image"},
    ),
    "app": Room(
        {f"raykiln_service.{name}" for name in ("app", "middleware", "observing", "openapi")}
        | {"raykiln_service.protocol", "raykiln_service.service"},
        {"jobs", "store", "assets", "events", "executors", "dispatcher", "routes", "webhooks"}
        | {"renderer", "errors"},
    ),
    "client": Room({"raykiln_service.client"}, {"jobs", "formats"}),
    "commands": Room(
        {"raykiln_service.cli", "raykiln_service.commands"},
        {"jobs", "store", "assets", "client", "app", "renderer", "scene", "image"},
    ),
}

# Where a library may be imported: the renderer needs few, and `import raykiln` stays quick.
PYTHON_LIBRARIES: dict[str, set[str]] = {
    "sqlalchemy": {"store", "webhooks", "dispatcher", "app"},
    "alembic": {"store"},
    "fastapi": {"routes", "app"},
    "starlette": {"routes", "app"},
    "uvicorn": {"app"},
    "httpx": {"client"},
    "opentelemetry": {"events"},
    "PIL": {"executors"},
    "av": {"executors"},
    "typer": {"commands"},
    "rich": {"commands"},
}

_INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)


class Arrow(NamedTuple):
    """`file` includes or imports `target`, and with that its room looks into another."""

    file: str
    source: str
    target: str


def cpp_arrows(root: Path) -> Iterator[Arrow]:
    """Every include between rooms of `root`/core, and of a library that has a room."""
    root = root.resolve()
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
    library = re.match(r"(embree|OpenImageIO|Imf|png\.h|pybind11|tbb)", included)
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
        if name in modules or name in _COMPILED:
            return name
        name = name.rpartition(".")[0]
    return None


def room_of(module: str) -> str:
    """The room of `PYTHON_ROOMS` that a module is in."""
    rooms = {name: room for room, (names, _) in PYTHON_ROOMS.items() for name in names}
    while module not in rooms:
        module = module.rpartition(".")[0]
    return rooms[module]


def wrong_python_arrows(root: Path) -> list[str]:
    """What the imports below `root` do that the tables above do not allow."""
    return [
        f"{arrow.file}: {arrow.source} must not import {arrow.target}"
        for arrow in python_arrows(root)
        if not _may_import(arrow.source, arrow.target)
    ]


def _may_import(source: str, target: str) -> bool:
    room = room_of(source)
    if target in PYTHON_LIBRARIES:
        return room in PYTHON_LIBRARIES[target]
    if room_of(target) == room:
        return True
    # Formats are reached through their registry only.
    is_inner_format = target.startswith("raykiln.formats.")
    return room_of(target) in PYTHON_ROOMS[room].may_import and not is_inner_format
