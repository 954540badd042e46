"""The image of a job: live, developed, looked at pixel by pixel, before and after denoising."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from raykiln.image import encode_exr, read_exr_layers, read_image

from .support import FOREVER, Service, until

SHOWN = """() => {
    const canvas = document.querySelector(".stage canvas");
    const context = canvas.getContext("2d");
    const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
    return [canvas.width, canvas.height, [...data]];
}"""
LAYERS = ["albedo", "normal", "depth", "variance"]


def shown(page: Any) -> npt.NDArray[np.int16]:
    """The pixels on the page, (height, width, 3)."""
    width, height, data = page.evaluate(SHOWN)
    return np.array(data, dtype=np.int16).reshape(height, width, 4)[..., :3]


def shows(page: Any, wanted: npt.NDArray[Any]) -> bool:
    """Whether the pixels on the page are these, but for one step."""
    found = shown(page)
    return found.shape == wanted.shape and bool(np.abs(found - wanted).max() <= 1)


@pytest.fixture(scope="module")
def layered(module_service: Service) -> dict[str, Any]:
    """A finished job with all layers, bright and dark parts."""
    settings = {"width": 48, "height": 32, "spp": 4, "aovs": LAYERS}
    return module_service.finished(settings=settings)


def opened(tab: Any, service: Service, job: dict[str, Any], **options: Any) -> Any:
    """The job's page with the film read."""
    page = tab(f"{service.url}/#/jobs/{job['id']}", **options)
    until(lambda: page.locator("[name=layer]").count() or page.locator(".range").count())
    size = (str(job_width(job)), str(job_height(job)))
    canvas = page.locator(".stage canvas").first
    until(lambda: (canvas.get_attribute("width"), canvas.get_attribute("height")) == size)
    return page


def job_width(job: dict[str, Any]) -> int:
    return int(job["settings"]["width"])


def job_height(job: dict[str, Any]) -> int:
    return int(job["settings"]["height"])


def set_exposure(page: Any, stops: float) -> None:
    change = """(input, stops) => {
        input.value = stops;
        input.dispatchEvent(new Event("input", { bubbles: true }));
    }"""
    page.locator("[name=exposure]").evaluate(change, stops)


@pytest.mark.parametrize("view", ["srgb", "agx", "aces", "raw"])
@pytest.mark.parametrize("exposure", [0.0, 2.5, -3.0])
def test_the_page_develops_as_the_service_does(
    tab: Any, module_service: Service, layered: dict[str, Any], view: str, exposure: float
) -> None:
    page = opened(tab, module_service, layered)
    page.select_option("[name=view]", view)
    set_exposure(page, exposure)
    path = f"/v1/jobs/{layered['id']}/outputs/image.png"
    reply = module_service.get(path, view=view, exposure=exposure)
    wanted = read_image(reply.content)[..., :3].astype(np.int16)
    until(lambda: shows(page, wanted))


def test_layers_are_shown_so_that_one_sees_them(
    tab: Any, module_service: Service, layered: dict[str, Any]
) -> None:
    film = read_exr_layers(
        module_service.get(f"/v1/jobs/{layered['id']}/outputs/image.exr").content
    )
    page = opened(tab, module_service, layered)
    page.check("[name=layer][value=normal]", force=True)
    wanted = np.rint(127.5 + 127.5 * film["normal"])
    until(lambda: shows(page, wanted))
    assert page.locator(".light").evaluate("(e) => getComputedStyle(e).visibility") == "hidden"
    page.check("[name=layer][value=depth]", force=True)
    depth = film["depth"]
    met = depth[depth > 0]
    until(lambda: page.inner_text(".range") == f"{met.min():.4f} to {met.max():.4f}")
    nearest, farthest = np.where(depth == met.min()), np.where(depth == met.max())

    def is_seen() -> bool:
        pixels = shown(page)[..., 0]
        return bool(
            pixels[nearest].max() < pixels[farthest].min() and (pixels[depth == 0] == 0).all()
        )

    until(is_seen)


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", text)]


def test_a_pixel_has_the_values_of_the_file(
    tab: Any, module_service: Service, layered: dict[str, Any]
) -> None:
    film = read_exr_layers(
        module_service.get(f"/v1/jobs/{layered['id']}/outputs/image.exr").content
    )
    page = opened(tab, module_service, layered)
    # By the keyboard: from the middle, 5 to the right, 10 down.
    page.focus(".surface")
    page.keyboard.press("ArrowRight")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    x, y = 48 // 2 + 5, 32 // 2 + 10
    until(lambda: page.inner_text(".inspector .place") == f"{x}, {y}")
    values = page.locator(".inspector dd").all_inner_texts()
    names = page.locator(".inspector dt").all_inner_texts()
    assert names == ["Radiance", "Albedo", "Normal", "Depth", "Variance"]
    for name, text in zip(["beauty", *LAYERS], values, strict=True):
        wanted = np.atleast_1d(film[name][y, x])
        assert numbers(text)[: wanted.size] == pytest.approx(wanted, rel=2e-3, abs=1e-4)
    # By the mouse, at the corner; a click holds it there.
    box = page.locator(".sheet").bounding_box()
    scale = box["width"] / 48
    page.mouse.move(box["x"] + 1.5 * scale, box["y"] + 0.5 * scale)
    page.mouse.click(box["x"] + 1.5 * scale, box["y"] + 0.5 * scale)
    until(lambda: page.inner_text(".inspector .place") == "1, 0")
    page.mouse.move(box["x"] + 20 * scale, box["y"] + 20 * scale)
    assert page.inner_text(".inspector .place") == "1, 0"
    assert numbers(page.locator(".inspector dd").first.inner_text())[:3] == pytest.approx(
        film["beauty"][0, 1], rel=2e-3, abs=1e-4
    )


def test_a_crop_tells_its_place_in_the_whole(tab: Any, service: Service) -> None:
    settings = {"width": 64, "height": 48, "spp": 1, "crop": [10, 20, 42, 44]}
    job = service.finished(settings=settings)
    page = tab(f"{service.url}/#/jobs/{job['id']}")
    until(lambda: page.locator(".stage canvas").first.get_attribute("width") == "32")
    until(lambda: page.inner_text(".stage-note") == "")
    box = page.locator(".sheet").bounding_box()
    page.mouse.move(box["x"] + 1, box["y"] + 1)
    until(lambda: page.inner_text(".inspector .place") == "10, 20")


def test_zoom_and_pan(tab: Any, module_service: Service, layered: dict[str, Any]) -> None:
    page = opened(tab, module_service, layered)
    zoom = page.locator(".zoom output")
    fitted = until(zoom.inner_text)
    page.click("text=1:1")
    assert zoom.inner_text() == "100 %"
    sheet = page.locator(".sheet")
    before = sheet.bounding_box()
    stage = page.locator(".stage").bounding_box()
    x, y = stage["x"] + stage["width"] / 2, stage["y"] + stage["height"] / 2
    page.mouse.move(x, y)
    page.mouse.wheel(0, -500)
    until(lambda: zoom.inner_text() != "100 %")
    after = sheet.bounding_box()
    # What is under the pointer stays there.
    assert (x - after["x"]) / after["width"] == pytest.approx((x - before["x"]) / before["width"])
    page.mouse.down()
    page.mouse.move(x + 40, y + 30, steps=4)
    page.mouse.up()
    moved = sheet.bounding_box()
    assert moved["x"] - after["x"] == pytest.approx(40, abs=1)
    assert moved["y"] - after["y"] == pytest.approx(30, abs=1)
    page.focus(".surface")
    page.keyboard.press("0")
    until(lambda: zoom.inner_text() == fitted)


def test_it_is_seen_while_it_renders(tab: Any, service: Service) -> None:
    job = service.submit(settings=FOREVER)
    page = tab(f"{service.url}/#/jobs/{job}")
    canvas = page.locator(".stage canvas").first
    until(lambda: canvas.get_attribute("width") == str(FOREVER["width"]))
    until(lambda: shown(page).max() > 0)
    first = shown(page)
    until(lambda: not np.array_equal(shown(page), first))
    assert page.locator(".how progress").get_attribute("value") != "0"
    assert "spp" in page.inner_text(".how .note")
    page.hover(".surface")
    until(lambda: "8 bit" in page.inner_text(".inspector"))


def test_before_and_after_denoising(tab: Any, service: Service) -> None:
    pytest.importorskip("pyoidn", reason="the denoiser is not installed")
    settings = {"width": 48, "height": 32, "spp": 1, "denoise": True}
    page = opened(tab, service, service.finished(settings=settings))
    page.check("[name=compare]")
    divider = page.locator(".divider")
    divider.wait_for()
    before = page.locator("canvas.before")
    clip = "(element) => getComputedStyle(element).clipPath"
    assert before.evaluate(clip) == "inset(0px 50% 0px 0px)"
    differs = """() => {
        const [main, before] = [...document.querySelectorAll(".stage canvas")].map((canvas) =>
            canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
        return main.some((value, i) => value !== before[i]);
    }"""
    until(lambda: page.evaluate(differs))
    divider.focus()
    page.keyboard.press("End")
    assert before.evaluate(clip) in ("inset(0px)", "inset(0px 0%)", "inset(0px 0% 0px 0px)")
    assert divider.get_attribute("aria-valuenow") == "100"
    handle = divider.bounding_box()
    sheet = page.locator(".sheet").bounding_box()
    y = handle["y"] + handle["height"] / 2
    page.mouse.move(handle["x"] + handle["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(sheet["x"] + 0.25 * sheet["width"], y, steps=3)
    page.mouse.up()
    assert divider.get_attribute("aria-valuenow") == "25"
    page.uncheck("[name=compare]")
    until(lambda: not divider.is_visible())


READ = """async (bytes) => {
    const { readExr } = await import("/web/exr.js");
    try {
        const { layers, ...window } = await readExr(new Uint8Array(bytes).buffer);
        const planes = [...layers].map(([name, { names, planes }]) =>
            [name, names, planes.map((plane) => [...plane].map(String))]);
        return { window, planes };
    } catch (error) {
        return { error: error.message };
    }
}"""


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("size", [(1, 1), (5, 3), (33, 47)])
def test_exr_files_are_read_to_the_last_bit(
    tab: Any, module_service: Service, half: bool, size: tuple[int, int]
) -> None:
    width, height = size
    noise = np.random.default_rng(3).normal(size=(height, width, 3)).astype(np.float32)
    noise.flat[:4] = [np.nan, np.inf, -np.inf, 6e-8][: noise.size]
    layers = {"beauty": noise, "albedo": np.full_like(noise, 0.25), "depth": noise[..., 1]}
    data = bytes(encode_exr(layers, half=half, window=(7, 9, 100, 100)))
    page = tab(f"{module_service.url}/")
    found = page.evaluate(READ, list(data))
    assert found["window"] == {"width": width, "height": height, "x": 7, "y": 9}
    assert [name for name, _names, _planes in found["planes"]] == list(layers)
    for name, wanted in read_exr_layers(data).items():
        planes = next(planes for known, _names, planes in found["planes"] if known == name)
        got = np.array([[float(text.replace("Infinity", "inf")) for text in p] for p in planes])
        np.testing.assert_array_equal(
            got.T.reshape(wanted.shape).astype(np.float32), wanted.astype(np.float32)
        )


def test_damaged_exr_files_are_refused(tab: Any, module_service: Service) -> None:
    noise = np.random.default_rng(4).random((20, 16, 3)).astype(np.float32)
    whole = bytes(encode_exr({"beauty": noise}))
    page = tab(f"{module_service.url}/")
    for length in (0, 3, 40, 200, len(whole) // 2, len(whole) - 1):
        assert "error" in page.evaluate(READ, list(whole[:length])), length
    rng = np.random.default_rng(5)
    for _ in range(60):
        broken = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            broken[place] ^= int(rng.integers(1, 256))
        found = page.evaluate(READ, list(broken))
        assert (
            "error" in found or math.prod(found["window"][k] for k in ("width", "height")) <= 24e6
        )


def test_without_a_film_the_picture_is_shown(
    tab: Any, module_service: Service, layered: dict[str, Any]
) -> None:
    page = tab("about:blank")
    page.route("**/image.exr", lambda route: route.fulfill(body=b"no EXR at all"))
    page.goto(f"{module_service.url}/#/jobs/{layered['id']}")
    page.wait_for_selector(".stage-note:has-text('8 bit picture: this is no EXR file')")
    path = f"/v1/jobs/{layered['id']}/outputs/image.png"
    wanted = read_image(module_service.get(path).content)[..., :3].astype(np.int16)
    until(lambda: shows(page, wanted))


def test_a_large_film_is_read_behind_its_picture(
    tab: Any, module_service: Service, layered: dict[str, Any]
) -> None:
    def told_large(route: Any) -> None:
        job = route.fetch().json()
        for output in job["outputs"]:
            output["size_bytes"] = 9_000_000
        route.fulfill(json=job)

    held: list[Any] = []
    page = tab("about:blank")
    page.route(f"**/v1/jobs/{layered['id']}", told_large)
    # The driver marks handlers, which a built-in method does not allow.
    page.route("**/image.exr", lambda route: held.append(route))  # noqa: PLW0108
    page.goto(f"{module_service.url}/#/jobs/{layered['id']}")
    page.wait_for_selector(".stage-note:has-text('Reading the film')")
    assert shown(page).shape == (32, 48, 3)
    assert page.locator("[name=layer]").count() <= 1
    # The browser is heard only while it is asked something.
    until(lambda: page.title() and held)
    held[0].continue_()
    until(lambda: page.locator("[name=layer]").count() == 1 + len(LAYERS))
    page.wait_for_selector(".stage-note", state="hidden")
