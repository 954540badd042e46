"""The list of jobs and what can be done to a job."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from .support import BALL, FOREVER, QUICK, Service, until


def cards(page: Any) -> list[str]:
    return [str(text) for text in page.locator(".card strong").all_inner_texts()]


def test_the_list_is_alive(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/")
    page.wait_for_selector(".empty:not([hidden])")
    job = service.submit(settings=FOREVER, labels={"shot": "010"})
    page.wait_for_selector(".card.running")
    bar = page.locator(".card progress")
    first = until(lambda: float(bar.get_attribute("value") or 0))
    until(lambda: float(bar.get_attribute("value") or 0) > first)
    until(lambda: page.locator(".card img").evaluate("(image) => image.naturalWidth") == 128)
    assert "shot: 010" in page.inner_text(".card .summary")
    with service.client() as client:
        client.post(f"/v1/jobs/{job}/cancel")
    page.wait_for_selector(".card.cancelled:has-text('partial image')")
    until(lambda: page.inner_text("#announcements").endswith("is cancelled"))
    with service.client() as client:
        client.delete(f"/v1/jobs/{job}")
    page.wait_for_selector(".empty:not([hidden])")


def test_it_asks_only_when_there_is_news(tab: Any, service: Service) -> None:
    service.finished(settings=QUICK)
    page = tab(f"{service.url}/")
    page.wait_for_selector(".card.succeeded img:visible")
    quiet = 0
    for _ in range(60):
        asked = len(tab.requests)
        page.wait_for_timeout(1000)
        # What belongs to the opening of the page comes first, however late.
        quiet = quiet + 1 if len(tab.requests) == asked else 0
        if quiet == 5:
            break
    assert quiet == 5, tab.requests
    assert sum(url.endswith("/v1/events") for url in tab.requests) == 1


def test_filters_and_older_pages(tab: Any, service: Service) -> None:
    with service.client() as client:
        client.post("/v1/queue/pause").raise_for_status()
    try:
        for i in range(30):
            service.submit(settings=QUICK, labels={"number": str(i), "even": str(i % 2 == 0)})
        with service.client() as client:
            client.post(f"/v1/jobs/{service.jobs()[0]['id']}/cancel")
        page = tab(f"{service.url}/")
        page.wait_for_selector(".badge.paused")
        until(lambda: len(cards(page)) == 24)
        page.click("text=Older jobs")
        until(lambda: len(cards(page)) == 30)
        assert "number: 0" in page.locator(".card .summary").last.inner_text()
        page.click(".segments a:has-text('cancelled')")
        until(lambda: len(cards(page)) == 1)
        assert page.get_attribute(".segments a:has-text('cancelled')", "aria-current") == "true"
        page.click(".segments a:has-text('all')")
        page.fill("[name=label]", "even=True")
        page.keyboard.press("Enter")
        until(lambda: len(cards(page)) == 15)
        page.reload()
        until(lambda: len(cards(page)) == 15)
        page.fill("[name=label]", "no such label")
        page.keyboard.press("Enter")
        page.wait_for_selector(".empty:has-text('No such jobs')")
    finally:
        with service.client() as client:
            client.post("/v1/queue/resume").raise_for_status()


def test_the_queue_is_paused_and_resumed(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/")
    page.click("text=Pause the queue")
    page.wait_for_selector(".badge.paused")
    job = service.submit(settings=QUICK)
    page.wait_for_selector(".card.queued")
    assert service.get(f"/v1/jobs/{job}").json()["state"] == "queued"
    page.click("text=Resume the queue")
    page.wait_for_selector(".card.succeeded")


def test_cancel_retry_and_delete_by_keyboard_alone(tab: Any, service: Service) -> None:
    job = service.submit(settings=FOREVER)
    page = tab(f"{service.url}/")
    page.wait_for_selector(".card.running")

    def press_until(name: str) -> None:
        focused = "document.activeElement.textContent.trim()"
        for _ in range(40):
            page.keyboard.press("Tab")
            if page.evaluate(focused).startswith(name):
                page.keyboard.press("Enter")
                return
        raise AssertionError(f"the keyboard does not come to {name}")

    press_until("Inline scene")
    page.wait_for_selector(".job h1")
    # Where a screen reader goes on.
    assert page.evaluate("document.activeElement.tagName") == "H1"
    page.wait_for_selector("button:has-text('Cancel')")
    press_until("Cancel")
    page.wait_for_selector("dialog h2:has-text('Cancel this job?')")
    page.keyboard.press("Escape")
    assert service.get(f"/v1/jobs/{job}").json()["cancel_requested"] is False
    press_until("Cancel")
    press_until("Cancel the job")
    page.wait_for_selector(".badge.cancelled")
    page.wait_for_selector(".how .note:has-text('partial image')")
    press_until("Retry")
    page.wait_for_selector(".badge.running")
    with service.client() as client:
        client.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    page.wait_for_selector(".badge.cancelled")
    press_until("Delete")
    press_until("Delete the job")
    page.wait_for_selector(".empty:has-text('Nothing rendered yet')")
    assert service.jobs() == []


def test_a_job_that_fails_says_why(tab: Any, service: Service, tmp_path: Path) -> None:
    with service.client() as client:
        asset = client.post("/v1/assets?filename=ball.json", content=json.dumps(BALL)).json()["id"]
        client.post("/v1/queue/pause").raise_for_status()
        job = service.submit(scene={"asset": asset}, settings=QUICK)
        # The scene goes away between the check and the render.
        folder = service.data_dir
        digest = asset.removeprefix("sha256:")
        (folder / "assets" / digest[:2] / digest[2:]).unlink()
        for left in (folder / "bundles").rglob("*.json"):
            left.unlink()
        client.post("/v1/queue/resume").raise_for_status()
    page = tab(f"{service.url}/#/jobs/{job}")
    page.wait_for_selector(".badge.failed")
    assert page.inner_text(".trouble .bad") != ""
    page.click("summary:has-text('Log')")
    until(lambda: "failed" in page.inner_text("[aria-label=Log]"))


def test_a_job_that_is_not_there(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/jobs/job-of-nobody")
    page.wait_for_selector(".empty:has-text('No such job')")
    job = service.finished(settings=QUICK)
    page.goto(f"{service.url}/#/jobs/{job['id']}")
    page.wait_for_selector(".badge.succeeded")
    with service.client() as client:
        client.delete(f"/v1/jobs/{job['id']}")
    page.wait_for_selector(".empty:has-text('deleted')")


def test_timing_facts_and_downloads(tab: Any, service: Service) -> None:
    job = service.finished(settings={**QUICK, "aovs": ["albedo"]}, labels={"shot": "010"})
    page = tab(f"{service.url}/#/jobs/{job['id']}")
    page.wait_for_selector(".timing")
    rows = dict(
        zip(
            *[
                page.locator(f".timing tbody {k}").all_inner_texts()
                for k in ("th", "td:nth-of-type(1)")
            ],
            strict=True,
        )
    )
    assert {"Queue", "Load", "BVH", "Render", "Denoise", "Encode"} <= set(rows)
    bars = page.locator(".bars rect")
    widths = [float(bars.nth(i).get_attribute("width")) for i in range(bars.count())]
    assert abs(sum(widths) - 100) < 1e-6
    names = [text.split("\n")[0] for text in page.locator(".file").all_inner_texts()]
    assert names[:2] == ["image.exr", "image.png"]
    assert {"albedo.exr", "stats.json", "log.txt"} <= set(names)
    with page.expect_download() as saved:
        page.click(".file:has-text('albedo.exr')")
    path = f"/v1/jobs/{job['id']}/outputs/albedo.exr"
    assert Path(saved.value.path()).read_bytes() == service.get(path).content
    page.select_option("[name=view]", "agx")
    with page.expect_download() as saved:
        page.click(".file:has-text('as shown (agx, 0.0 EV)')")
    wanted = service.get(f"/v1/jobs/{job['id']}/outputs/image.png", view="agx")
    assert Path(saved.value.path()).read_bytes() == wanted.content
    page.click(".label:has-text('shot: 010')")
    page.wait_for_selector(".card")
    assert page.input_value("[name=label]") == "shot=010"


def test_the_snippets_submit_the_same_job(tab: Any, service: Service, tmp_path: Path) -> None:
    nasty = {"it's": "\"$HOME\" `id` \\ 'quoted'"}
    job = service.finished(
        scene={"name": "cornell_box"}, settings={**QUICK, "denoise": False}, labels=nasty
    )
    page = tab(f"{service.url}/#/jobs/{job['id']}")
    page.click("summary:has-text('From a terminal')")
    for name, start in (("curl", ["bash", "-ec"]), ("Python", [sys.executable, "-c"])):
        before = len(service.jobs())
        text = page.locator(f"pre[aria-label={name}]").inner_text()
        if name == "Python":
            assert '"image.exr", "image.exr"' in text
        subprocess.run([*start, text], check=True, capture_output=True, timeout=120, cwd=tmp_path)
        newest, *others = service.jobs()
        assert len(others) == before
        for field in ("scene", "settings", "labels", "outputs_wanted"):
            assert newest[field] == job[field], (name, field)
