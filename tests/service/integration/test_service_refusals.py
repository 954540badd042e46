"""Bad input: each refusal is a problem that names the place, and leaves nothing behind."""

from __future__ import annotations

import copy
import json
import socket
import stat
import time
import zipfile
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import httpx
import pytest

QUICK = {"width": 32, "height": 24, "spp": 1}


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


@pytest.fixture(autouse=True)
def _nothing_is_left(client: httpx.Client, server: Any, ball: dict[str, Any]) -> Iterator[None]:
    """After each refusal there is no new job, and the service renders on."""
    before = client.get("/v1/jobs").json()["items"]
    yield
    assert client.get("/v1/jobs").json()["items"] == before
    folders = {path.name for path in (server.data_dir / "jobs").iterdir()}
    assert folders == {job["id"] for job in before}
    assert left_in_tmp(server) == []
    job = server.submit(scene={"inline": ball}, settings=QUICK)
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
    client.delete(f"/v1/jobs/{job['id']}")


def left_in_tmp(server: Any) -> list[str]:
    """What uploads left behind, but for what the running service keeps in that folder."""
    names = [path.name for path in (server.data_dir / "tmp").iterdir()]
    return [name for name in names if not name.startswith("desk-")]


def problem(reply: httpx.Response, status: int, slug: str) -> dict[str, Any]:
    assert reply.status_code == status, reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    document: dict[str, Any] = reply.json()
    assert document["type"] == f"urn:raykiln:problem:{slug}"
    assert document["status"] == status
    assert {"title", "detail"} <= set(document)
    assert "Traceback" not in reply.text
    return document


def changed(ball: dict[str, Any], *path: Any, to: Any) -> dict[str, Any]:
    scene = copy.deepcopy(ball)
    place = scene
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    return scene


TRIANGLE = {"type": "mesh", "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
SCENES: dict[str, tuple[tuple[Any, ...], Any, str]] = {
    "unknown material": (("shapes", 0, "material"), "gold", "gold"),
    "unknown kind": (("materials", "red", "type"), "velvet", "velvet"),
    "unknown field": (("shapes", 0, "colour"), "red", "colour"),
    "NaN vertex": (
        ("shapes", 0),
        {**TRIANGLE, "vertices": [[0, 0, 0], [1, float("nan"), 0], [0, 1, 0]]},
        "finite",
    ),
    "index out of range": (("shapes", 0), {**TRIANGLE, "faces": [[0, 1, 7]]}, "7"),
    "negative radius": (("shapes", 0, "radius"), -1, "radius"),
    "missing texture": (
        ("textures",),
        {"wood": {"type": "image", "file": "wood.png"}},
        "wood.png",
    ),
    "texture outside": (
        ("textures",),
        {"wood": {"type": "image", "file": "../../../../../etc/passwd"}},
        "passwd",
    ),
    "empty scene": (("shapes",), [], "shape"),
    "wrong version": (("version",), 2, "version"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_cannot_be_rendered(
    client: httpx.Client, ball: dict[str, Any], name: str
) -> None:
    path, value, told = SCENES[name]
    body = {"scene": {"inline": changed(ball, *path, to=value)}, "settings": QUICK}
    reply = client.post(
        "/v1/jobs", content=json.dumps(body), headers={"Content-Type": "application/json"}
    )
    document = problem(reply, 422, "invalid-scene")
    assert told in json.dumps(document), document
    assert "raykiln-data" not in reply.text
    assert "/jobs/" not in reply.text


FILES: dict[str, tuple[str, bytes]] = {
    "broken JSON": ("a.json", b'{"version": 1, "shapes": ['),
    "broken glTF": (
        "a.gltf",
        b'{"asset": {"version": "2.0"}, "nodes": [{"mesh": 3}]}',
    ),
    "broken glb": ("a.glb", b"glTF\x02\x00\x00\x00\xff\xff\xff\xff" + b"x" * 40),
    "broken XML": ("a.xml", b'<scene version="3.0.0"><shape type="sphere"></scene>'),
    "XML bomb": (
        "a.xml",
        b'<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
        b'<scene version="3.0.0">&b;</scene>',
    ),
    "text as a mesh": ("a.ply", b"this is no mesh"),
    "a mesh of 10^12 vertices": (
        "b.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n",
    ),
    "deep JSON": ("deep.json", b"[" * 200_000),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_not_what_it_says(client: httpx.Client, name: str) -> None:
    filename, content = FILES[name]
    reply = client.post("/v1/assets", content=content, params={"filename": filename})
    asset = reply.json()["id"]
    reply = client.post("/v1/jobs", json={"scene": {"asset": asset}, "settings": QUICK})
    document = problem(reply, 422, "invalid-scene")
    assert filename in json.dumps(document)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("spp", 0),
        ("spp", -5),
        ("spp", "many"),
        ("width", -1),
        ("width", 100_000),
        ("max_depth", -2),
        ("integrator", "magic"),
        ("aovs", ["beauty2"]),
        ("seed", -1),
        ("crop", [0, 0, 0]),
        ("nonsense", 1),
    ],
)
def test_settings_out_of_range(
    client: httpx.Client, ball: dict[str, Any], field: str, value: Any
) -> None:
    body = {"scene": {"inline": ball}, "settings": {field: value}}
    document = problem(client.post("/v1/jobs", json=body), 422, "invalid-settings")
    assert document["pointer"].startswith(f"/settings/{field}")


def test_settings_that_do_not_fit_together_or_the_scene(
    client: httpx.Client, ball: dict[str, Any]
) -> None:
    huge = {"scene": {"inline": ball}, "settings": {"width": 65536, "height": 65536}}
    assert (
        "pixels" in problem(client.post("/v1/jobs", json=huge), 422, "invalid-settings")["detail"]
    )
    camera = {"scene": {"inline": ball}, "settings": {"camera": "side"}}
    document = problem(client.post("/v1/jobs", json=camera), 422, "invalid-settings")
    assert (document["pointer"], document["accepted"]) == ("/settings/camera", "front")
    crop = {
        "scene": {"inline": {**ball, "settings": {"width": 16, "height": 16}}},
        "settings": {"crop": [0, 0, 32, 32]},
    }
    # The default size would hold the crop; the scene's own does not.
    assert "crop" in problem(client.post("/v1/jobs", json=crop), 422, "invalid-settings")["detail"]


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ([], None),
        ({}, "/scene"),
        ({"scene": {}}, "/scene"),
        ({"scene": {"name": "a", "inline": {}}}, "/scene"),
        ({"scene": {"name": "a", "entry": "b"}}, "/scene"),
        ({"scene": {"name": "no such scene"}}, "/scene/name"),
        ({"scene": {"asset": "sha256:12"}}, "/scene/asset"),
        ({"scene": {"asset": "sha256:" + "0" * 64}}, "/scene/asset"),
        ({"scene": {"name": "a"}, "outputs": ["gif"]}, "/outputs/0"),
        ({"scene": {"name": "a"}, "outputs": []}, "/outputs"),
        ({"scene": {"name": "a"}, "priority": 1e9}, "/priority"),
        ({"scene": {"name": "a"}, "labels": {"a": 1}}, "/labels/a"),
        ({"scene": {"name": "a"}, "surprise": 1}, "/surprise"),
    ],
)
def test_a_body_that_is_no_job(client: httpx.Client, body: Any, pointer: str | None) -> None:
    reply = client.post("/v1/jobs", json=body)
    assert reply.status_code == 422
    assert reply.json().get("pointer") == pointer


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b'{"scene": {"name": "\\ud800"}}']
)
def test_a_body_that_is_no_json(client: httpx.Client, content: bytes) -> None:
    problem(client.post("/v1/jobs", content=content), 400, "malformed-request")


def test_other_places(client: httpx.Client) -> None:
    problem(client.get("/v1/nothing"), 404, "not-found")
    problem(client.get("/v1/jobs/job-1"), 404, "not-found")
    problem(client.get("/v1/jobs/job-1/events"), 404, "not-found")
    problem(client.get("/v1/jobs/job-1/preview.png"), 404, "not-found")
    problem(client.get("/v1/assets/sha256:00"), 404, "not-found")
    problem(client.post("/v1/jobs/job-1/cancel"), 404, "not-found")
    problem(client.put("/v1/jobs"), 405, "method-not-allowed")
    assert client.get("/v1/jobs", params={"limit": 0}).json()["pointer"] == "?limit"
    for params in ({"limit": "x"}, {"state": "paused"}, {"cursor": "x"}, {"cursor": "YmVmb3JlOng"}):
        problem(client.get("/v1/jobs", params=params), 422, "invalid-request")
    too_long = {"Idempotency-Key": "k" * 300}
    problem(client.post("/v1/jobs", json={}, headers=too_long), 422, "invalid-request")


# Bundles.


def archive(*entries: tuple[str | zipfile.ZipInfo, bytes]) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, content in entries:
            bundle.writestr(name, content)
    return buffer.getvalue()


def symlink(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


BUNDLES: dict[str, tuple[bytes, str]] = {
    "traversal": (archive(("../evil.json", b"{}")), "../evil.json"),
    "absolute": (archive(("/etc/evil.json", b"{}")), "/etc/evil.json"),
    "backslash": (archive(("a\\..\\evil.json", b"{}")), "evil"),
    "symlink": (archive(("a.json", b"{}"), (symlink("b"), b"/etc/passwd")), "b"),
    "file and folder": (archive(("a", b"x"), ("a/b.json", b"{}")), "a"),
    "bomb": (archive(("a.json", b"0" * 60_000_000)), "suspiciously"),
    "cut off": (archive(("a.json", b"{}"))[:-30], "damaged"),
    "no scene": (archive(("readme.txt", b"hello")), "/scene/entry"),
}


@pytest.mark.parametrize("name", BUNDLES)
def test_a_hostile_bundle(client: httpx.Client, name: str) -> None:
    content, told = BUNDLES[name]
    asset = client.post("/v1/assets", content=content, params={"filename": "x.zip"}).json()["id"]
    reply = client.post("/v1/jobs", json={"scene": {"asset": asset}, "settings": QUICK})
    assert reply.status_code == 422, reply.text
    assert told.replace("\\", "\\\\") in json.dumps(reply.json())


def test_a_scene_that_leaves_its_bundle(client: httpx.Client, ball: dict[str, Any]) -> None:
    scene = changed(ball, "textures", to={"t": {"type": "image", "file": "../../../lock"}})
    content = archive(("set/a.json", json.dumps(scene).encode()))
    asset = client.post("/v1/assets", content=content, params={"filename": "x.zip"}).json()["id"]
    reply = client.post("/v1/jobs", json={"scene": {"asset": asset}, "settings": QUICK})
    assert "lock" in json.dumps(problem(reply, 422, "invalid-scene"))


# Uploads and connections.


def test_uploads_that_are_none(client: httpx.Client) -> None:
    problem(client.post("/v1/assets", content=b""), 422, "invalid-asset")
    no_file = client.post("/v1/assets", data={"a": "b"}, files={"c": (None, b"d")})
    problem(no_file, 400, "malformed-request")
    bad_form = client.post(
        "/v1/assets", content=b"x", headers={"Content-Type": "multipart/form-data; boundary=b"}
    )
    problem(bad_form, 400, "malformed-request")
    unnamed = client.post("/v1/assets", content=b"what is this?").json()["id"]
    reply = client.post("/v1/jobs", json={"scene": {"asset": unnamed}, "settings": QUICK})
    assert problem(reply, 422, "invalid-scene")["pointer"] == "/scene/entry"


def test_an_upload_that_breaks_off_leaves_nothing(server: Any) -> None:
    host, port = server.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as connection:
        connection.sendall(
            b"POST /v1/assets?filename=a.json HTTP/1.1\r\nHost: localhost\r\n"
            b"Content-Length: 1000\r\n\r\nbegun"
        )
        deadline = time.monotonic() + 60
        while not left_in_tmp(server):
            assert time.monotonic() < deadline, "nothing arrives"
            time.sleep(0.05)
    deadline = time.monotonic() + 60
    while left_in_tmp(server):
        assert time.monotonic() < deadline, "the upload's file stays"
        time.sleep(0.05)
