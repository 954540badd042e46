"""Who may do what: tokens made beside the running service, their scopes, owners and limits."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from raykiln_service.beside import open_database
from raykiln_service.tokens import TokenStore, is_well_formed, new_text

QUICK = {"width": 16, "height": 16, "spp": 1}


def token_command(folder: Path, *arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run `raykiln token` on a data folder."""
    done = subprocess.run(
        [sys.executable, "-m", "raykiln_service.cli", "token", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "RAYKILN_DATA_DIR": str(folder)},
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done


def create(folder: Path, name: str, *options: str) -> str:
    """A new token."""
    return token_command(folder, "create", "--name", name, *options).stdout.strip()


@pytest.fixture(scope="module")
def guarded(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service that asks for tokens; the first one was made before it started."""
    folder = tmp_path_factory.mktemp("guarded")
    admin = create(folder, "boss", "--scope", "admin")
    server = module_serve(data_dir=str(folder), require_token=True)
    server.headers["Authorization"] = f"Bearer {admin}"
    return server


@pytest.fixture(scope="module")
def made(guarded: Any) -> dict[str, str]:
    """Tokens by name, made while the service runs."""
    scopes = {
        "reader": ["read"],
        "sender": ["submit"],
        "alice": ["read", "submit", "manage"],
        "bob": ["read,submit,manage"],
    }
    return {
        name: create(guarded.data_dir, name, *(a for s in some for a in ("--scope", s)))
        for name, some in scopes.items()
    }


def client_of(server: Any, token: str) -> httpx.Client:
    headers = {"Authorization": f"Bearer {token}"}
    return httpx.Client(base_url=server.url, headers=headers, timeout=60)


@pytest.fixture
def alice(guarded: Any, made: dict[str, str]) -> Iterator[httpx.Client]:
    with client_of(guarded, made["alice"]) as client:
        yield client


@pytest.fixture
def bob(guarded: Any, made: dict[str, str]) -> Iterator[httpx.Client]:
    with client_of(guarded, made["bob"]) as client:
        yield client


# Tokens.


def test_a_token_carries_a_checksum() -> None:
    text = new_text()
    assert is_well_formed(text)
    assert len({new_text() for _ in range(100)}) == 100
    for place in range(3, len(text)):
        other = "a" if text[place] != "a" else "b"
        assert not is_well_formed(text[:place] + other + text[place + 1 :])
    for wrong in ("", "rk_", text[:-1], text + "a", text.upper(), f" {text}", "é" * 45):
        assert not is_well_formed(wrong)


def test_nothing_without_a_token(guarded: Any) -> None:
    for path in ("/v1/jobs", "/metrics", "/v1/nothing", "/v1/events"):
        reply = httpx.get(f"{guarded.url}{path}", timeout=60)
        assert reply.status_code == 401
        assert reply.headers["WWW-Authenticate"] == 'Bearer realm="raykiln"'
        assert reply.headers["Content-Type"] == "application/problem+json"
    for path in ("/healthz", "/readyz", "/", "/docs", "/openapi.json"):
        assert httpx.get(f"{guarded.url}{path}", timeout=60).status_code == 200


@pytest.mark.parametrize(
    "header",
    [
        "Bearer",
        "Bearer x",
        "Basic eDp5",
        pytest.param(f"Bearer {new_text()}", id="a good one, but of nobody"),
        pytest.param("Bearer " + "x" * 9000, id="a long one"),
    ],
)
def test_a_token_that_nobody_has(guarded: Any, header: str) -> None:
    reply = httpx.get(f"{guarded.url}/v1/jobs", headers={"Authorization": header}, timeout=60)
    assert reply.status_code == 401
    assert 'error="invalid_token"' in reply.headers["WWW-Authenticate"]
    assert len(header) < 20 or header.split()[-1] not in reply.text


def test_only_the_hash_is_kept(guarded: Any, made: dict[str, str]) -> None:
    with sqlite3.connect(f"file:{guarded.data_dir}/raykiln.db?mode=ro", uri=True) as database:
        dump = json.dumps(database.execute("SELECT * FROM tokens").fetchall())
    assert "alice" in dump
    for text in made.values():
        assert text not in dump
        for path in guarded.data_dir.rglob("*"):
            assert not path.is_file() or text.encode() not in path.read_bytes(), path


def test_a_revoked_token_is_refused_while_the_service_runs(guarded: Any) -> None:
    text = create(guarded.data_dir, "short")
    with client_of(guarded, text) as client:
        assert client.get("/v1/jobs").status_code == 200
        token_command(guarded.data_dir, "revoke", "short")
        time.sleep(1.2)
        assert client.get("/v1/jobs").status_code == 401
    row = listed(guarded)["short"]
    assert row["state"] == "revoked"
    assert row["last_used"] is not None
    token_command(guarded.data_dir, "revoke", "short", code=2)
    assert create(guarded.data_dir, "short") != text


@pytest.mark.parametrize("path", ["/v1/events", "/v1/jobs/{}/events"])
def test_what_a_revoked_token_reads_ends(
    guarded: Any, alice: httpx.Client, ball: dict[str, Any], path: str
) -> None:
    """The streams of other tokens go on; who has lost a stream is let in nowhere else."""
    admin = create(guarded.data_dir, "watcher", "--scope", "admin")
    endless = {"width": 256, "height": 256, "spp": 1 << 20, "threads": 1}
    body = {"scene": {"inline": ball}, "settings": endless}
    job = alice.post("/v1/jobs", json=body).raise_for_status().json()
    address = path.format(job["id"])
    with (
        client_of(guarded, admin) as watcher,
        watcher.stream("GET", address) as read,
        alice.stream("GET", address) as other,
    ):
        lines, other_lines = read.iter_lines(), other.iter_lines()
        assert next(lines) == next(other_lines) == "retry: 1000"
        assert watcher.get("/v1/jobs").status_code == 200
        # Not by the command, whose start takes as long as the service remembers a token.
        with open_database(guarded.data_dir, None) as database:
            TokenStore(database).revoke("watcher")
        # The job goes on, so nothing but the token can be the end of it.
        assert all("cancelled" not in line for line in lines)
        assert watcher.get("/v1/jobs").status_code == 401
        alice.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()
        assert any('"cancelled"' in line for line in other_lines)


def test_an_expired_token_is_refused(guarded: Any) -> None:
    text = create(guarded.data_dir, "brief", "--expires", "1s")
    time.sleep(1.1)
    with client_of(guarded, text) as client:
        assert client.get("/v1/jobs").status_code == 401
    assert listed(guarded)["brief"]["state"] == "expired"


def listed(server: Any) -> dict[str, Any]:
    rows = json.loads(token_command(server.data_dir, "list", "--json").stdout)
    return {row["name"]: row for row in rows}


@pytest.mark.parametrize(
    "arguments",
    [
        ["create", "--name", "boss"],
        ["create", "--name", ""],
        ["create", "--name", "a\nb"],
        ["create", "--name", "x", "--scope", "root"],
        ["create", "--name", "x", "--expires", "soon"],
        ["create", "--name", "x", "--expires", "0d"],
        ["create", "--name", "x", "--max-jobs", "-1"],
        ["revoke", "nobody"],
    ],
)
def test_what_the_command_refuses(guarded: Any, arguments: list[str]) -> None:
    done = token_command(guarded.data_dir, *arguments, code=2)
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1


def test_many_commands_beside_a_busy_service(guarded: Any, alice: httpx.Client) -> None:
    command = [sys.executable, "-m", "raykiln_service.cli", "token", "create", "--name"]
    env = {**os.environ, "RAYKILN_DATA_DIR": str(guarded.data_dir)}
    running = [subprocess.Popen([*command, f"many-{i}"], env=env, stdout=-3) for i in range(4)]
    while any(process.poll() is None for process in running):
        reply = alice.post("/v1/jobs", json={"scene": {"name": "cornell_box"}, "settings": QUICK})
        assert reply.status_code == 202, reply.text
        assert guarded.wait_for_end(reply.json()["id"])["state"] == "succeeded"
    assert {process.returncode for process in running} == {0}
    with sqlite3.connect(f"file:{guarded.data_dir}/raykiln.db?mode=ro", uri=True) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


# Scopes and owners.


def test_scopes(guarded: Any, made: dict[str, str]) -> None:
    body = {"scene": {"name": "cornell_box"}, "settings": QUICK}
    with client_of(guarded, made["reader"]) as reader, client_of(guarded, made["sender"]) as sender:
        assert reader.get("/v1/jobs").status_code == 200
        refused = reader.post("/v1/jobs", json=body)
        assert (refused.status_code, refused.json()["accepted"]) == (403, "submit")
        assert refused.json()["type"] == "urn:raykiln:problem:insufficient-scope"
        assert 'error="insufficient_scope", scope="submit"' in refused.headers["WWW-Authenticate"]
        assert reader.post("/v1/assets", content=b"x").status_code == 403
        assert reader.post("/v1/assets/missing", json={"ids": []}).status_code == 200
        sent = sender.post("/v1/jobs", json=body)
        assert sent.status_code == 202
        place = sent.headers["Location"]
        assert sender.get("/v1/jobs").status_code == 403
        assert sender.get(place).status_code == 403
        assert sender.delete(place).status_code == 403
        assert sender.post(f"{place}/cancel").status_code == 403
    guarded.wait_for_end(sent.json()["id"])


def test_what_only_an_admin_may(guarded: Any, alice: httpx.Client) -> None:
    assert alice.post("/v1/queue/pause").status_code == 403
    with guarded.client() as boss:
        assert boss.post("/v1/queue/pause").status_code == 200
        assert boss.post("/v1/queue/resume").status_code == 200


def test_a_job_of_somebody_else_does_not_exist(
    guarded: Any, alice: httpx.Client, bob: httpx.Client, ball: dict[str, Any]
) -> None:
    body = {"scene": {"inline": ball}, "settings": QUICK, "labels": {"secret": "plans"}}
    job = alice.post("/v1/jobs", json=body, headers={"Prefer": "wait=60"}).json()
    assert job["state"] == "succeeded"
    place = f"/v1/jobs/{job['id']}"
    unknown = "/v1/jobs/job-00000000000-0000000000"
    for method, path in (
        ("GET", ""),
        ("GET", "/events"),
        ("GET", "/preview.png"),
        ("GET", "/outputs"),
        ("GET", "/outputs/image.exr"),
        ("GET", "/outputs/log.txt"),
        ("POST", "/cancel"),
        ("POST", "/retry"),
        ("DELETE", ""),
    ):
        reply = bob.request(method, place + path)
        nothing = bob.request(method, unknown + path)
        assert (reply.status_code, nothing.status_code) == (404, 404), path
        said = reply.text.replace(job["id"], "ID")
        assert said == nothing.text.replace("job-00000000000-0000000000", "ID")
    listings = [
        client.get("/v1/jobs", params={"label": "secret"}).json() for client in (alice, bob)
    ]
    assert [len(listing["items"]) for listing in listings] == [1, 0]
    with guarded.client() as boss:
        assert boss.get(place).status_code == 200
        assert boss.get("/v1/jobs", params={"label": "secret"}).json()["items"]
    assert alice.delete(place).status_code == 204


def test_the_stream_of_all_jobs_tells_of_ones_own_only(
    guarded: Any, alice: httpx.Client, bob: httpx.Client
) -> None:
    body = {"scene": {"name": "cornell_box"}, "settings": QUICK}
    with bob.stream("GET", "/v1/events") as stream:
        lines = stream.iter_lines()
        next(lines)
        hers = alice.post("/v1/jobs", json=body, headers={"Prefer": "wait=60"}).json()["id"]
        his = bob.post("/v1/jobs", json=body).json()["id"]
        heard = ""
        for line in lines:
            heard += line
            if his in line and "succeeded" in line:
                break
    assert his in heard
    assert hers not in heard


def test_an_upload_of_somebody_else_does_not_exist(
    alice: httpx.Client, bob: httpx.Client, ball: dict[str, Any]
) -> None:
    content = json.dumps({**ball, "name": "a secret"}).encode()
    asset = alice.post("/v1/assets", content=content, params={"filename": "s.json"}).json()["id"]
    body = {"scene": {"asset": asset}, "settings": QUICK}
    assert bob.get(f"/v1/assets/{asset}").status_code == 404
    assert bob.post("/v1/assets/missing", json={"ids": [asset]}).json() == {"missing": [asset]}
    assert bob.post("/v1/jobs", json=body).json()["pointer"] == "/scene/asset"
    # Who has the bytes may have them.
    again = bob.post("/v1/assets", content=content, params={"filename": "s.json"})
    assert again.json()["id"] == asset
    assert bob.get(f"/v1/assets/{asset}").status_code == 200
    assert bob.post("/v1/assets/missing", json={"ids": [asset]}).json() == {"missing": []}
    assert bob.post("/v1/jobs", json=body).status_code == 202


def test_an_idempotency_key_belongs_to_its_token(alice: httpx.Client, bob: httpx.Client) -> None:
    headers = {"Idempotency-Key": "one"}
    body = {"scene": {"name": "cornell_box"}, "settings": QUICK}
    first = alice.post("/v1/jobs", json=body, headers=headers)
    other = bob.post("/v1/jobs", json={**body, "priority": 1}, headers=headers)
    again = alice.post("/v1/jobs", json=body, headers=headers)
    assert [r.status_code for r in (first, other, again)] == [202, 202, 202]
    assert again.json()["id"] == first.json()["id"] != other.json()["id"]
    assert again.headers["Idempotent-Replayed"] == "true"


# Where a token is asked for.


def test_a_loopback_service_asks_for_none_but_checks_what_comes(server: Any) -> None:
    text = create(server.data_dir, "me", "--scope", "read")
    assert httpx.get(f"{server.url}/v1/jobs", timeout=60).status_code == 200
    with client_of(server, text) as client:
        assert client.get("/v1/jobs").status_code == 200
        assert client.post("/v1/jobs", json={}).status_code == 403
    with client_of(server, new_text()) as client:
        assert client.get("/v1/jobs").status_code == 401


def test_a_token_is_enough_to_listen_for_others(serve: Any, tmp_path: Path) -> None:
    text = create(tmp_path / "data", "first")
    server = serve(host="0.0.0.0")
    url = server.url.replace("0.0.0.0", "127.0.0.1")
    assert httpx.get(f"{url}/v1/jobs", timeout=60).status_code == 401
    own = httpx.get(f"{url}/v1/jobs", headers={"Authorization": f"Bearer {text}"}, timeout=60)
    assert own.status_code == 200


# Secrets.


def test_the_log_shows_no_secret(guarded: Any, made: dict[str, str]) -> None:
    for text in made.values():
        with client_of(guarded, text) as client:
            client.get(f"/v1/jobs?token={text}&access_token={text}")
            client.get(f"/v1/jobs/{text}")
            client.post("/v1/jobs", content=text.encode())
            client.post("/v1/jobs", json={"scene": {"name": text}})
            client.post("/v1/assets", content=b"x", params={"filename": f"{text}/"})
    log = guarded.log.read_text()
    for text in made.values():
        assert text not in log
