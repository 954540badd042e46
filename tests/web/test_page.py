"""What holds for every page: no trust, no strangers, no one left out, and no giving up."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

import pytest

from .support import BALL, FOREVER, QUICK, Service, until

MARKUP = "<img src=x onerror=\"document.title='taken'\"><script>alert(1)</script>"


def test_texts_of_others_stay_texts(tab: Any, service: Service) -> None:
    hostile = {**BALL, "name": MARKUP}
    with service.client() as client:
        name = f"{MARKUP[:60].replace('/', '')}.json"
        asset = client.post("/v1/assets", params={"filename": name}, json=hostile).json()["id"]
    job = service.finished(scene={"asset": asset}, settings=QUICK, labels={MARKUP: MARKUP})
    page = tab(f"{service.url}/")
    page.wait_for_selector(".card.succeeded")
    assert "<img" in page.inner_text(".card")
    page.click(".card a")
    page.wait_for_selector(".label")
    page.click("summary:has-text('From a terminal')")
    assert MARKUP in page.inner_text(".label")
    page.goto(f"{service.url}/#/?label={MARKUP}")
    page.wait_for_selector(".filters")
    page.goto(f"{service.url}/#/jobs/{MARKUP}")
    page.wait_for_selector(".empty")
    assert page.locator("main img[src=x], main script").count() == 0
    assert page.title() != "taken"
    assert job["labels"] == {MARKUP: MARKUP}


def test_it_talks_to_nobody_else(tab: Any, service: Service) -> None:
    job = service.finished(settings=QUICK)
    page = tab(f"{service.url}/")
    for place in ("#/new", f"#/jobs/{job['id']}", "#/"):
        page.goto(f"{service.url}/{place}")
        page.wait_for_timeout(500)
    hosts = {urlsplit(url).netloc for url in tab.requests if not url.startswith("blob:")}
    assert hosts == {urlsplit(service.url).netloc}
    policy = service.get("/").headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_the_service_goes_and_comes_back(tab: Any, own_service: Service) -> None:
    own_service.start()
    running = own_service.submit(settings=FOREVER)
    listed = tab(f"{own_service.url}/")
    listed.wait_for_selector(".card.running")
    page = tab(f"{own_service.url}/#/jobs/{running}")
    page.wait_for_selector(".badge.running")
    page.clock.install()
    own_service.kill()
    for one in (page, listed):
        one.wait_for_selector("#banner:not([hidden])")
    page.click("button:has-text('Cancel')")
    page.click("dialog button.danger")
    page.wait_for_selector(".trouble .bad:has-text('does not answer')")
    # Its time stands still, so this page comes back by the button only; the other one by itself.
    page.clock.pause_at(page.evaluate("Date.now()") + 60_000)
    own_service.start()
    assert page.is_visible("#banner")
    page.click("#retry")
    page.wait_for_selector("#banner", state="hidden")
    page.clock.resume()
    for one in (page, listed):
        one.wait_for_selector("#banner", state="hidden")
    # A cancel that did not arrive was none.
    listed.wait_for_selector(".card.running")
    page.click("button:has-text('Cancel')")
    page.click("dialog button.danger")
    page.wait_for_selector(".badge.cancelled")
    listed.wait_for_selector(".card.cancelled")


def test_the_token_is_asked_for_and_kept(tab: Any, tmp_path: Any) -> None:
    token = "a-token-of-the-test-0123456789"
    service = Service(tmp_path, RAYKILN_TOKEN=token)
    service.start()
    try:
        page = tab(f"{service.url}/")
        page.fill("dialog [name=token]", "wrong")
        page.keyboard.press("Enter")
        page.wait_for_selector("dialog [role=alert]:has-text('not accepted')")
        page.fill("dialog [name=token]", token)
        page.click("dialog button")
        page.wait_for_selector(".empty:not([hidden])")
        assert page.evaluate("sessionStorage.length + localStorage.length") == 1
        job = service.submit(settings={**QUICK, "aovs": ["depth"]})
        page.wait_for_selector(".card.succeeded img:visible")
        page.reload()
        page.click(".card a")
        page.wait_for_selector("[name=layer]", state="attached")
        with page.expect_download() as saved:
            page.click(".file:has-text('stats.json')")
        assert "rays_per_s" in saved.value.path().read_text()
        page.click("summary:has-text('From a terminal')")
        code = page.inner_text("pre[aria-label=curl]")
        assert token not in page.content()
        assert "$RAYKILN_TOKEN" in code
        assert job in page.url
        assert not any(token in url for url in tab.requests)
    finally:
        service.kill()


PLACES = ["#/", "#/new", "#/jobs/{job}", "docs"]


@pytest.fixture(scope="module")
def some_job(module_service: Service) -> dict[str, Any]:
    """A finished job with layers and a long label."""
    settings = {**QUICK, "aovs": ["albedo", "normal", "depth"]}
    return module_service.finished(settings=settings, labels={"a-label": "long" * 30})


@pytest.mark.parametrize("place", PLACES)
def test_a_phone_shows_all_without_sideways_scrolling(
    tab: Any, module_service: Service, some_job: dict[str, Any], place: str
) -> None:
    url = f"{module_service.url}/{place.format(job=some_job['id'])}"
    phone = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
    page = tab(url, **phone)
    page.wait_for_selector(".card, .gallery img, .timing, .call")
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    if "jobs" in place:
        page.wait_for_selector("[name=layer]", state="attached")
        page.tap(".segments label:has-text('Depth')")
        page.tap(".surface")
        until(lambda: "Depth" in page.inner_text(".inspector"))
        assert page.evaluate("document.documentElement.scrollWidth") <= 360


CONTRAST = """() => {
    const parsed = (colour) => {
        const canvas = new OffscreenCanvas(1, 1).getContext("2d");
        canvas.fillStyle = colour;
        canvas.fillRect(0, 0, 1, 1);
        return [...canvas.getImageData(0, 0, 1, 1).data];
    };
    const light = (rgb) => rgb.slice(0, 3).map((value) => value / 255)
        .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4))
        .reduce((sum, value, i) => sum + value * [0.2126, 0.7152, 0.0722][i], 0);
    const behind = (element) => {
        for (let one = element; one; one = one.parentElement) {
            const colour = getComputedStyle(one).backgroundColor;
            if (parsed(colour)[3] > 250) return parsed(colour);
        }
        return [255, 255, 255];
    };
    const poor = [];
    for (const element of document.querySelectorAll("body *")) {
        const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
        if (!own || !element.checkVisibility({ visibilityProperty: true }) || element.disabled) continue;
        if (element.closest(".stage, .unseen, option")) continue;
        const [a, b] = [light(parsed(getComputedStyle(element).color)), light(behind(element))];
        const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        if (ratio < 4.5) poor.push(`${element.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`);
    }
    return poor;
}"""  # noqa: E501


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("place", PLACES)
def test_texts_are_readable_by_day_and_night(
    tab: Any, module_service: Service, some_job: dict[str, Any], place: str, scheme: str
) -> None:
    url = f"{module_service.url}/{place.format(job=some_job['id'])}"
    page = tab(url, color_scheme=scheme)
    page.wait_for_selector(".card, .gallery img, .timing, .call")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(int(part) for part in dark[4:-1].split(",")) < 300) == (scheme == "dark")
    assert page.evaluate(CONTRAST) == []


@pytest.mark.parametrize("place", PLACES[:3])
def test_every_control_has_a_name(
    tab: Any, module_service: Service, some_job: dict[str, Any], place: str
) -> None:
    page = tab(f"{module_service.url}/{place.format(job=some_job['id'])}")
    page.wait_for_selector(".card, .gallery img, .timing")
    nodes = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    controls = ("button", "link", "textbox", "searchbox", "combobox", "slider", "checkbox")
    roles = {*controls, "radio", "spinbutton", "progressbar", "application", "dialog"}
    found = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in nodes
        if not node["ignored"] and node["role"]["value"] in roles
    ]
    assert len(found) > 5
    assert [role for role, name in found if not name.strip()] == []


def test_hidden_pages_hold_no_connection(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/?state=queued,running,succeeded&label=mine")
    page.wait_for_selector(".empty:not([hidden])")

    def readers() -> float:
        text = service.get("/metrics").text
        (line,) = [row for row in text.splitlines() if row.startswith("raykiln_event_readers")]
        return float(line.split()[-1])

    until(lambda: readers() == 1)
    hide = """(hidden) => {
        Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
        document.dispatchEvent(new Event("visibilitychange"));
    }"""
    page.evaluate(hide, True)
    until(lambda: readers() == 0)
    service.submit(settings=QUICK, labels={"mine": ""})
    page.evaluate(hide, False)
    page.wait_for_selector(".card")


def test_the_api_page_shows_the_calls(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/docs")
    page.wait_for_selector("h3:has-text('POST /v1/jobs')")
