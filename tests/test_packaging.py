"""The distribution: one version, pinned dependencies, and everything that an installation needs."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
import raykiln as rk
import raykiln._core


@pytest.fixture(scope="module")
def declared(repo_root: Path) -> dict[str, Any]:
    """What pyproject.toml says."""
    return tomllib.loads((repo_root / "pyproject.toml").read_text())


def tracked_files(root: Path) -> list[str]:
    """The files under version control, or a skip where this is not a checkout."""
    command = ["git", "ls-files", "-z"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip("not a git checkout")
    return [name for name in done.stdout.split("\0") if name]


def test_there_is_one_version(declared: dict[str, Any]) -> None:
    wanted = declared["project"]["version"]
    assert rk.__version__ == wanted
    assert raykiln._core.__version__ == wanted
    try:
        assert version("raykiln") == wanted
    except PackageNotFoundError:
        pytest.skip("used from its source folder, not installed")


def test_every_dependency_is_pinned(repo_root: Path, declared: dict[str, Any]) -> None:
    lines = (repo_root / "constraints.txt").read_text().splitlines()
    pins = {line.partition("==")[0] for line in lines if "==" in line}
    project = declared["project"]
    wanted = [*project["dependencies"], *declared["build-system"]["requires"]]
    wanted += [need for extra in project["optional-dependencies"].values() for need in extra]
    names = {re.split(r"[\[>]", need)[0].lower().replace("_", "-") for need in wanted}
    assert names <= pins


def imported_libraries(folder: Path) -> set[str]:
    """Top-level names of what the Python files below `folder` import and is not ours."""
    names = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(str(node.module).partition(".")[0])
    return names - sys.stdlib_module_names - {"raykiln", "raykiln_service"}


def test_every_imported_library_is_declared(repo_root: Path, declared: dict[str, Any]) -> None:
    project = declared["project"]
    extras = project["optional-dependencies"]
    shipped = set(extras) - {"test", "lint", "postgres"}  # its driver is SQLAlchemy's to import
    needs = [*project["dependencies"], *(need for extra in shipped for need in extras[extra])]
    named = {need.partition(">")[0].strip().replace("-", "_") for need in needs}
    # Libraries that are imported by another name than they are installed by.
    named = {
        "PIL" if name == "pillow" else re.sub("^opentelemetry_.*", "opentelemetry", name)
        for name in named
    }
    imported = imported_libraries(repo_root / "core") | imported_libraries(repo_root / "service")
    # FastAPI is made of Starlette and re-exports only a part of it.
    assert imported - {"starlette"} <= named
    assert named <= imported, "declared and never imported"


def test_the_container_copies_all_of_the_package(repo_root: Path) -> None:
    dockerfile = (repo_root / "docker" / "Dockerfile").read_text()
    ignored = (repo_root / ".dockerignore").read_text().splitlines()
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", dockerfile, re.MULTILINE)
    sources = {source for line in copied for source in line.split()}
    assert {"core", "service", "scenes", "pyproject.toml", "constraints.txt"} <= sources
    for source in sources:
        assert (repo_root / source).exists()
        assert any(f"!{source}".startswith(kept.rstrip("/")) for kept in ignored if kept != "*")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_wheel_holds_what_it_needs(repo_root: Path, tmp_path: Path) -> None:
    """Built from a copy of the tracked files, so that nothing lying about gets in."""
    source = tmp_path / "source"
    for name in tracked_files(repo_root):
        if (repo_root / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(repo_root / name, source / name)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "-w", str(tmp_path), str(source)], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    packages = [("core", "raykiln"), ("service", "raykiln_service")]
    for folder, package in packages:
        inside = [p for p in (source / folder / package).rglob("*") if p.is_file()]
        assert {str(p.relative_to(source / folder)) for p in inside} <= held
    scenes = {p for p in (source / "scenes").rglob("*") if p.is_file()}
    sources = {p for p in scenes if "generate" in p.parts}
    assert scenes - sources, "no bundled scenes"
    assert {f"raykiln/{p.relative_to(source)}" for p in scenes - sources} <= held
    assert not {f"raykiln/{p.relative_to(source)}" for p in sources} & held
    compiled = {name.partition(".")[0] for name in held if name.endswith(".so")}
    assert compiled == {"raykiln/_core", "raykiln/_image", "raykiln/_oiio"}
    assert any(name.endswith("LICENSE") for name in held)
    assert not any(name.endswith((".cpp", ".h")) for name in held)
