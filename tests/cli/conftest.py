"""Running the command in this process, and small scenes for it."""

from __future__ import annotations

from pathlib import Path

import pytest
from raykiln_service.cli import run

from .support import Ran, Run, write_scene


@pytest.fixture
def raykiln(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Run:
    """Run one command line in this process, in the folder `tmp_path`."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Ran:
        capfd.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capfd.readouterr()
        assert "Traceback" not in captured.err
        return Ran(int(code), captured.out, captured.err)

    return call


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene that renders in an instant."""
    return write_scene(tmp_path / "ball.json")


@pytest.fixture
def long_scene(tmp_path: Path) -> Path:
    """A scene that takes far longer to render than any test waits."""
    settings = {"width": 512, "height": 512, "spp": 1 << 20}
    return write_scene(tmp_path / "long.json", settings=settings)
