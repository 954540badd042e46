"""Uploads that go on: tus against the real service, with broken connections and kills."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import io
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from raykiln_service.client import AsyncClient, Client

TUS = {"Tus-Resumable": "1.0.0"}
KIND = {"Content-Type": "application/offset+octet-stream"}
QUICK = {"width": 16, "height": 16, "spp": 1}


def b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def client(server: Any) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


def begin(client: httpx.Client, length: int, **headers: str) -> str:
    """A new upload's path."""
    reply = client.post("/v1/uploads", headers={**TUS, "Upload-Length": str(length), **headers})
    assert reply.status_code == 201, reply.text
    assert reply.headers["Tus-Resumable"] == "1.0.0"
    return reply.headers["Location"]


def send(client: httpx.Client, path: str, offset: int, data: Any, **headers: str) -> httpx.Response:
    return client.patch(
        path, content=data, headers={**TUS, **KIND, "Upload-Offset": str(offset), **headers}
    )


def offset_of(client: httpx.Client, path: str) -> int:
    reply = client.head(path, headers=TUS)
    assert reply.status_code == 200
    assert reply.headers["Cache-Control"] == "no-store"
    return int(reply.headers["Upload-Offset"])


def problem(reply: httpx.Response, status: int) -> dict[str, Any]:
    assert reply.status_code == status, reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    document: dict[str, Any] = reply.json()
    return document


def files_under_way(server: Any) -> list[Path]:
    return list((server.data_dir / "uploads").iterdir())


def test_what_the_service_can_do(client: httpx.Client) -> None:
    reply = client.options("/v1/uploads")
    assert reply.status_code == 204
    assert reply.headers["Tus-Version"] == "1.0.0"
    assert {"creation", "checksum", "expiration", "termination"} <= set(
        reply.headers["Tus-Extension"].split(",")
    )
    assert int(reply.headers["Tus-Max-Size"]) > 0
    assert "sha256" in reply.headers["Tus-Checksum-Algorithm"].split(",")


def test_an_upload_in_pieces_becomes_an_asset_that_renders(
    client: httpx.Client, server: Any, ball: dict[str, Any]
) -> None:
    content = json.dumps({**ball, "name": "in pieces"}).encode()
    meta = f"filename {b64(b'ball.json')},sha256 {b64(sha256(content).encode())},empty"
    path = begin(client, len(content), **{"Upload-Metadata": meta})
    third = len(content) // 3
    assert offset_of(client, path) == 0
    for start, end in ((0, third), (third, 2 * third)):
        reply = send(client, path, start, content[start:end])
        assert (reply.status_code, reply.headers["Upload-Offset"]) == (204, str(end))
        assert "Raykiln-Asset" not in reply.headers
        assert "Upload-Expires" in reply.headers
    listed = client.get("/v1/uploads", params={"sha256": sha256(content)}).json()["items"]
    assert [item["offset"] for item in listed] == [2 * third]
    last = send(client, path, 2 * third, content[2 * third :])
    asset = last.headers["Raykiln-Asset"]
    assert asset == f"sha256:{sha256(content)}"
    assert client.head(path, headers=TUS).headers["Raykiln-Asset"] == asset
    assert client.get(path).json()["asset"] == asset
    assert client.get(f"/v1/assets/{asset}").json()["filename"] == "ball.json"
    assert client.head(f"/v1/assets/{asset}").status_code == 200
    body = {"scene": {"asset": asset}, "settings": QUICK}
    job = client.post("/v1/jobs", json=body, headers={"Prefer": "wait=60"}).json()
    assert job["state"] == "succeeded"
    problem(send(client, path, len(content), b""), 409)
    assert client.delete(path, headers=TUS).status_code == 204
    assert client.get(f"/v1/assets/{asset}").status_code == 200
    assert files_under_way(server) == []


def test_an_upload_in_one_call(client: httpx.Client) -> None:
    content = os.urandom(3000)
    digest = f"sha-256=:{b64(hashlib.sha256(content).digest())}:"
    reply = client.post(
        "/v1/uploads",
        content=content,
        headers={**TUS, **KIND, "Upload-Length": "3000", "Repr-Digest": digest},
    )
    assert reply.status_code == 201
    assert reply.headers["Raykiln-Asset"] == f"sha256:{sha256(content)}"
    assert reply.headers["Upload-Offset"] == "3000"


def test_a_piece_at_the_wrong_place(client: httpx.Client) -> None:
    path = begin(client, 100)
    assert send(client, path, 0, b"x" * 10).status_code == 204
    for offset in (0, 9, 11, 100):
        reply = send(client, path, offset, b"y" * 10)
        assert problem(reply, 409)["accepted"] == "10"
        assert reply.headers["Upload-Offset"] == "10"
    problem(send(client, path, 10, b"y" * 91), 413)
    problem(send(client, path, 10, (b"y" * 30 for _ in range(4))), 413)
    assert client.delete(path, headers=TUS).status_code == 204
    problem(client.get(path), 404)


@pytest.mark.parametrize("algorithm", ["sha256", "sha1"])
def test_a_piece_that_was_damaged_does_not_count(client: httpx.Client, algorithm: str) -> None:
    path = begin(client, 20)
    good = b64(hashlib.new(algorithm, b"0123456789").digest())
    headers = {"Upload-Checksum": f"{algorithm} {good}"}
    assert send(client, path, 0, b"0123456789", **headers).status_code == 204
    reply = send(client, path, 10, b"012345678x", **headers)
    assert problem(reply, 460)["type"] == "urn:raykiln:problem:checksum-mismatch"
    assert offset_of(client, path) == 10
    assert send(client, path, 10, b"0123456789", **headers).status_code == 204


def test_a_whole_that_was_damaged_is_dropped(client: httpx.Client, server: Any) -> None:
    wrong = {"Upload-Metadata": f"sha256 {b64(b'0' * 64)}"}
    path = begin(client, 4, **wrong)
    problem(send(client, path, 0, b"abcd"), 460)
    problem(client.get(path), 404)
    assert files_under_way(server) == []
    digest = {"Repr-Digest": f"sha-256=:{b64(bytes(32))}:"}
    problem(client.post("/v1/assets", content=b"abcd", headers=digest), 460)
    right = {"Content-Digest": f"sha-256=:{b64(hashlib.sha256(b'abcd').digest())}:"}
    assert client.post("/v1/assets", content=b"abcd", headers=right).status_code == 201


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 400),
        ({"Upload-Length": "x"}, 400),
        ({"Upload-Length": "-1"}, 400),
        ({"Upload-Length": "1" * 30}, 400),
        ({"Upload-Length": "0"}, 422),
        ({"Upload-Length": "99999999999999"}, 413),
        ({"Upload-Length": "5", "Tus-Resumable": "0.2.2"}, 412),
        ({"Upload-Length": "5", "Tus-Resumable": ""}, 412),
        ({"Upload-Length": "5", "Upload-Metadata": "filename =="}, 400),
        ({"Upload-Length": "5", "Upload-Metadata": f"filename {b64(b'..')}"}, 422),
        ({"Upload-Length": "5", "Upload-Metadata": f"filename {b64(bytes(3))}"}, 422),
        ({"Upload-Length": "5", "Upload-Metadata": f"sha256 {b64(b'12')}"}, 400),
        ({"Upload-Length": "5", "Upload-Checksum": "md5 AAAA"}, 400),
        ({"Upload-Length": "5", "Upload-Checksum": "sha256 ?"}, 400),
        ({"Upload-Length": "5", "Repr-Digest": "sha-256=:AAAA:"}, 400),
        ({"Upload-Length": "5", "Repr-Digest": f"sha-256={64 * chr(97)}"}, 400),
    ],
)
def test_what_cannot_be_begun(
    client: httpx.Client, server: Any, headers: dict[str, str], status: int
) -> None:
    before = files_under_way(server)
    reply = client.post("/v1/uploads", headers={**TUS, **headers})
    problem(reply, status)
    if status == 412:
        assert reply.headers["Tus-Version"] == "1.0.0"
    assert files_under_way(server) == before


def test_what_cannot_go_on(client: httpx.Client) -> None:
    path = begin(client, 10)
    problem(client.patch(path, content=b"x", headers={**TUS, "Upload-Offset": "0"}), 415)
    problem(client.patch(path, content=b"x", headers={**TUS, **KIND}), 400)
    problem(client.patch(path, content=b"x", headers=KIND), 412)
    problem(send(client, "/v1/uploads/up-nothing", 0, b"x"), 404)
    problem(send(client, "/v1/uploads/..%2flock", 0, b"x"), 404)
    assert client.head("/v1/uploads/up-nothing", headers=TUS).status_code == 404
    assert offset_of(client, path) == 0
    client.delete(path, headers=TUS)


def connect(server: Any, path: str, length: int, offset: int = 0) -> socket.socket:
    """A connection on which a piece has been announced."""
    host, port = server.url.removeprefix("http://").split(":")
    connection = socket.create_connection((host, int(port)), timeout=60)
    connection.sendall(
        f"PATCH {path} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\n"
        f"Content-Type: application/offset+octet-stream\r\nUpload-Offset: {offset}\r\n"
        f"Content-Length: {length}\r\n\r\n".encode()
    )
    return connection


def wait_for_bytes(client: httpx.Client, path: str, count: int) -> None:
    deadline = time.monotonic() + 60
    while client.get(path).json()["offset"] < count:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_broken_connection_loses_nothing_that_came(client: httpx.Client, server: Any) -> None:
    content = os.urandom(300_000)
    path = begin(client, len(content))
    with connect(server, path, len(content)) as connection:
        connection.sendall(content[:200_000])
        # Python buffers what it writes; most of it must show without the connection's end.
        wait_for_bytes(client, path, 100_000)
    deadline = time.monotonic() + 60
    while offset_of(client, path) < 200_000:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    reply = send(client, path, 200_000, content[200_000:])
    assert reply.headers["Raykiln-Asset"] == f"sha256:{sha256(content)}"


def test_a_client_that_comes_back_takes_over_from_its_dead_connection(
    client: httpx.Client, server: Any
) -> None:
    content = os.urandom(50_000)
    path = begin(client, len(content))
    with connect(server, path, len(content)) as dead:
        dead.sendall(content[:20_000])
        # The connection stays open, and says nothing more. Python buffers what it writes.
        wait_for_bytes(client, path, 20_000 - io.DEFAULT_BUFFER_SIZE)
        there = offset_of(client, path)
        assert 20_000 - io.DEFAULT_BUFFER_SIZE <= there <= 20_000
        reply = send(client, path, there, content[there:])
        assert reply.headers["Raykiln-Asset"] == f"sha256:{sha256(content)}"
        with contextlib.suppress(OSError):
            assert b" 409 " in dead.recv(4096).split(b"\r\n")[0]


def test_two_writers_never_mix(server: Any) -> None:
    content = os.urandom(400_000)
    with server.client() as client:
        path = begin(
            client, len(content), **{"Upload-Metadata": f"sha256 {b64(sha256(content).encode())}"}
        )
    seen: list[int] = []

    def write() -> None:
        with server.client() as client:
            while True:
                head = client.head(path, headers=TUS)
                there = int(head.headers["Upload-Offset"])
                if there == len(content):
                    return
                pieces = (content[i : i + 5000] for i in range(there, there + 50_000, 5000))
                reply = send(client, path, there, pieces)
                seen.append(reply.status_code)

    writers = [threading.Thread(target=write) for _ in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(timeout=120)
        assert not writer.is_alive()
    assert set(seen) <= {204, 409}
    with server.client() as client:
        assert client.get(path).json()["asset"] == f"sha256:{sha256(content)}"


def test_a_kill_in_the_middle(serve: Any) -> None:
    content = os.urandom(4_000_000)
    meta = {"Upload-Metadata": f"sha256 {b64(sha256(content).encode())}"}
    server = serve()
    with server.client() as client:
        path = begin(client, len(content), **meta)
    sent, kills = 0, 0
    for kept in (300_000, 1_700_000, 2_900_000):
        with connect(server, path, len(content) - sent, sent) as connection:
            connection.sendall(content[sent:kept])
            with server.client() as client:
                wait_for_bytes(client, path, kept - 200_000)
            server.kill_all()
            kills += 1
        server = serve()
        with server.client() as client:
            sent = offset_of(client, path)
        assert kept - 200_000 <= sent <= kept
    with server.client() as client:
        reply = send(client, path, sent, content[sent:])
        assert reply.headers["Raykiln-Asset"] == f"sha256:{sha256(content)}"
    assert kills == 3
    assert files_under_way(server) == []


def test_a_kill_between_the_last_byte_and_the_asset(serve: Any) -> None:
    content = os.urandom(10_000)
    server = serve()
    with server.client() as client:
        path = begin(client, len(content))
    server.kill_all()
    # All has arrived, and nothing was made of it.
    (server.data_dir / "uploads" / path.rsplit("/", 1)[1]).write_bytes(content)
    server = serve()
    with server.client() as client:
        head = client.head(path, headers=TUS)
        assert head.headers["Upload-Offset"] == "10000"
        assert head.headers["Raykiln-Asset"] == f"sha256:{sha256(content)}"


def test_unfinished_uploads_expire(serve: Any) -> None:
    server = serve(upload_expiry_s=1.0)
    with server.client() as client:
        path = begin(client, 10)
        time.sleep(1.1)
        problem(send(client, path, 0, b"x"), 410)
        begin(client, 10)
        problem(client.get(path), 404)
        assert len(files_under_way(server)) == 1
    server.kill_all()
    time.sleep(1.1)
    server = serve(upload_expiry_s=1.0)
    assert files_under_way(server) == []


def test_what_is_missing(client: httpx.Client) -> None:
    there = client.post("/v1/assets", content=b"here").json()["id"]
    nowhere = [f"sha256:{i:064x}" for i in range(1500)]
    reply = client.post("/v1/assets/missing", json={"ids": [*nowhere, there, nowhere[0]]})
    assert reply.json() == {"missing": nowhere}
    bare = client.post("/v1/assets/missing", json={"ids": [there.removeprefix("sha256:")]})
    assert bare.json() == {"missing": []}
    assert (
        problem(client.post("/v1/assets/missing", json={"ids": ["x"]}), 422)["pointer"] == "/ids/0"
    )
    assert problem(client.post("/v1/assets/missing", json={}), 422)["pointer"] == "/ids"
    problem(client.post("/v1/assets/missing", content=b"{"), 400)


def test_a_client_of_others_making(server: Any) -> None:
    tus = pytest.importorskip("tusclient.client", reason="tuspy is not installed")
    content = os.urandom(100_000)
    uploader = tus.TusClient(f"{server.url}/v1/uploads").uploader(
        file_stream=io.BytesIO(content),
        chunk_size=30_000,
        metadata={"filename": "scene.glb"},
        upload_checksum=True,
    )
    uploader.upload_chunk()
    assert uploader.offset == 30_000
    uploader.upload()
    with server.client() as client:
        assert client.get(f"/v1/assets/sha256:{sha256(content)}").status_code == 200


# The client.


class Cutter:
    """Passes connections on to a service, and cuts each off after so many bytes to it."""

    def __init__(self, server: Any, after: int) -> None:
        host, port = server.url.removeprefix("http://").split(":")
        self._target = (host, int(port))
        self._after = after
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.passed = 0
        self.cuts = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        # Wakes the thread that accepts, which a mere close would leave waiting.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _address = self._listener.accept()
                far = socket.create_connection(self._target)
                for source, sink, limit in ((near, far, self._after), (far, near, 1 << 60)):
                    threading.Thread(
                        target=self._pump, args=(source, sink, limit), daemon=True
                    ).start()

    def _pump(self, source: socket.socket, sink: socket.socket, left: int) -> None:
        with contextlib.suppress(OSError), source, sink:
            while data := source.recv(min(65536, max(left, 1))):
                left -= len(data)
                if left < 0:
                    self.cuts += 1
                    # Both ends: the other thread holds them open too.
                    source.shutdown(socket.SHUT_RDWR)
                    sink.shutdown(socket.SHUT_RDWR)
                    return
                sink.sendall(data)
                if left < 1 << 50:
                    self.passed += len(data)


@pytest.mark.parametrize("kind", ["blocking", "asynchronous"])
def test_the_client_goes_on_through_cuts_and_sends_nothing_twice(
    server: Any, tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "scene.glb"
    path.write_bytes(os.urandom(5_000_000))

    def upload(url: str) -> Any:
        if kind == "blocking":
            with Client(url) as client:
                return client.upload_asset(path)

        async def run() -> Any:
            async with AsyncClient(url) as client:
                return await client.upload_asset(path)

        return asyncio.run(run())

    cutter = Cutter(server, after=1_500_000)
    try:
        asset = upload(cutter.url)
        assert asset.id == f"sha256:{sha256(path.read_bytes())}"
        assert asset.size_bytes == 5_000_000
        assert cutter.cuts >= 3
        # But for what a busy service had in its buffers when the connection was cut.
        assert cutter.passed < 6_000_000
        before = cutter.passed
        assert upload(cutter.url) == asset
        assert cutter.passed - before < 10_000
    finally:
        cutter.close()


def test_a_client_takes_up_what_an_earlier_one_left(server: Any, tmp_path: Path) -> None:
    content = os.urandom(3_000_000)
    path = tmp_path / "left.glb"
    path.write_bytes(content)
    values = {"filename": b"left.glb", "sha256": sha256(content).encode()}
    meta = ",".join(f"{name} {b64(value)}" for name, value in values.items())
    with server.client() as client:
        place = begin(client, len(content), **{"Upload-Metadata": meta})
        assert send(client, place, 0, content[:2_900_000]).status_code == 204
    cutter = Cutter(server, after=1_000_000)
    try:
        with Client(cutter.url) as client:
            assert client.upload_asset(path).id == f"sha256:{sha256(content)}"
        assert (cutter.cuts, cutter.passed < 200_000) == (0, True)
    finally:
        cutter.close()
