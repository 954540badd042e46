"""Fixtures of the format tests."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import pytest
from format_support import LoadText
from raykiln.formats import load
from raykiln.scene import Scene


@pytest.fixture
def load_text(tmp_path: Path) -> LoadText:
    """Write a text as a file and load it; further keyword texts are written beside it."""

    def write_and_load(name: str, text: str, **others: str | bytes) -> Scene:
        for other, content in others.items():
            path = tmp_path / other.replace("__", ".")
            if isinstance(content, bytes):
                path.write_bytes(content)
            else:
                path.write_text(content)
        (tmp_path / name).write_text(text)
        return load(tmp_path / name)

    return write_and_load


@pytest.fixture(scope="session")
def mitsuba() -> Any:
    """Mitsuba 3 in its scalar RGB variant, as a second opinion."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module = pytest.importorskip("mitsuba", reason="Mitsuba is the oracle of these tests")
        module.set_variant("scalar_rgb")
        module.set_log_level(module.LogLevel.Error)
    return module
