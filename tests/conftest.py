"""What all tests share: where things are, and how Hypothesis behaves."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# What a shell starts in the background ignores interrupts, and so would all the programs that the
# tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

REPO_ROOT = Path(__file__).resolve().parent.parent

# The same examples in every run, and no time limit: machines differ, results must not.
settings.register_profile(
    "raykiln",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("raykiln")


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """The root of the checkout."""
    return REPO_ROOT


@pytest.fixture(scope="session")
def shared_folder(repo_root: Path) -> Path:
    """The folder of files shared between checkouts: `RAYKILN_SHARED`, or `../shared`."""
    folder = Path(os.environ.get("RAYKILN_SHARED", repo_root.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no shared folder at {folder} (set RAYKILN_SHARED)")
    return folder


@pytest.fixture(scope="session")
def shared_assets(shared_folder: Path) -> Path:
    """Public scenes and images that are too large to keep here."""
    assets = shared_folder / "assets"
    if not assets.is_dir():
        pytest.skip(f"no shared assets at {assets}")
    return assets


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A fresh data folder for a service."""
    folder = tmp_path / "raykiln-data"
    folder.mkdir()
    return folder
