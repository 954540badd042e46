"""Jobs of many frames, against the real service: turntables, cameras, moments, and what kills."""

from __future__ import annotations

import io
import os
import signal
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import raykiln as rk
from raykiln.image import read_exr_layers, read_image

QUICK = {"width": 32, "height": 24, "spp": 4}
# Long enough to be caught in the middle of a frame, however many processors there are.
SLOW = {"width": 32, "height": 24, "spp": 8192, "threads": 1}
SLOWER = {**SLOW, "spp": 16384}


@pytest.fixture(scope="module")
def server(module_serve: Any) -> Any:
    return module_serve(max_attempts=2, retry_delay_s=0.05, checkpoint_interval_s=0.1)


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


def frames_of(server: Any, job_id: str) -> list[dict[str, Any]]:
    with server.client() as client:
        page = client.get(f"/v1/jobs/{job_id}/frames", params={"limit": 1000})
        items: list[dict[str, Any]] = page.raise_for_status().json()["items"]
    return items


def file_of(server: Any, href: str) -> bytes:
    with server.client() as client:
        return bytes(client.get(href).raise_for_status().content)


def beauty_of(server: Any, href: str) -> bytes:
    return read_exr_layers(file_of(server, href))["beauty"].tobytes()


def done_frames(view: dict[str, Any]) -> int:
    return int(view["frames"]["succeeded"])


@pytest.fixture(scope="module")
def turntable(server: Any, ball: dict[str, Any]) -> dict[str, Any]:
    """A finished job of twelve frames with all that can be made of them."""
    job = server.submit(
        scene={"inline": ball},
        settings={**QUICK, "aovs": ["depth"]},
        frames={"turntable": {"count": 12}, "fps": 10},
        outputs=["exr", "png", "contact_sheet", "webp", "mp4"],
    )
    view: dict[str, Any] = server.wait_for_end(job["id"])
    assert view["state"] == "succeeded", view["error"]
    return view


# What a job of frames gives.


def test_a_turntable(server: Any, turntable: dict[str, Any]) -> None:
    assert turntable["frames"]["count"] == turntable["frames"]["succeeded"] == 12
    assert turntable["progress"]["fraction"] == 1.0
    assert turntable["attempts"] == 1
    names = {output["name"] for output in turntable["outputs"]}
    assert names == {"contact_sheet.png", "animation.webp", "animation.mp4", "stats.json"}
    frames = frames_of(server, turntable["id"])
    assert [frame["name"] for frame in frames] == [f"{i:04d}" for i in range(1, 13)]
    pictures = set()
    for frame in frames:
        assert (frame["state"], frame["complete"]) == ("succeeded", True)
        outputs = {output["name"]: output for output in frame["outputs"]}
        assert set(outputs) == {"image.exr", "image.png", "depth.exr", "stats.json"}
        content = file_of(server, outputs["image.exr"]["href"])
        assert len(content) == outputs["image.exr"]["size_bytes"]
        pictures.add(read_exr_layers(content)["beauty"].tobytes())
    assert len(pictures) == 12
    total = turntable["stats"]
    assert (
        total["samples"] == sum(frame["stats"]["samples"] for frame in frames) == 12 * 32 * 24 * 4
    )
    assert total["spp"] == 4


def test_what_is_made_of_the_frames(server: Any, turntable: dict[str, Any]) -> None:
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    image = pytest.importorskip("PIL.Image", reason="the extra `video` is not installed")
    hrefs = {output["name"]: output["href"] for output in turntable["outputs"]}
    frames = [
        read_image(file_of(server, frame["outputs"][2]["href"]))
        for frame in frames_of(server, turntable["id"])
        if frame["outputs"][2]["name"] == "image.png"
    ]
    assert len(frames) == 12
    sheet = read_image(file_of(server, hrefs["contact_sheet.png"]))
    for i, frame in enumerate(frames[:3]):
        x = 8 + i * (32 + 8)
        assert np.abs(sheet[8 : 8 + 24, x : x + 32].astype(int) - frame.astype(int)).max() <= 1
    animation = image.open(io.BytesIO(file_of(server, hrefs["animation.webp"])))
    assert (animation.n_frames, animation.size) == (12, (32, 24))
    animation.seek(5)
    animation.load()
    assert animation.info["duration"] == 100
    shown = np.asarray(animation.convert("RGB")).astype(int)
    assert np.abs(shown - frames[5]).mean() < 12 < np.abs(shown - frames[0]).mean()
    with av.open(io.BytesIO(file_of(server, hrefs["animation.mp4"]))) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height, float(stream.average_rate)) == (32, 24, 10.0)
        assert sum(1 for _ in film.decode(stream)) == 12


@pytest.mark.parametrize("number", [1, 5])
def test_a_frame_has_the_bits_of_the_single_image(
    server: Any, ball: dict[str, Any], turntable: dict[str, Any], number: int
) -> None:
    frame = frames_of(server, turntable["id"])[number - 1]
    alone = server.submit(
        scene={"inline": {**ball, "cameras": [frame["camera"]]}},
        settings={**QUICK, **frame["settings"]},
    )
    assert server.wait_for_end(alone["id"])["state"] == "succeeded"
    place = f"/v1/jobs/{turntable['id']}/frames/{number}/image.exr"
    assert beauty_of(server, place) == beauty_of(
        server, f"/v1/jobs/{alone['id']}/outputs/image.exr"
    )


def test_python_gives_the_same_cameras(
    server: Any, ball: dict[str, Any], turntable: dict[str, Any]
) -> None:
    cameras = rk.turntable(rk.Scene.create(ball), 12)
    told = [frame["camera"] for frame in frames_of(server, turntable["id"])]
    assert [camera.model_dump(mode="json", exclude_none=True) for camera in cameras] == told


def test_frames_of_cameras_vary_as_asked(server: Any, ball: dict[str, Any]) -> None:
    side = {"name": "side", "look_at": {"origin": [4, 1, 0], "target": [0, 0.5, 0]}}
    scene = {"inline": {**ball, "cameras": [*ball["cameras"], side]}}
    job = server.submit(scene=scene, settings={**QUICK, "seed": 5}, frames={"cameras": "all"})
    varied = server.submit(
        scene=scene,
        settings={**QUICK, "seed": 4},
        frames={"cameras": ["front", "side"], "vary_seed": True},
        outputs=["exr"],
    )
    alone = server.submit(scene=scene, settings={**QUICK, "seed": 5, "camera": "side"})
    for one in (job, varied, alone):
        assert server.wait_for_end(one["id"])["state"] == "succeeded"
    expected = beauty_of(server, f"/v1/jobs/{alone['id']}/outputs/image.exr")
    for one in (job, varied):
        assert beauty_of(server, f"/v1/jobs/{one['id']}/frames/0002/image.exr") == expected
    front = [beauty_of(server, f"/v1/jobs/{one['id']}/frames/1/image.exr") for one in (job, varied)]
    assert front[0] != front[1]
    made = frames_of(server, varied["id"])
    assert [frame["settings"] for frame in made] == [
        {"camera": "front", "seed": 4},
        {"camera": "side", "seed": 5},
    ]
    assert [output["name"] for output in made[0]["outputs"]] == ["image.exr", "stats.json"]
    assert [output["name"] for output in server.job(varied["id"])["outputs"]] == ["stats.json"]


def test_frames_in_time(server: Any, client: httpx.Client, moving: bytes, tmp_path: Path) -> None:
    asset = client.post("/v1/assets", params={"filename": "moving.glb"}, content=moving).json()
    job = server.submit(
        scene={"asset": asset["id"]}, settings=QUICK, frames={"time": {"end": 0.5, "fps": 4}}
    )
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
    frames = frames_of(server, job["id"])
    assert [frame["time_s"] for frame in frames] == [0, 0.25, 0.5]
    (tmp_path / "moving.glb").write_bytes(moving)
    scene = rk.load_scene(tmp_path / "moving.glb", time_s=0.25)
    here = rk.render(scene, rk.RenderSettings(width=32, height=24, spp=4)).image
    assert beauty_of(server, f"/v1/jobs/{job['id']}/frames/2/image.exr") == here.tobytes()
    assert beauty_of(server, f"/v1/jobs/{job['id']}/frames/3/image.exr") != here.tobytes()


def test_pages_of_frames(client: httpx.Client, turntable: dict[str, Any]) -> None:
    found, cursor = [], None
    while True:
        params = {"limit": 5} if cursor is None else {"limit": 5, "cursor": cursor}
        page = client.get(f"/v1/jobs/{turntable['id']}/frames", params=params).json()
        found += [frame["number"] for frame in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert found == list(range(1, 13))
    failed = client.get(f"/v1/jobs/{turntable['id']}/frames", params={"state": "failed,queued"})
    assert failed.json() == {"items": [], "next_cursor": None}


def test_views_of_a_frame(client: httpx.Client, turntable: dict[str, Any]) -> None:
    base = f"/v1/jobs/{turntable['id']}/frames/0003"
    plain = client.get(f"{base}/image.png")
    brighter = client.get(f"{base}/image.png", params={"exposure": 2, "view": "agx"})
    assert read_image(brighter.content).shape == read_image(plain.content).shape
    assert brighter.content != plain.content
    etag = plain.headers["etag"]
    assert client.get(f"{base}/image.png", headers={"If-None-Match": etag}).status_code == 304
    part = client.get(f"{base}/image.exr", headers={"Range": "bytes=0-3"})
    assert (part.status_code, part.content) == (206, bytes([0x76, 0x2F, 0x31, 0x01]))
    for wrong in (
        "0003/nothing.exr",
        "0013/image.exr",
        "0000/image.exr",
        "x/image.exr",
        "99999999999",
    ):
        reply = client.get(f"/v1/jobs/{turntable['id']}/frames/{wrong}")
        assert reply.status_code == 404
        assert reply.headers["content-type"] == "application/problem+json"


def test_all_outputs_as_one_archive(
    server: Any, client: httpx.Client, ball: dict[str, Any], turntable: dict[str, Any]
) -> None:
    reply = client.get(turntable["links"]["archive"])
    with zipfile.ZipFile(io.BytesIO(reply.content)) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        assert {"contact_sheet.png", "image.0001.exr", "depth.0012.exr", "log.txt"} <= set(names)
        assert len(names) == len(set(names)) == 4 + 12 * 4 + 1
        frame = client.get(f"/v1/jobs/{turntable['id']}/frames/7/image.exr").content
        assert archive.read("image.0007.exr") == frame
    again = client.get(
        turntable["links"]["archive"], headers={"If-None-Match": reply.headers["etag"]}
    )
    assert again.status_code == 304
    single = server.submit(scene={"inline": ball}, settings=QUICK)
    view = server.wait_for_end(single["id"])
    with zipfile.ZipFile(io.BytesIO(client.get(view["links"]["archive"]).content)) as archive:
        assert set(archive.namelist()) == {"image.exr", "image.png", "stats.json", "log.txt"}
    assert client.get(f"/v1/jobs/{single['id']}/frames").json()["items"] == []
    assert client.get(f"/v1/jobs/{single['id']}/frames/1").status_code == 404
    assert view["frames"] is None


def test_the_same_key_answers_the_same_job(client: httpx.Client, ball: dict[str, Any]) -> None:
    body = {
        "scene": {"inline": ball},
        "settings": QUICK,
        "frames": {"turntable": {"count": 2}},
    }
    headers = {"Idempotency-Key": "two frames", "Prefer": "wait=60"}
    first = client.post("/v1/jobs", json=body, headers=headers).json()
    again = client.post("/v1/jobs", json=body, headers=headers).json()
    assert again["id"] == first["id"]
    assert again["frames"]["succeeded"] == 2
    body["frames"] = {"turntable": {"count": 3}}
    assert client.post("/v1/jobs", json=body, headers=headers).status_code == 422


def test_one_image_is_no_answer_to_frames(client: httpx.Client, ball: dict[str, Any]) -> None:
    body: dict[str, Any] = {"scene": {"inline": ball}, "settings": {**QUICK, "seed": 31}}
    wait = {"Prefer": "wait=60"}
    assert client.post("/v1/jobs", json=body, headers=wait).json()["state"] == "succeeded"
    body["frames"] = {"cameras": ["front"]}
    job = client.post("/v1/jobs", json=body, headers=wait).json()
    assert (job["state"], job["frames"]["succeeded"]) == ("succeeded", 1)


# Failures, stops and what is kept.


def render_children(server: Any) -> list[int]:
    """Process ids of the children that the service's zygote has forked."""
    found, parents = [], {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            name, fields = (entry / "stat").read_text().split("(", 1)[1].rsplit(")", 1)
        except (OSError, IndexError):
            continue
        parents[int(entry.name)] = int(fields.split()[1])
        if name == "raykiln-child":
            found.append(int(entry.name))
    return [pid for pid in found if parents.get(parents[pid]) == server.process.pid]


def test_a_frame_whose_process_crashes_is_tried_again_alone(
    server: Any, ball: dict[str, Any]
) -> None:
    job = server.submit(scene={"inline": ball}, settings=SLOWER, frames={"turntable": {"count": 3}})
    server.wait_for(
        job["id"],
        lambda view: (
            view["progress"]["frame"] == 2
            and (view["progress"]["spp_done"] or 0) in range(4, SLOWER["spp"] // 2)
        ),
    )
    children = render_children(server)
    assert children
    for pid in children:
        os.kill(pid, signal.SIGKILL)
    view = server.wait_for_end(job["id"])
    assert (view["state"], view["frames"]["succeeded"]) == ("succeeded", 3), view["error"]
    log = server.output(job["id"], "log.txt").decode()
    tries = [log.count(f"frame 000{number} of 3") for number in (1, 2, 3)]
    assert (tries[0], tries[1]) == (1, 2), log
    assert [frame["failures"] for frame in frames_of(server, job["id"])][:2] == [0, 1]


def test_one_poisonous_frame_fails_the_job_and_keeps_the_others(
    server: Any, client: httpx.Client, vanishing: bytes
) -> None:
    asset = client.post("/v1/assets", params={"filename": "gone.glb"}, content=vanishing).json()
    job = server.submit(
        scene={"asset": asset["id"]}, settings=QUICK, frames={"time": {"fps": 2, "end": 1.5}}
    )
    view = server.wait_for_end(job["id"])
    assert view["state"] == "failed"
    assert (view["frames"]["succeeded"], view["frames"]["failed"]) == (3, 1)
    assert view["error"]["frames"] == [3]
    assert "frame 0003 of 4 failed" in view["error"]["detail"]
    assert "singular" in view["error"]["detail"]
    assert view["complete"] is False
    frames = frames_of(server, job["id"])
    assert [frame["state"] for frame in frames] == ["succeeded"] * 2 + ["failed", "succeeded"]
    assert "singular" in frames[2]["error"]["detail"]
    with zipfile.ZipFile(io.BytesIO(client.get(view["links"]["archive"]).content)) as archive:
        assert {"image.0001.exr", "image.0002.exr", "image.0004.exr"} <= set(archive.namelist())
        assert "image.0003.exr" not in archive.namelist()
    client.post(f"/v1/jobs/{job['id']}/retry").raise_for_status()
    assert server.wait_for_end(job["id"])["state"] == "failed"
    log = server.output(job["id"], "log.txt").decode()
    assert [log.count(f"frame 000{number} of 4\n") for number in (1, 2, 3, 4)] == [1, 1, 2, 1]


def test_cancel_keeps_what_is_done_and_retry_renders_the_rest(
    server: Any, client: httpx.Client, ball: dict[str, Any]
) -> None:
    job = server.submit(scene={"inline": ball}, settings=SLOWER, frames={"turntable": {"count": 4}})
    server.wait_for(
        job["id"],
        lambda view: (
            done_frames(view) == 1
            and (view["progress"]["spp_done"] or 0) in range(4, SLOWER["spp"] // 2)
        ),
    )
    client.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()
    view = server.wait_for_end(job["id"])
    assert view["state"] == "cancelled"
    frames = frames_of(server, job["id"])
    states = [frame["state"] for frame in frames]
    assert states[0] == "succeeded"
    assert states[-1] == "queued"
    assert states.count("cancelled") == 1
    partial = frames[states.index("cancelled")]
    assert (partial["complete"], view["complete"]) == (False, False)
    first = frames[0]["outputs"]
    href = next(o["href"] for o in partial["outputs"] if o["name"] == "image.exr")
    assert read_exr_layers(file_of(server, href))["beauty"].mean() > 0
    client.post(f"/v1/jobs/{job['id']}/retry").raise_for_status()
    view = server.wait_for_end(job["id"])
    assert (view["state"], done_frames(view), view["complete"]) == ("succeeded", 4, True)
    assert frames_of(server, job["id"])[0]["outputs"] == first
    log = server.output(job["id"], "log.txt").decode()
    assert log.count("frame 0001 of 4\n") == 1

    def left() -> list[str]:
        return sorted(path.name for path in (server.data_dir / "jobs" / job["id"]).iterdir())

    # What nobody needs any more goes a moment after the end.
    deadline = time.monotonic() + 60
    while any(name.startswith(("work-", "checkpoint")) for name in left()):
        assert time.monotonic() < deadline, left()
        time.sleep(0.02)
    assert sum(name.startswith("frame-") for name in left()) == 4


def test_a_kill_of_the_service_costs_no_finished_frame(serve: Any, ball: dict[str, Any]) -> None:
    count = 5
    body = {"scene": {"inline": ball}, "settings": SLOW, "frames": {"turntable": {"count": count}}}
    server = serve(checkpoint_interval_s=0.05)
    job = server.submit(**body)
    seen = -1
    kills = 0
    kept: dict[int, list[Any]] = {}
    while True:
        view = server.wait_for(
            job["id"],
            lambda view, seen=seen: (
                view["state"] == "succeeded"
                or (done_frames(view) > seen and (view["progress"]["spp_done"] or 0) >= 8)
            ),
        )
        found = frames_of(server, job["id"])
        for frame in found:
            if frame["state"] == "succeeded":
                assert kept.setdefault(frame["number"], frame["outputs"]) == frame["outputs"]
        if view["state"] == "succeeded":
            break
        seen = done_frames(view)
        server.kill_all()
        kills += 1
        server = serve(checkpoint_interval_s=0.05)
    assert kills >= 2
    assert (view["frames"]["succeeded"], len(kept)) == (count, count)
    undisturbed = server.submit(**body)
    assert server.wait_for_end(undisturbed["id"])["state"] == "succeeded"
    for number in range(1, count + 1):
        hrefs = [f"/v1/jobs/{one['id']}/frames/{number}/image.exr" for one in (job, undisturbed)]
        assert beauty_of(server, hrefs[0]) == beauty_of(server, hrefs[1])


def test_an_orderly_stop_in_a_frame_goes_on_in_it(serve: Any, ball: dict[str, Any]) -> None:
    server = serve()
    job = server.submit(scene={"inline": ball}, settings=SLOW, frames={"turntable": {"count": 2}})
    server.wait_for(job["id"], lambda view: (view["progress"]["spp_done"] or 0) >= 8)
    assert server.stop() == 0
    server = serve()
    view = server.wait_for_end(job["id"])
    assert (view["state"], done_frames(view), view["error"]) == ("succeeded", 2, None)


def test_progress_is_that_of_all_frames(server: Any, ball: dict[str, Any]) -> None:
    job = server.submit(scene={"inline": ball}, settings=SLOW, frames={"turntable": {"count": 4}})
    told: list[dict[str, Any]] = []
    while (view := server.job(job["id"]))["state"] != "succeeded":
        if view["progress"]["frames"]:
            told.append(view["progress"])
        time.sleep(0.01)
    fractions = [progress["fraction"] for progress in told]
    assert all(0 <= fraction <= 1 for fraction in fractions)
    done = [progress["frames_done"] for progress in told]
    assert done == sorted(done)
    assert {progress["frames"] for progress in told} == {4}
    assert len({progress["frame"] for progress in told}) >= 3
    for progress in told:
        assert progress["fraction"] >= progress["frames_done"] / 4
        assert progress["frame"] >= progress["frames_done"]


def test_delete_removes_all_frames(server: Any, client: httpx.Client, ball: dict[str, Any]) -> None:
    job = server.submit(scene={"inline": ball}, settings=QUICK, frames={"turntable": {"count": 2}})
    server.wait_for_end(job["id"])
    folder = server.data_dir / "jobs" / job["id"]
    assert folder.is_dir()
    assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
    assert not folder.exists()
    for path in ("frames", "frames/1", "frames/1/image.exr", "outputs.zip"):
        assert client.get(f"/v1/jobs/{job['id']}/{path}").status_code == 404


# What is refused.


@pytest.mark.parametrize(
    ("frames", "more", "pointer"),
    [
        ({}, {}, "/frames"),
        ({"turntable": {"count": 2}, "cameras": "all"}, {}, "/frames"),
        ({"turntable": {}}, {}, "/frames/turntable/count"),
        ({"turntable": {"count": 0}}, {}, "/frames/turntable/count"),
        ({"turntable": {"count": 2001}}, {}, "/frames/turntable/count"),
        ({"turntable": {"count": 2, "axis": "w"}}, {}, "/frames/turntable/axis"),
        ({"turntable": {"count": 2, "degrees": 1e9}}, {}, "/frames/turntable/degrees"),
        ({"turntable": {"count": 2, "speed": 1}}, {}, "/frames/turntable/speed"),
        (
            {"turntable": {"count": 2, "elevation_degrees": 0, "target": [0, 1, 4]}},
            {},
            "/frames/turntable/elevation_degrees",
        ),
        ({"turntable": {"count": 2}}, {"settings": {"camera": "back"}}, "/settings/camera"),
        ({"cameras": []}, {}, "/frames/cameras"),
        ({"cameras": ["front", "back"]}, {}, "/frames/cameras/1"),
        ({"cameras": ["front"]}, {"settings": {"camera": "front"}}, "/settings/camera"),
        ({"time": {"fps": 24}}, {}, "/frames/time"),
        ({"time": {"fps": 0}}, {}, "/frames/time/fps"),
        (None, {"outputs": ["exr", "contact_sheet"]}, "/outputs/1"),
        (None, {"outputs": ["mp4"]}, "/outputs/0"),
    ],
)
def test_frames_that_cannot_be(
    client: httpx.Client, ball: dict[str, Any], frames: Any, more: dict[str, Any], pointer: str
) -> None:
    before = client.get("/v1/jobs", params={"limit": 1}).json()["items"]
    body = {"scene": {"inline": ball}, "settings": QUICK, "frames": frames, **more}
    reply = client.post("/v1/jobs", json=body)
    assert reply.status_code == 422, reply.text
    problem = reply.json()
    assert problem["pointer"].startswith(pointer), problem
    after = client.get("/v1/jobs", params={"limit": 1}).json()["items"]
    assert [job["id"] for job in after] == [job["id"] for job in before]


def test_moments_that_cannot_be(client: httpx.Client, moving: bytes) -> None:
    asset = client.post("/v1/assets", params={"filename": "moving.glb"}, content=moving).json()
    body: dict[str, Any] = {"scene": {"asset": asset["id"]}, "settings": QUICK}
    for times, pointer in (
        ({"start": 5}, "/frames/time/end"),
        ({"start": 2, "end": 1}, "/frames/time/end"),
        ({"end": 1e12}, "/frames/time"),
    ):
        reply = client.post("/v1/jobs", json={**body, "frames": {"time": times}})
        assert (reply.status_code, reply.json()["pointer"]) == (422, pointer)
