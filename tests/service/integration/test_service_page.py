"""The job page in a real browser, doing what a person does."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

_BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture
def page(server: Any) -> Iterator[Any]:
    """The job page; fails on any error in its script."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the browser driver is not installed"
    )
    if _BROWSER is None:
        pytest.skip("no browser is installed")
    errors: list[str] = []
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = driver.chromium.launch(executable_path=_BROWSER, args=arguments)
        page = browser.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(server.url)
        yield page
        browser.close()
    assert errors == []


def until(page: Any, expression: str) -> None:
    """Wait until an expression holds; by asking, as the page forbids scripts that are text."""
    deadline = time.monotonic() + 60
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, f"waited in vain for {expression}"
        time.sleep(0.1)


def test_submit_watch_cancel_open_and_delete(
    page: Any, tmp_path: Path, ball: dict[str, Any]
) -> None:
    scene = tmp_path / "ball.json"
    scene.write_text(json.dumps(ball))
    page.wait_for_selector("#none:not([hidden])")

    page.set_input_files("[name=file]", scene)
    page.fill("[name=width]", "200")
    page.fill("[name=height]", "100")
    page.fill("[name=spp]", "4")
    page.click("#submit button")
    page.wait_for_selector("li.succeeded")
    assert page.inner_text("li.succeeded strong") == "ball.json"
    until(page, "document.querySelector('li .open img').naturalWidth === 200")

    page.set_input_files("[name=file]", scene)
    page.fill("[name=spp]", "1000000")
    page.click("#submit button")
    until(page, "document.querySelector('li.running progress')?.value > 0")
    page.click("li.running .links button:has-text('Cancel')")
    page.wait_for_selector("li.cancelled")
    assert "partial image" in page.inner_text("li.cancelled .note")
    assert page.locator("li").first.get_attribute("class") == "cancelled"

    page.click("li.succeeded .open")
    until(page, "document.querySelector('#viewer img').naturalHeight === 100")
    page.keyboard.press("Escape")
    for state in ("succeeded", "cancelled"):
        page.click(f"li.{state} .links button:has-text('Delete')")
    page.wait_for_selector("#none:not([hidden])")


def test_a_refusal_is_shown_with_its_place(page: Any, tmp_path: Path, ball: Any) -> None:
    scene = tmp_path / "ball.json"
    scene.write_text(json.dumps({**ball, "shapes": [{"type": "sphere", "radius": -1}]}))
    page.set_input_files("[name=file]", scene)
    page.click("#submit button")
    until(page, "document.querySelector('#refusal').textContent !== ''")
    assert "/shapes/0/radius" in page.inner_text("#refusal")
    assert page.locator("li").count() == 0


def test_the_api_page_shows_the_calls(page: Any, server: Any) -> None:
    page.goto(f"{server.url}/docs")
    page.wait_for_selector("h3:has-text('POST /v1/jobs')")
