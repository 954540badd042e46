"""The HTTP contract, against the real service on a free port."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from raykiln.image import read_exr_layers, read_image

QUICK = {"width": 32, "height": 24, "spp": 4}
ENDLESS = {"width": 256, "height": 256, "spp": 100_000}


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


@pytest.fixture(scope="module")
def done(server: Any, ball: dict[str, Any]) -> dict[str, Any]:
    """A finished job."""
    job = server.submit(scene={"inline": ball}, settings={**QUICK, "aovs": ["depth"]})
    view: dict[str, Any] = server.wait_for_end(job["id"])
    assert view["state"] == "succeeded", view["error"]
    return view


@pytest.fixture
def endless(server: Any, ball: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A job that runs until it is cancelled."""
    job = server.submit(scene={"inline": ball}, settings=ENDLESS)
    yield server.wait_for(job["id"], lambda view: (view["progress"]["spp_done"] or 0) >= 1)
    with server.client() as client:
        client.post(f"/v1/jobs/{job['id']}/cancel")
        server.wait_for_end(job["id"])


def bundle(**files: Any) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            text = content if isinstance(content, bytes) else json.dumps(content)
            archive.writestr(name.replace("__", "/").replace("_DOT_", "."), text)
    return buffer.getvalue()


# Jobs.


def test_a_job_from_submission_to_outputs(client: httpx.Client, ball: dict[str, Any]) -> None:
    body = {"scene": {"inline": ball}, "settings": QUICK, "labels": {"shot": "010"}}
    reply = client.post("/v1/jobs", json=body, headers={"Prefer": "respond-async, wait=60"})
    assert reply.status_code == 200
    job = reply.json()
    assert reply.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert reply.headers["Preference-Applied"] == "wait=60"
    assert (job["state"], job["complete"], job["labels"]) == ("succeeded", True, {"shot": "010"})
    assert client.get(reply.headers["Location"]).json() == job
    for output in job["outputs"]:
        content = client.get(output["href"]).content
        assert len(content) == output["size_bytes"]
        assert hashlib.sha256(content).hexdigest() == output["sha256"]
    names = {output["name"] for output in job["outputs"]}
    assert names == {"image.exr", "image.png", "stats.json"}
    image = read_exr_layers(client.get(f"/v1/jobs/{job['id']}/outputs/image.exr").content)
    assert image["beauty"].shape == (24, 32, 3)
    assert image["beauty"].mean() > 0.01
    assert read_image(client.get(job["links"]["preview"]).content).shape == (24, 32, 3)


def test_stats(client: httpx.Client, done: dict[str, Any]) -> None:
    stats = client.get(f"/v1/jobs/{done['id']}/outputs/stats.json").json()
    wanted = (
        "queue_s load_s bvh_s render_s denoise_s encode_s total_s samples spp camera_rays "
        "bounce_rays shadow_rays rays_per_s peak_memory_bytes triangles threads isa "
        "nonfinite_samples engine_version scene_sha256"
    )
    assert set(wanted.split()) <= set(stats)
    assert stats["samples"] == 32 * 24 * 4
    assert stats["total_s"] >= stats["render_s"] > 0
    assert done["stats"] == stats


def test_only_what_is_wanted_is_written(server: Any, ball: dict[str, Any]) -> None:
    job = server.submit(scene={"inline": ball}, settings=QUICK, outputs=["exr"])
    names = {output["name"] for output in server.wait_for_end(job["id"])["outputs"]}
    assert names == {"image.exr", "stats.json"}


def test_waiting_ends_when_the_time_is_over(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    body = {"scene": {"inline": ball}, "settings": ENDLESS}
    reply = client.post("/v1/jobs", json=body, headers={"Prefer": "wait=1"})
    assert reply.status_code == 202
    assert reply.json()["state"] in ("queued", "running")
    client.post(f"/v1/jobs/{reply.json()['id']}/cancel")
    server.wait_for_end(reply.json()["id"])


def test_the_same_key_answers_the_same_job(client: httpx.Client, ball: dict[str, Any]) -> None:
    body = {"scene": {"inline": ball}, "settings": QUICK}
    headers = {"Idempotency-Key": "one and the same"}
    first = client.post("/v1/jobs", json=body, headers=headers).json()
    again = client.post("/v1/jobs", json=dict(reversed(body.items())), headers=headers)
    assert (again.status_code, again.json()["id"]) == (202, first["id"])
    body["settings"] = {**QUICK, "seed": 1}
    other = client.post("/v1/jobs", json=body, headers=headers)
    assert other.status_code == 422
    assert other.json()["type"] == "urn:raykiln:problem:idempotency-mismatch"


def test_pages_and_filters(client: httpx.Client, server: Any, ball: dict[str, Any]) -> None:
    made = [
        server.submit(scene={"inline": ball}, settings=QUICK, labels={"page": str(i % 2)})["id"]
        for i in range(5)
    ]
    found, cursor = [], None
    while True:
        params: dict[str, Any] = {"label": "page", "limit": 2}
        params |= {} if cursor is None else {"cursor": cursor}
        page = client.get("/v1/jobs", params=params).json()
        found += [job["id"] for job in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert found == made[::-1]
    even = client.get("/v1/jobs", params={"label": "page=0"}).json()["items"]
    assert [job["id"] for job in even] == made[::2][::-1]
    for job_id in made:
        server.wait_for_end(job_id)
    ended = client.get("/v1/jobs", params={"label": "page", "state": "succeeded,failed"}).json()
    assert len(ended["items"]) == 5
    assert client.get("/v1/jobs", params={"label": "page", "state": "queued"}).json() == {
        "items": [],
        "next_cursor": None,
    }


def test_cancel_keeps_the_partial_image_and_retry_goes_on(
    client: httpx.Client, server: Any, endless: dict[str, Any]
) -> None:
    path = endless["links"]["self"]
    assert client.post(f"{path}/cancel").status_code == 200
    job = server.wait_for_end(endless["id"])
    assert (job["state"], job["complete"]) == ("cancelled", False)
    image = read_exr_layers(server.output(job["id"], "image.exr"))["beauty"]
    assert image.shape == (256, 256, 3)
    assert client.post(f"{path}/cancel").json()["state"] == "cancelled"
    retried = client.post(f"{path}/retry")
    assert (retried.status_code, retried.json()["state"]) == (202, "queued")
    again = server.wait_for(job["id"], lambda view: view["progress"]["phase"] == "render")
    assert again["progress"]["spp_done"] >= 1


def test_a_queued_job_knows_its_place_and_can_be_cancelled_or_not_deleted(
    client: httpx.Client, server: Any, ball: dict[str, Any], endless: dict[str, Any]
) -> None:
    quick = {"scene": {"inline": ball}, "settings": QUICK, "cache": False}
    waiting = [server.submit(**quick) for _ in range(2)]
    first = server.submit(**quick, priority=9)
    views = [server.job(job["id"]) for job in (first, *waiting)]
    assert [view["queue_position"] for view in views] == [0, 1, 2]
    path = first["links"]["self"]
    refusal = client.delete(path)
    assert (refusal.status_code, refusal.json()["title"]) == (
        409,
        "The job's state does not allow this",
    )
    for job in (first, *waiting):
        assert client.post(f"/v1/jobs/{job['id']}/cancel").json()["state"] == "cancelled"
    assert client.delete(path).status_code == 204
    assert client.get(path).status_code == 404


def test_delete_removes_the_outputs(client: httpx.Client, server: Any, ball: Any) -> None:
    job = server.wait_for_end(server.submit(scene={"inline": ball}, settings=QUICK)["id"])
    folder = server.data_dir / "jobs" / job["id"]
    assert folder.exists()
    assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
    assert not folder.exists()
    assert client.get(job["outputs"][0]["href"]).status_code == 404


def test_no_retry_of_what_went_well(client: httpx.Client, done: dict[str, Any]) -> None:
    reply = client.post(f"/v1/jobs/{done['id']}/retry")
    assert (reply.status_code, "succeeded cannot retry" in reply.json()["detail"]) == (409, True)


# Assets.


def test_the_same_bytes_are_stored_once(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    data = json.dumps(ball).encode()
    wanted = "sha256:" + hashlib.sha256(data).hexdigest()
    replies = [
        client.post("/v1/assets", content=data, params={"filename": "a/b/ball.json"}),
        client.post("/v1/assets", files={"file": ("ball.json", data)}),
        client.post(
            "/v1/assets",
            content=data,
            headers={"Content-Disposition": 'attachment; filename="ball.json"'},
        ),
    ]
    for reply in replies:
        assert reply.status_code == 201
        view = reply.json()
        assert (view["id"], view["size_bytes"], view["filename"]) == (
            wanted,
            len(data),
            "ball.json",
        )
    assert client.get(f"/v1/assets/{wanted}").json()["size_bytes"] == len(data)
    stored = [p for p in (server.data_dir / "assets").rglob("*") if p.is_file()]
    assert sum(p.read_bytes() == data for p in stored) == 1
    job = server.submit(scene={"asset": wanted}, settings=QUICK)
    assert job["scene"] == {"asset": wanted, "entry": "ball.json"}
    assert server.wait_for_end(job["id"])["state"] == "succeeded"


def test_a_bundle_brings_its_files(client: httpx.Client, server: Any, ball: Any) -> None:
    ply = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    ply += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ply += b"-1 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    scene = {**ball, "shapes": [*ball["shapes"], {"type": "mesh", "file": "mesh/a.ply"}]}
    data = bundle(set__scene_DOT_json=scene, set__mesh__a_DOT_ply=ply)
    asset = client.post("/v1/assets", content=data, params={"filename": "set.zip"}).json()["id"]
    unnamed = client.post("/v1/jobs", json={"scene": {"asset": asset}, "settings": QUICK})
    assert unnamed.status_code == 422
    assert unnamed.json()["pointer"] == "/scene/entry"
    assert "set/scene.json" in unnamed.json()["accepted"]
    job = server.submit(scene={"asset": asset, "entry": "set/scene.json"}, settings=QUICK)
    job = server.wait_for_end(job["id"])
    assert job["state"] == "succeeded"
    assert job["stats"]["triangles"] == 3


# Outputs.


def test_conditional_and_partial_requests(client: httpx.Client, done: dict[str, Any]) -> None:
    path = f"/v1/jobs/{done['id']}/outputs/image.exr"
    whole = client.get(path)
    etag = whole.headers["ETag"]
    assert client.get(path, headers={"If-None-Match": etag}).status_code == 304
    assert client.get(path, headers={"If-None-Match": f'"x", W/{etag}'}).status_code == 304
    part = client.get(path, headers={"Range": "bytes=4-9"})
    assert (part.status_code, part.content) == (206, whole.content[4:10])
    assert part.headers["Content-Range"] == f"bytes 4-9/{len(whole.content)}"
    stale = client.get(path, headers={"Range": "bytes=4-9", "If-Range": '"old"'})
    assert (stale.status_code, stale.content) == (200, whole.content)
    beyond = client.get(path, headers={"Range": f"bytes={len(whole.content)}-"})
    assert beyond.status_code == 416
    head = client.head(path)
    assert (head.headers["Content-Length"], head.content) == (str(len(whole.content)), b"")


def test_other_pictures_of_the_same_image(client: httpx.Client, done: dict[str, Any]) -> None:
    path = f"/v1/jobs/{done['id']}/outputs/image.png"
    plain = read_image(client.get(path).content)
    brighter = client.get(path, params={"exposure": 2})
    assert read_image(brighter.content).mean() > plain.mean()
    agx = client.get(path, params={"view": "agx"})
    assert (read_image(agx.content) != plain).any()
    assert agx.headers["ETag"] != brighter.headers["ETag"]
    known = {"If-None-Match": agx.headers["ETag"]}
    assert client.get(path, params={"view": "agx"}, headers=known).status_code == 304
    depth = client.get(f"/v1/jobs/{done['id']}/outputs/depth.png")
    assert read_image(depth.content).shape == (24, 32, 3)
    for params in ({"view": "sepia"}, {"exposure": "nan"}, {"exposure": "1e9"}):
        assert client.get(path, params=params).status_code == 422


def test_what_is_not_there(client: httpx.Client, done: dict[str, Any]) -> None:
    base = f"/v1/jobs/{done['id']}/outputs"
    for name in ("normal.exr", "nothing.txt", "..%2f..%2fscene.json", "checkpoint"):
        reply = client.get(f"{base}/{name}")
        assert reply.status_code == 404
        assert reply.headers["Content-Type"] == "application/problem+json"
    assert "image.exr" in client.get(f"{base}/normal.exr").json()["accepted"]
    assert b"rendered 32 x 24 at 4 spp" in client.get(f"{base}/log.txt").content


# Events.


def events_of(reply: httpx.Response) -> Iterator[dict[str, Any]]:
    event: dict[str, Any] = {}
    for line in reply.iter_lines():
        if not line:
            if "data" in event:
                yield event
            event = {}
        elif not line.startswith(":"):
            name, value = line.split(": ", 1)
            event[name] = json.loads(value) if name == "data" else value


def test_the_event_stream_tells_all_until_the_end(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    settings = {"width": 128, "height": 128, "spp": 1024, "threads": 1}
    # Previews are news of the moment: the job begins when its reader is there.
    client.post("/v1/queue/pause").raise_for_status()
    job = server.submit(scene={"inline": ball}, settings=settings)
    with client.stream("GET", f"/v1/jobs/{job['id']}/events") as reply:
        assert reply.headers["Content-Type"].startswith("text/event-stream")
        stream = events_of(reply)
        events = [next(stream)]
        with server.client() as other:
            other.post("/v1/queue/resume").raise_for_status()
        events += stream
    states = [event["data"]["state"] for event in events if event["event"] == "state"]
    assert states == ["queued", "running", "succeeded"]
    assert [e["event"] for e in events][-1] == "state"
    progress = [event["data"] for event in events if event["event"] == "progress"]
    fractions = [p["fraction"] for p in progress]
    assert fractions == sorted(fractions)
    assert any(event["event"] == "preview" for event in events)
    assert all("id" in event for event in events if event["event"] == "state")


def test_a_reader_that_comes_back_misses_nothing(
    client: httpx.Client, done: dict[str, Any]
) -> None:
    path = f"/v1/jobs/{done['id']}/events"
    with client.stream("GET", path) as reply:
        ids = [event["id"] for event in events_of(reply)]
    assert len(ids) == 3
    for i, last in enumerate(ids[:-1]):
        with client.stream("GET", path, headers={"Last-Event-ID": last}) as reply:
            assert [event["id"] for event in events_of(reply)] == ids[i + 1 :]
    assert client.get(path, headers={"Last-Event-ID": ids[-1]}).status_code == 204
    assert client.get(path, headers={"Last-Event-ID": "x"}).status_code == 422


# About the service.


def test_health_metrics_and_documents(client: httpx.Client, done: dict[str, Any]) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    assert client.get("/readyz").json() == {"status": "ok", "database": "ok", "executor": "ok"}
    metrics = client.get("/metrics").text
    assert 'raykiln_jobs{state="queued"}' in metrics
    assert 'raykiln_rays_total{kind="camera"}' in metrics
    assert client.get("/v1/version").json()["api"] == "v1"
    assert client.get("/v1/settings/schema").json()["properties"]["spp"]["default"] == 64
    document = client.get("/openapi.json").json()
    assert {"/v1/jobs", "/v1/assets", "/v1/jobs/{job_id}/events"} <= set(document["paths"])
    text = json.dumps(document)
    for reference in set(text.split('"#/components/schemas/')[1:]):
        assert reference.split('"')[0] in document["components"]["schemas"]
    for path in ("/", "/docs", "/web/main.js", "/web/style.css", "/web/docs.js"):
        assert client.get(path).status_code == 200
    assert "script-src" not in client.get("/").text
    assert "https://" not in client.get("/").text + client.get("/web/main.js").text


def test_bundled_scenes(client: httpx.Client, server: Any) -> None:
    scenes = client.get("/v1/scenes").json()
    if not scenes:
        pytest.skip("there are no bundled scenes yet")
    job = server.submit(scene={"name": scenes[0]["name"]}, settings={**QUICK, "spp": 1})
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
