"""The documentation: its examples run, its links lead somewhere, and it names everything."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import httpx
import pytest
import raykiln as rk
from doc_pages import (
    DOCUMENTED_SERVER,
    anchors_of,
    blocks_of,
    run_examples,
    service,
    without_blocks,
)
from pydantic import BaseModel
from raykiln_service.cli import app
from raykiln_service.settings import ServiceSettings
from typer.core import TyperGroup, TyperOption
from typer.main import get_command

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
REFERENCE = ROOT / "docs" / "reference"


def page_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def has_examples(page: Path) -> bool:
    return any(block.is_run for block in blocks_of(page.read_text()))


@pytest.mark.parametrize("page", [*filter(has_examples, PAGES)], ids=page_name)
def test_examples_run(page: Path, tmp_path: Path, data_dir: Path) -> None:
    text = page.read_text()
    folder = tmp_path / "work"
    folder.mkdir()
    if any(block.is_run and DOCUMENTED_SERVER in block.text for block in blocks_of(text)):
        with service(data_dir) as server:
            run_examples(text, folder, server)
    else:
        run_examples(text, folder)


@pytest.mark.parametrize(
    "example",
    [
        "```python\nx = 1\n```\n```python\nassert x == 2\n```\n",
        "```console\n$ false\n$ true\n```\n",
        "```console\n$ x=1\n```\nand\n```console\n$ test $x = 2\n```\n",
    ],
)
def test_a_failing_example_is_noticed(example: str, tmp_path: Path) -> None:
    run_examples(example.replace("2", "1").replace("false", "true"), tmp_path)
    with pytest.raises(AssertionError, match="exit code 1"):
        run_examples(example, tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_blocks(page.read_text())):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors_of(target.read_text())):
            broken.append(link)
    assert broken == []


def test_every_setting_has_a_heading() -> None:
    named = re.findall(r"^### (\w+)$", (REFERENCE / "settings.md").read_text(), re.MULTILINE)
    assert set(named) == {*rk.RenderSettings.model_fields, *ServiceSettings.model_fields}


def test_every_statistic_is_explained() -> None:
    named = re.findall(r"^\| `(\w+)` \|", (REFERENCE / "stats.md").read_text(), re.MULTILINE)
    assert set(named) == {field.name for field in fields(rk.RenderStats)}


def models_within(annotation: Any, found: dict[str, type[BaseModel]]) -> dict[str, type[BaseModel]]:
    """The pydantic models that a type is made of, by name."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation.__name__ in found:
            return found
        found[annotation.__name__] = annotation
        for field in annotation.model_fields.values():
            models_within(field.annotation, found)
    for part in get_args(annotation):
        models_within(part, found)
    return found


# `settings` has a page of its own, with a test of its own.
SCENE_MODELS = models_within(rk.Scene, {"RenderSettings": rk.RenderSettings})


@pytest.mark.parametrize(
    "model",
    [model for name, model in SCENE_MODELS.items() if name != "RenderSettings"],
    ids=lambda m: m.__name__,
)
def test_every_scene_field_is_explained(model: type[BaseModel]) -> None:
    page = (REFERENCE / "scene.md").read_text()
    named = set(re.findall(r"`(\w+)`", page))
    in_files = {name for name, field in model.model_fields.items() if not field.exclude}
    assert in_files - {"type"} <= named
    if "type" in in_files:
        kind = model.model_fields["type"].default
        assert re.search(rf'^### {kind}$|`"type": "{kind}"`', page, re.MULTILINE)


def test_every_route_is_explained(data_dir: Path) -> None:
    named = re.findall(
        r"^\| `([A-Z]+ [^`]+)` \|", (REFERENCE / "http.md").read_text(), re.MULTILINE
    )
    with service(data_dir) as server:
        paths = httpx.get(f"{server}/openapi.json", timeout=60).raise_for_status().json()["paths"]
    served = {f"{method.upper()} {path}" for path, calls in paths.items() for method in calls}
    assert _placeholders(served) <= _placeholders(set(named))


def _placeholders(routes: set[str]) -> set[str]:
    return {re.sub(r"\{\w+(:\w+)?\}", "{}", route) for route in routes}


def test_every_option_is_explained() -> None:
    page = (REFERENCE / "cli.md").read_text()
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    missing = []
    for name, command in group.commands.items():
        if f"raykiln {name}" not in page:
            missing.append(name)
        for option in command.params:
            if isinstance(option, TyperOption) and not option.hidden:
                long_name = max(option.opts, key=len)
                if not re.search(rf"{long_name}\b", page):
                    missing.append(f"{name} {long_name}")
    assert missing == []
