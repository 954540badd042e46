"""Making jobs on the page, as a person does."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raykiln.image import write_png

from .support import BALL, QUICK, Service, until, write_ball

RENDER = "button.primary:has-text('Render')"


def fill_quick(page: Any) -> None:
    for name, value in QUICK.items():
        page.fill(f"[name={name}]", str(value))


def submitted(page: Any, service: Service) -> dict[str, Any]:
    """The job that the page goes to after a press of the button."""
    page.click(RENDER)
    complaints = page.locator(".submit .bad:not(:empty)")
    until(lambda: page.locator("main .job h1").count() or complaints.count())
    assert complaints.all_inner_texts() == []
    (job,) = service.jobs()
    assert page.url.endswith(f"#/jobs/{job['id']}")
    return job


def test_a_bundled_scene_with_all_settings(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/")
    page.wait_for_selector(".empty:has-text('Nothing rendered yet')")
    page.click("text=New render >> nth=0")
    page.click(".gallery label:has-text('Cornell box')")
    assert page.get_attribute("[name=spp]", "placeholder") == "256"
    assert page.get_attribute("[name=max_depth]", "placeholder") == "12"
    fill_quick(page)
    page.select_option("[name=integrator]", "direct")
    page.check("[name=aovs][value=normal]")
    page.fill("[name=priority]", "5")
    page.click("text=Add a label")
    page.fill("[aria-label='Label name']", "shot")
    page.fill("[aria-label='Label value']", "010")
    page.click("summary:has-text('More settings')")
    page.fill("[name=seed]", "7")
    page.fill("[name=crop]", "4, 4, 28, 20")
    page.fill("[name=timeout_s]", "99")
    page.fill("[name=memory_bytes]", "1.5")
    page.uncheck("[name=outputs][value=png]")
    job = submitted(page, service)
    assert job["scene"] == {"name": "cornell_box"}
    assert job["settings"] == {
        **QUICK, "integrator": "direct", "aovs": ["normal"], "seed": 7, "crop": [4, 4, 28, 20]
    }  # fmt: skip
    assert job["labels"] == {"shot": "010"}
    assert job["priority"] == 5
    assert job["outputs_wanted"] == ["exr"]
    assert (job["timeout_s"], job["memory_bytes"]) == (99, 1_500_000_000)


def test_what_is_left_out_is_left_to_the_scene(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/new?scene=whitted_spheres")
    fill_quick(page)
    assert submitted(page, service)["settings"] == QUICK


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("camera", "nowhere", "no camera 'nowhere'"),
        ("spp", "0", "greater than or equal to 1"),
        ("max_depth", "0", "max_depth must be"),
        ("crop", "1, 2", "Four whole numbers"),
        ("seed", "-1", "greater than or equal to 0"),
    ],
)
def test_a_problem_is_shown_at_its_field(
    tab: Any, service: Service, field: str, value: str, complaint: str
) -> None:
    page = tab(f"{service.url}/#/new?scene=cornell_box")
    page.wait_for_selector("[name=scene]:checked", state="attached")
    fill_quick(page)
    if not page.is_visible(f"[name={field}]"):
        page.click("summary:has-text('More settings')")
    page.fill(f"[name={field}]", value)
    page.click("summary:has-text('More settings')")
    page.click(RENDER)
    shown = page.locator(f".field:has([name={field}]) .bad, .send .bad").filter(has_text=complaint)
    shown.wait_for()
    if shown.locator("xpath=ancestor::div[contains(@class, 'field')]").count():
        assert page.evaluate("document.activeElement.name") == field
    assert service.jobs() == []
    page.fill(f"[name={field}]", "")
    submitted(page, service)


def test_a_file_that_is_no_scene_is_refused_with_its_place(
    tab: Any, service: Service, tmp_path: Path
) -> None:
    broken = write_ball(tmp_path / "ball.json", shapes=[{"type": "sphere", "radius": -1}])
    page = tab(f"{service.url}/#/new")
    page.set_input_files("[name=file]", broken)
    fill_quick(page)
    page.click(RENDER)
    page.wait_for_selector(".picker .bad:has-text('ball.json /shapes/0/radius')")
    assert service.jobs() == []
    # The same way with the cause removed.
    page.set_input_files("[name=file]", write_ball(broken))
    assert submitted(page, service)["scene"]["entry"] == "ball.json"


def test_without_a_scene_nothing_is_sent(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/new")
    page.click(RENDER)
    page.wait_for_selector(".picker .bad:has-text('Choose a scene first')")
    assert not any("/v1/jobs" in url for url in tab.requests)


def textured(folder: Path) -> Path:
    """A folder with a scene, its texture in a folder of its own, and litter."""
    (folder / "textures").mkdir(parents=True)
    write_png(folder / "textures" / "größe.png", np.full((4, 4, 3), 0.5))
    textures = {"paint": {"type": "image", "file": "textures/größe.png"}}
    red = {"type": "diffuse", "reflectance": {"texture": "paint"}}
    write_ball(folder / "ball.json", materials={"red": red}, textures=textures)
    (folder / ".DS_Store").write_bytes(b"\0")
    return folder


def test_a_folder_goes_up_with_its_textures(tab: Any, service: Service, tmp_path: Path) -> None:
    page = tab(f"{service.url}/#/new")
    page.set_input_files("[name=folder]", textured(tmp_path / "my scene"))
    assert page.inner_text(".chosen b") == "my scene.zip"
    fill_quick(page)
    job = submitted(page, service)
    assert job["scene"]["entry"] == "my scene/ball.json"
    page.wait_for_selector(".badge.succeeded")


def test_a_zip_with_two_scenes_asks_which(tab: Any, service: Service, tmp_path: Path) -> None:
    archive = tmp_path / "two.zip"
    with zipfile.ZipFile(archive, "w") as bundle:
        for name in ("first.json", "second.json"):
            bundle.writestr(name, json.dumps(BALL))
    page = tab(f"{service.url}/#/new")
    page.set_input_files("[name=file]", archive)
    fill_quick(page)
    page.click(RENDER)
    page.wait_for_selector(".picker .bad:not(:empty)")
    page.select_option("[name=entry]", "second.json")
    assert submitted(page, service)["scene"]["entry"] == "second.json"


def test_files_may_be_dropped_anywhere(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/")
    page.wait_for_selector(".empty:not([hidden])")
    drop = """(text) => {
        const transfer = new DataTransfer();
        transfer.items.add(new File([text], "dropped.json"));
        for (const kind of ["dragover", "drop"]) {
            const options = { dataTransfer: transfer, bubbles: true, cancelable: true };
            document.body.dispatchEvent(new DragEvent(kind, options));
        }
    }"""
    page.evaluate(drop, json.dumps(BALL))
    page.wait_for_selector(".chosen b:has-text('dropped.json')")
    fill_quick(page)
    assert submitted(page, service)["scene"]["entry"] == "dropped.json"


def test_a_lost_reply_makes_no_second_job(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/new?scene=cornell_box")
    fill_quick(page)
    lost: list[bool] = []

    def lose_the_first(route: Any) -> None:
        if route.request.method == "POST" and not lost:
            lost.append(True)
            route.fetch()
            route.abort()
        else:
            route.continue_()

    page.route("**/v1/jobs", lose_the_first)
    page.click(RENDER)
    page.wait_for_selector(".send .bad:has-text('does not answer')")
    submitted(page, service)


def test_render_again_starts_from_the_job(tab: Any, service: Service) -> None:
    with service.client() as client:
        asset = client.post("/v1/assets?filename=ball.json", content=json.dumps(BALL)).json()["id"]
    settings = {**QUICK, "aovs": ["depth"], "camera": "side"}
    earlier = service.finished(scene={"asset": asset}, settings=settings, labels={"a": "b"})
    page = tab(f"{service.url}/#/jobs/{earlier['id']}")
    page.click("text=Change and render again")
    until(lambda: page.input_value("[name=camera]") == "side")
    page.fill("[name=spp]", "2")
    page.click(RENDER)
    newer = until(lambda: [job for job in service.jobs() if job["id"] != earlier["id"]])[0]
    assert newer["scene"] == earlier["scene"]
    assert newer["settings"] == {**settings, "spp": 2}
    assert newer["labels"] == {"a": "b"}


def test_many_pictures_of_one_scene(tab: Any, service: Service, tmp_path: Path) -> None:
    page = tab(f"{service.url}/#/new")
    page.set_input_files("[name=file]", write_ball(tmp_path / "ball.json"))
    fill_quick(page)
    page.select_option("[name=frames]", "turntable")
    page.fill(".frames-field input >> nth=0", "3")
    assert page.is_checked("[name=outputs][value=contact_sheet]")
    job = submitted(page, service)
    assert job["frames"]["wanted"] == {"turntable": {"count": 3}}
    page.wait_for_selector(".badge.succeeded")
    page.wait_for_selector(".file:has-text('contact_sheet.png')")
    until(lambda: page.locator(".tile.succeeded img:visible").count() == 3)
    page.check("[name=frame][value='3']", force=True)
    page.wait_for_selector(".file:has-text('0003 image.exr')")
    until(lambda: page.locator(".stage canvas >> nth=0").get_attribute("width") == "32")


def test_what_is_in_the_cache_can_be_rendered_anew(tab: Any, service: Service) -> None:
    body = {"scene": {"name": "cornell_box"}, "settings": {**QUICK, "seed": 77}}
    service.finished(**body, outputs=["exr", "png"])
    page = tab(f"{service.url}/#/new?scene=cornell_box")
    for anew in (False, True):
        page.goto(f"{service.url}/#/new?scene=cornell_box&again={anew}")
        page.wait_for_selector("[name=scene]:checked", state="attached")
        fill_quick(page)
        page.click("summary:has-text('More settings')")
        page.fill("[name=seed]", "77")
        page.set_checked("[name=anew]", anew)
        page.click(RENDER)
        page.wait_for_selector(".badge.succeeded")
        assert service.jobs()[0]["cached"] is not anew
        assert ("from the cache" in page.inner_text(".how .note")) is not anew


def large_scene(path: Path, megabytes: int = 10) -> Path:
    """A scene of one triangle and a long story."""
    line = "# " + "x" * 1021 + "\n"
    path.write_text(line * (megabytes << 10) + "v -1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return path


def test_a_large_file_goes_in_pieces_and_bears_a_broken_connection(
    tab: Any, service: Service, tmp_path: Path
) -> None:
    page = tab(f"{service.url}/#/new")
    offsets: list[str | None] = []

    def break_the_second(route: Any) -> None:
        if route.request.method == "PATCH":
            offsets.append(route.request.headers.get("upload-offset"))
            if len(offsets) == 2:
                route.abort("connectionreset")
                return
        route.continue_()

    page.route("**/v1/uploads/**", break_the_second)
    page.set_input_files("input[type=file] >> nth=0", large_scene(tmp_path / "large.obj"))
    fill_quick(page)
    job = submitted(page, service)
    assert job["scene"]["entry"] == "large.obj"
    piece = 4 << 20
    assert offsets == ["0", str(piece), str(piece), str(2 * piece)]


def test_a_large_file_that_is_picked_again_goes_on(
    tab: Any, service: Service, tmp_path: Path
) -> None:
    page = tab(f"{service.url}/#/new")
    scene = large_scene(tmp_path / "again.obj", 13)
    offsets: list[str | None] = []

    def let_one_through(route: Any) -> None:
        if route.request.method == "PATCH":
            offsets.append(route.request.headers.get("upload-offset"))
            if len(offsets) == 2:
                return  # Never answered: the person reloads the page.
        route.continue_()

    page.route("**/v1/uploads/**", let_one_through)
    page.set_input_files("input[type=file] >> nth=0", scene)
    fill_quick(page)
    page.click(RENDER)
    # The browser is heard only while it is asked something.
    until(lambda: page.title() and len(offsets) == 2)
    page.reload()
    page.set_input_files("input[type=file] >> nth=0", scene)
    fill_quick(page)
    assert submitted(page, service)["scene"]["entry"] == "again.obj"
    # What had arrived was not sent again.
    assert offsets.count("0") == 1
