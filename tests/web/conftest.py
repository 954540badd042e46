"""A browser, the service, and a page of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from .support import Service

_BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
_ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for a module's tests; while it is open, an event loop runs in this thread."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the browser driver is not installed"
    )
    if _BROWSER is None:
        pytest.skip("no browser is installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=_BROWSER, args=_ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def module_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service for a module's tests."""
    service = Service(tmp_path_factory.mktemp("service"))
    service.start()
    yield service
    service.kill()


@pytest.fixture
def service(module_service: Service) -> Iterator[Service]:
    """The same; what a test submits to it is gone after the test."""
    keep = {job["id"] for job in module_service.jobs()}
    yield module_service
    module_service.clear(keep)


@pytest.fixture
def own_service(tmp_path: Path) -> Iterator[Service]:
    """A service that one test may end; it has to start it."""
    service = Service(tmp_path)
    yield service
    service.kill()


class Tab:
    """Opens pages; notes what goes wrong in them and whom they call."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self._contexts: list[Any] = []
        self.errors: list[str] = []
        self.requests: list[str] = []

    def __call__(self, url: str, **options: Any) -> Any:
        """A page in a context of its own, with the options of the context."""
        context = self._browser.new_context(**options)
        context.set_default_timeout(60_000)
        self._contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda message: self._note(message.text))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(url)
        return page

    def _note(self, text: str) -> None:
        if "Content Security Policy" in text or "Content-Security-Policy" in text:
            self.errors.append(text)

    def close(self) -> None:
        """Close all of them."""
        for context in self._contexts:
            context.close()


@pytest.fixture
def tab(browser: Any) -> Iterator[Tab]:
    """Opens pages: `tab(url)`; fails the test on any error in a script, or of the policy."""
    tab = Tab(browser)
    yield tab
    tab.close()
    assert tab.errors == []
