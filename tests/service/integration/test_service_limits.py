"""Who may ask, how much, how slowly; and starts that must be refused."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

ENDLESS = {"width": 256, "height": 256, "spp": 1 << 20}


@pytest.fixture(scope="module")
def small(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service with small limits and a token."""
    return module_serve(
        data_dir=str(tmp_path_factory.mktemp("small")),
        token="open sesame",
        max_json_bytes=20_000,
        max_asset_bytes=50_000,
        max_bundle_entries=3,
        max_queued=1,
    )


@pytest.fixture(scope="module")
def hasty(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service with little patience, and a token."""
    folder = str(tmp_path_factory.mktemp("hasty"))
    return module_serve(data_dir=folder, token="open sesame", request_timeout_s=2.0)


def test_no_call_without_the_token(small: Any) -> None:
    for header in (None, "Bearer wrong", "Basic open sesame", "Bearer", "Bearer sésame"):
        headers = [] if header is None else [(b"Authorization", header.encode())]
        reply = httpx.get(f"{small.url}/v1/jobs", headers=headers, timeout=60)
        assert reply.status_code == 401
        assert reply.headers["WWW-Authenticate"].startswith("Bearer")
        assert reply.headers["Content-Type"] == "application/problem+json"
    assert httpx.get(f"{small.url}/metrics", timeout=60).status_code == 401
    for path in ("/healthz", "/readyz", "/", "/web/main.js", "/docs"):
        assert httpx.get(f"{small.url}{path}", timeout=60).status_code == 200
    assert httpx.get(f"{small.url}/v1/jobs", headers=small.headers, timeout=60).status_code == 200
    assert "sesame" not in small.log.read_text()


def test_too_much(small: Any, ball: dict[str, Any]) -> None:
    with small.client() as client:
        sized = client.post("/v1/jobs", content=b" " * 20_001)
        streamed = client.post("/v1/jobs", content=(b" " * 1000 for _ in range(30)))
        asset = client.post("/v1/assets", content=(b"x" * 1000 for _ in range(60)))
        for reply in (sized, streamed, asset):
            assert reply.status_code == 413, reply.text
            assert reply.headers["Content-Type"] == "application/problem+json"
        assert client.post("/v1/assets", content=b"x" * 50_000).status_code == 201


def test_too_slow(hasty: Any) -> None:
    host, port = hasty.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        connection.sendall(
            b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n"
            b"Authorization: Bearer open sesame\r\n\r\n{"
        )
        reply = b""
        while piece := connection.recv(4096):
            reply += piece
    assert reply.startswith(b"HTTP/1.1 408")
    assert b"request-timeout" in reply


def talk(hasty: Any, *pieces: bytes) -> bytes:
    """Send pieces with a pause between them; what comes back until the service hangs up."""
    host, port = hasty.url.removeprefix("http://").split(":")
    reply = b""
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        for piece in pieces:
            with contextlib.suppress(OSError):
                connection.sendall(piece)
            time.sleep(0.4)
        with contextlib.suppress(ConnectionResetError):
            while piece := connection.recv(4096):
                reply += piece
    return reply


def test_a_head_that_never_ends_is_hung_up_on(hasty: Any) -> None:
    assert talk(hasty) == b""
    assert talk(hasty, b"GET /healthz HTTP/1.1\r\n", *[b"X-A: b\r\n"] * 8) == b""
    again = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
    assert talk(hasty, again, again, b"GET /heal").count(b"HTTP/1.1 200") == 2


def test_a_body_that_trickles_is_refused(hasty: Any) -> None:
    head = (
        b"POST /v1/assets HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n"
        b"Authorization: Bearer open sesame\r\n\r\n"
    )
    assert talk(hasty, head, *[b"x"] * 8).startswith(b"HTTP/1.1 408")
    assert list((hasty.data_dir / "tmp").iterdir()) == []


def test_a_full_queue(small: Any, ball: dict[str, Any]) -> None:
    body = {"scene": {"inline": ball}, "settings": ENDLESS}
    with small.client() as client:
        running = small.submit(**body)
        small.wait_for(running["id"], lambda view: view["state"] == "running")
        waiting = small.submit(**body)
        refused = client.post("/v1/jobs", json=body)
        assert (refused.status_code, refused.json()["title"]) == (429, "The queue is full")
        assert int(refused.headers["Retry-After"]) > 0
        for job in (waiting, running):
            client.post(f"/v1/jobs/{job['id']}/cancel")
            small.wait_for_end(job["id"])


def test_a_service_without_a_token_keeps_foreign_pages_out(server: Any) -> None:
    port = server.url.rsplit(":", 1)[1]
    with server.client() as client:
        rebound = client.get("/v1/jobs", headers={"Host": f"evil.example:{port}"})
        foreign = client.post("/v1/jobs", json={}, headers={"Origin": "https://evil.example"})
        own = client.get("/v1/jobs", headers={"Origin": server.url})
        named = client.get("/v1/jobs", headers={"Host": f"localhost:{port}"})
    assert [r.status_code for r in (rebound, foreign, own, named)] == [403, 403, 200, 200]


# Starts that must be refused: one line, and the reason.


def start(**settings: Any) -> str:
    code = (
        "import json, sys; from raykiln_service.app import serve; "
        "from raykiln_service.errors import ServiceError; "
        "from raykiln_service.settings import ServiceSettings\n"
        "try: serve(ServiceSettings.create(**json.loads(sys.argv[1])))\n"
        "except ServiceError as error: print('refused:', error)"
    )
    found = subprocess.run(
        [sys.executable, "-c", code, json.dumps(settings)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "Traceback" not in found.stderr
    return found.stdout


def test_a_second_service_on_the_same_data(server: Any) -> None:
    said = start(data_dir=str(server.data_dir), port=0)
    assert "in use by another service" in said
    assert str(server.process.pid) in said


def test_a_used_port(server: Any, tmp_path: Path) -> None:
    port = int(server.url.rsplit(":", 1)[1])
    said = start(data_dir=str(tmp_path / "data"), port=port)
    assert f"port {port} of 127.0.0.1 is in use" in said
    assert not (tmp_path / "data").exists()


def test_a_public_address_without_a_token(tmp_path: Path) -> None:
    assert "token is required" in start(data_dir=str(tmp_path / "d"), host="0.0.0.0", port=0)


def test_a_data_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("")
    assert "data folder" in start(data_dir=str(tmp_path / "data"), port=0)


def test_an_unknown_host(tmp_path: Path) -> None:
    assert "not usable" in start(data_dir=str(tmp_path / "d"), host="256.0.0.1", port=0, token="t")


def test_a_damaged_database(tmp_path: Path) -> None:
    (tmp_path / "raykiln.db").write_text("no database " * 1000)
    assert "not a database" in start(data_dir=str(tmp_path), port=0)
