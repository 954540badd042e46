"""Includes and imports run one way only."""

from __future__ import annotations

from pathlib import Path

import pytest
from architecture_rules import (
    CPP_ARROWS,
    PYTHON_ROOMS,
    cpp_arrows,
    python_arrows,
    wrong_cpp_arrows,
    wrong_python_arrows,
)


def test_includes_follow_the_arrows(repo_root: Path) -> None:
    assert list(cpp_arrows(repo_root)), "no include was read: is the core somewhere else?"
    assert wrong_cpp_arrows(repo_root) == []


def test_imports_follow_the_arrows(repo_root: Path) -> None:
    assert list(python_arrows(repo_root)), "no import was read: are the packages somewhere else?"
    assert wrong_python_arrows(repo_root) == []


@pytest.mark.parametrize(
    "arrows",
    [CPP_ARROWS, {name: room.may_import for name, room in PYTHON_ROOMS.items()}],
    ids=["includes", "imports"],
)
def test_the_arrows_make_no_circle(arrows: dict[str, set[str]]) -> None:
    open_rooms = {room: targets - {room} for room, targets in arrows.items()}
    while open_rooms:
        done = {room for room, targets in open_rooms.items() if not targets & set(open_rooms)}
        assert done, f"a circle among {sorted(open_rooms)}"
        open_rooms = {room: targets for room, targets in open_rooms.items() if room not in done}


@pytest.mark.parametrize(
    ("file", "line", "complaint"),
    [
        ("math/vec.h", '#include "scene/scene.h"', "math must not include scene"),
        ("scene/scene.h", '#include "../bsdf/bsdf.h"', "scene must not include bsdf"),
        ("bsdf/bsdf.h", '#include "light/light.h"', "bsdf must not include light"),
        ("render/film.cpp", "#include <embree4/rtcore.h>", "render must not include embree"),
        (
            "scene/scene.h",
            "#  include <OpenImageIO/imageio.h>",
            "scene must not include OpenImageIO",
        ),
        ("render/film.cpp", "#include <pybind11/numpy.h>", "render must not include pybind11"),
        ("attic/old.h", '#include "math/vec.h"', "attic must not include math"),
    ],
)
def test_a_wrong_include_is_found(tmp_path: Path, file: str, line: str, complaint: str) -> None:
    source = tmp_path / "core" / "src"
    for header in ("math/vec.h", "scene/scene.h", "bsdf/bsdf.h", "light/light.h"):
        (source / header).parent.mkdir(parents=True)
        (source / header).write_text("#pragma once\n")
    (source / file).parent.mkdir(exist_ok=True)
    (source / file).write_text(f"#pragma once\n{line}\n")
    assert wrong_cpp_arrows(tmp_path) == [f"core/src/{file}: {complaint}"]


@pytest.mark.parametrize(
    ("module", "line", "target"),
    [
        ("raykiln.rendering", "import raykiln_service.jobs", "raykiln_service.jobs"),
        ("raykiln.rendering", "from raykiln_service import jobs", "raykiln_service.jobs"),
        ("raykiln.scene", "from raykiln import formats", "raykiln.formats"),
        ("raykiln.rendering", "from raykiln.formats import gltf", "raykiln.formats.gltf"),
        ("raykiln.formats.gltf", "import raykiln.rendering", "raykiln.rendering"),
        ("raykiln_service.routes.jobs", "from ..executors import local", "executors.local"),
        (
            "raykiln_service.executors.local",
            "from raykiln_service.routes import jobs",
            "routes.jobs",
        ),
        ("raykiln_service.jobs", "def f():\n    from . import store", "raykiln_service.store"),
        ("raykiln.rendering", "import sqlalchemy as sa", "sqlalchemy"),
        ("raykiln_service.jobs", "from fastapi import FastAPI", "fastapi"),
    ],
)
def test_a_wrong_import_is_found(tmp_path: Path, module: str, line: str, target: str) -> None:
    modules = {"raykiln.rendering", "raykiln.scene", "raykiln.formats.gltf", "raykiln_service.jobs"}
    modules |= {"raykiln_service.routes.jobs", "raykiln_service.executors.local"}
    for name in sorted(modules | {"raykiln_service.store"}):
        folder = tmp_path / ("service" if name.startswith("raykiln_service") else "core")
        path = folder.joinpath(*name.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        for package in path.parent.relative_to(folder).parents:
            (folder / package / "__init__.py").touch()
        (path.parent / "__init__.py").touch()
        path.write_text(f"{line}\n" if name == module else "")
    (complaint,) = wrong_python_arrows(tmp_path)
    assert f"{module} must not import " in complaint
    assert complaint.endswith(target)
