"""Attacks on the running service: each is answered with a problem, or does no harm."""

from __future__ import annotations

import base64
import io
import json
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

QUICK = {"width": 16, "height": 16, "spp": 1}


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


@pytest.fixture(autouse=True)
def _unharmed(server: Any, ball: dict[str, Any]) -> Iterator[None]:
    """Nothing is logged as an error, nothing lands outside, and the service renders on."""
    yield
    assert '"level": "error"' not in server.log.read_text()
    names = {path.name for path in server.data_dir.parent.iterdir()}
    assert not names & {"evil", "evil.json", "evil.txt"}
    job = server.submit(scene={"inline": ball}, settings=QUICK)
    assert server.wait_for_end(job["id"])["state"] == "succeeded"


def archive(*entries: tuple[str, bytes | str], pack: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", pack) as bundle:
        warnings.simplefilter("ignore")
        for name, content in entries:
            bundle.writestr(name, content)
    return buffer.getvalue()


def submit(client: httpx.Client, content: bytes, filename: str, entry: str | None) -> Any:
    """Upload, and render what came of it."""
    asset = client.post("/v1/assets", content=content, params={"filename": filename})
    if asset.status_code != 201:
        return asset
    scene = {"asset": asset.json()["id"], **({} if entry is None else {"entry": entry})}
    body = {"scene": scene, "settings": QUICK}
    return client.post("/v1/jobs", json=body, headers={"Prefer": "wait=60"})


def refused(reply: httpx.Response, told: str) -> None:
    assert reply.status_code == 422, reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    assert told in json.dumps(reply.json()), reply.text
    assert "root:" not in reply.text
    assert "Traceback" not in reply.text


# Bundles.


def with_shared_bytes() -> bytes:
    """Many entries that unpack from the same bytes, none of which is suspicious by itself."""
    content = bytes(range(256)) * 4000
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = squeeze.compress(content) + squeeze.flush()
    check, sizes = zlib.crc32(content), (len(packed), len(content))
    local = struct.pack("<IHHHHHIIIHH", 0x04034B50, 20, 0, 8, 0, 33, check, *sizes, 1, 0) + b"a"
    records = b"".join(
        struct.pack(
            "<IHHHHHHIIIHHHHHII",
            *(0x02014B50, 20, 20, 0, 8, 0, 33, check, *sizes, 4, 0, 0, 0, 0, 0o100644 << 16, 0),
        )
        + f"{number:04d}".encode()
        for number in range(3000)
    )
    body = local + packed
    end = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 3000, 3000, len(records), len(body), 0)
    return body + records + end


def renamed(content: bytes, old: bytes, new: bytes) -> bytes:
    assert len(old) == len(new)
    assert content.count(old) == 2
    return content.replace(old, new)


def marked_as_encrypted(content: bytes) -> bytes:
    data = bytearray(content)
    data[data.rfind(b"PK\x01\x02") + 8] |= 1
    return bytes(data)


def test_bundles(client: httpx.Client, ball: dict[str, Any]) -> None:
    scene = json.dumps(ball)
    twice = archive(("a.json", scene), ("a.json", scene + " "))
    nul = renamed(archive(("a.json", scene), ("b.json@evil.exe", "x")), b"@", b"\0")
    for content, told in (
        (twice, "twice"),
        (nul, "name is not accepted"),
        (with_shared_bytes(), "overlap"),
        (marked_as_encrypted(archive(("a.json", scene))), "encrypted"),
        (archive(("a.json", scene), ("b\nc.txt", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("b\u202egnp.exe", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("./b", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("C:evil", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("../evil.json", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("d/" * 40 + "x", "x")), "name is not accepted"),
        (archive(("a.json", scene), ("n" * 300, "x")), "name is not accepted"),
    ):
        refused(submit(client, content, "x.zip", "a.json"), told)


@pytest.mark.parametrize(
    "entry", ["../a.json", "/etc/passwd", "a\0.json", "d", "./a.json", "B.JSON"]
)
def test_entries(client: httpx.Client, ball: dict[str, Any], entry: str) -> None:
    content = archive(("a.json", json.dumps(ball)), ("d/b.json", "{}"))
    refused(submit(client, content, "x.zip", entry), "the bundle has no such file")


def test_an_archive_within_an_archive_is_not_opened(
    client: httpx.Client, ball: dict[str, Any]
) -> None:
    inner = archive(("a.json", "0" * 50_000_000))
    content = archive(("inner.zip", inner), ("a.json", json.dumps(ball)))
    refused(submit(client, content, "x.zip", "inner.zip"), "not a known scene format")
    assert submit(client, content, "x.zip", "a.json").json()["state"] == "succeeded"


# What a scene refers to.


@pytest.mark.parametrize(
    "uri",
    [
        "file:///etc/passwd",
        "http://127.0.0.1:1/x.png",
        "https://example.com/x.png",
        "//example.com/x.png",
        "/etc/passwd",
        "/dev/zero",
        "/proc/self/environ",
        "..%2f..%2fetc%2fpasswd",
        "..\\..\\etc\\passwd",
        "a\0.png",
        ".",
        "a.json",
    ],
)
def test_what_is_not_inside(client: httpx.Client, ball: dict[str, Any], uri: str) -> None:
    texture = {"t": {"type": "image", "file": uri}}
    red = {"type": "diffuse", "reflectance": {"texture": "t"}}
    scene = {**ball, "textures": texture, "materials": {**ball["materials"], "red": red}}
    refused(submit(client, archive(("a.json", json.dumps(scene))), "x.zip", "a.json"), "")
    triangle = base64.b64encode(struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)).decode()
    gltf = {
        "asset": {"version": "2.0"},
        "buffers": [
            {"byteLength": 36, "uri": uri},
            {"byteLength": 36, "uri": f"data:;base64,{triangle}"},
        ],
        "bufferViews": [{"buffer": number, "byteLength": 36} for number in (0, 1)],
        "accessors": [
            {"bufferView": number, "componentType": 5126, "count": 3, "type": "VEC3"}
            for number in (0, 1)
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    content = archive(("a.gltf", json.dumps(gltf)), ("a.json", "{}"))
    refused(submit(client, content, "x.zip", "a.gltf"), "")


def png(width: int, height: int, data: bytes) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(data, 9))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + pixels + chunk(b"IEND", b"")


def exr(width: int, height: int) -> bytes:
    def field(name: bytes, kind: bytes, content: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<I", len(content)) + content

    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    channels = b"".join(n + b"\0" + struct.pack("<IIII", 1, 0, 1, 1) for n in (b"B", b"G", b"R"))
    return (
        b"\x76\x2f\x31\x01\x02\0\0\0"
        + field(b"channels", b"chlist", channels + b"\0")
        + field(b"compression", b"compression", b"\3")
        + field(b"dataWindow", b"box2i", window)
        + field(b"displayWindow", b"box2i", window)
        + field(b"lineOrder", b"lineOrder", b"\0")
        + field(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
        + field(b"screenWindowCenter", b"v2f", bytes(8))
        + field(b"screenWindowWidth", b"float", struct.pack("<f", 1))
        + b"\0"
        + bytes(800)
    )


IMAGES = {
    "a bomb": png(60_000, 60_000, bytes(30_000_000)),
    "no pixels": png(0, 0, b""),
    "cut off": png(64, 64, bytes(64 * 193))[:60],
    "text": b"hello",
    "a large EXR without data": exr(60_000, 60_000),
    "an EXR of more pixels than numbers": exr(2**31 - 1, 2**31 - 1),
    "a wide EXR": exr(1 << 20, 2),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images(client: httpx.Client, ball: dict[str, Any], name: str) -> None:
    red = {"type": "diffuse", "reflectance": {"texture": "t"}}
    for file in ("t.png", "t.exr"):
        scene = {
            **ball,
            "textures": {"t": {"type": "image", "file": file}},
            "materials": {**ball["materials"], "red": red},
        }
        entries = (("a.json", json.dumps(scene)), (file, IMAGES[name]))
        content = archive(*entries, pack=zipfile.ZIP_STORED)
        refused(submit(client, content, "x.zip", "a.json"), "/textures/t")


# Numbers and texts.


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "[" * 500_000 + "]" * 500_000,
        lambda text: text.replace("0.7", "1e400"),
        lambda text: text.replace('"version": 1', '"version": ' + "9" * 5000),
        lambda text: text.replace('"version": 1', '"version": 1, "version": 1'),
        lambda text: text.replace("0.7", "NaN"),
        lambda text: text.replace("0.7", "-Infinity"),
        lambda text: text + "\0",
        lambda text: text[:-1],
    ],
)
def test_texts_that_only_look_like_json(
    client: httpx.Client, ball: dict[str, Any], change: Any
) -> None:
    content = change(json.dumps(ball)).encode()
    refused(submit(client, content, "a.json", None), "invalid-scene")


def test_names_and_labels(client: httpx.Client) -> None:
    for name in ("a\r\nX-Evil: 1.json", "a\0.json", "a\u202e.json", "..", "a" * 250 + ".json"):
        reply = client.post("/v1/assets", content=b"{}", params={"filename": name})
        assert reply.status_code in (400, 422), name
        assert "X-Evil" not in reply.headers
    for labels in ({"a\r\nb": "c"}, {"a": "b\0"}, {"a": "\x1b[31m"}, {"": "x"}, {"a": "x" * 300}):
        body = {"scene": {"name": "cornell_box"}, "settings": QUICK, "labels": labels}
        reply = client.post("/v1/jobs", json=body)
        assert reply.status_code == 422, labels
        assert reply.json()["pointer"].startswith("/labels"), reply.text


def test_a_form_with_a_name_from_anywhere(client: httpx.Client) -> None:
    for name in ("場面.json", "Küche – neu.json", "مشهد.json"):
        head = f'Content-Disposition: form-data; name="file"; filename="{name}"'
        form = f"--b\r\n{head}\r\n\r\n{{}}\r\n--b--\r\n".encode()
        kind = {"Content-Type": "multipart/form-data; boundary=b"}
        reply = client.post("/v1/assets", content=form, headers=kind)
        assert reply.status_code == 201, reply.text
        assert reply.json()["filename"] == name


@pytest.mark.parametrize(
    "path",
    [
        "/v1/jobs/%00",
        "/v1/jobs?label=%00",
        "/v1/jobs/..%2f..%2flock",
        "/v1/jobs/job-1/outputs/..%2f..%2f..%2flock",
        "/v1/assets/sha256:..%2f..%2flock",
        "/v1/uploads/..%2f..%2flock",
        "/web/..%2fapp.py",
        "/web/%2e%2e/app.py",
        "/v1/jobs/" + "x" * 5000,
    ],
)
def test_paths(client: httpx.Client, server: Any, path: str) -> None:
    reply = client.get(path)
    assert reply.status_code in (400, 404), reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    assert str(server.data_dir) not in reply.text


def test_two_lengths_and_two_encodings(server: Any) -> None:
    """What a proxy and the service might read differently is not read at all."""
    import socket

    host, port = server.url.removeprefix("http://").split(":")
    for lines in (
        "Content-Length: 2\r\nContent-Length: 3\r\n",
        "Content-Length: 2\r\nTransfer-Encoding: chunked\r\n",
        "Transfer-Encoding: chunked, identity\r\n",
        "Content-Length: -2\r\n",
    ):
        with socket.create_connection((host, int(port)), timeout=20) as connection:
            request = f"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n{lines}\r\n{{}}"
            connection.sendall(request.encode())
            connection.settimeout(20)
            reply = connection.recv(4096)
        assert reply.split(b" ")[1] in (b"400", b"501"), reply
