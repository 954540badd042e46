"""Help, version, usage errors, and what is imported for them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .support import Run, raykiln_process

COMMANDS = [
    "render",
    "batch",
    "inspect",
    "compare",
    "scenes",
    "serve",
    "submit",
    "list",
    "status",
    "watch",
    "download",
    "cancel",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(raykiln: Run, command: str) -> None:
    ran = raykiln(command, "--help")
    assert ran.code == 0
    assert f"raykiln {command}" in ran.out


def test_version(raykiln: Run) -> None:
    import raykiln as module

    ran = raykiln("--version")
    assert (ran.code, ran.out) == (0, f"raykiln {module.__version__}\n")


def test_without_a_command_the_help_is_shown(raykiln: Run) -> None:
    ran = raykiln()
    assert ran.code == 2
    assert "Usage: raykiln" in ran.out + ran.err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["paint"], "No such command 'paint'"),
        (["render"], "Missing argument 'SCENE'"),
        (["render", "cornell_box", "--spp"], "--spp"),
        (["render", "cornell_box", "--spp", "many"], "--spp: "),
        (["render", "cornell_box", "--quick"], "No such option: --quick"),
        (["batch", "."], "--output"),
        (["serve", "--port", "http"], "--port: "),
        (["list", "--limit", "0"], "--limit: out of range (found 0); accepted: 1 up"),
        (["list", "--label", "x"], "--label: not a label (found x); accepted: KEY=VALUE"),
    ],
)
def test_bad_usage_is_one_line(raykiln: Run, line: list[str], message: str) -> None:
    ran = raykiln(*line)
    assert ran.code == 2
    assert message in ran.error


def test_the_console_script_prints_one_line_too(tmp_path: Path) -> None:
    ran = raykiln_process("render", "nothing.json", cwd=tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert ran.error == "nothing.json: no such file"


@pytest.mark.parametrize(
    ("line", "unwanted"),
    [
        (["--help"], "fastapi sqlalchemy httpx numpy pydantic raykiln"),
        (["render", "nothing.json"], "fastapi sqlalchemy httpx uvicorn alembic"),
        (["submit", "nothing.json"], "fastapi sqlalchemy uvicorn alembic"),
    ],
)
def test_a_command_imports_only_what_it_needs(line: list[str], unwanted: str) -> None:
    code = (
        "import sys\nfrom raykiln_service.cli import run\n"
        f"run({line!r})\n"
        f"print('loaded:', *sorted(set({unwanted!r}.split()) & sys.modules.keys()))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines()[-1] == "loaded:"


def test_importing_raykiln_waits_for_nothing_heavy() -> None:
    program = (
        "import sys, raykiln; print(sorted({'numpy', 'pydantic', 'httpx'} & set(sys.modules)))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "[]\n"
