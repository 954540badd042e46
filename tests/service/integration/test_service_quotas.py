"""What a token may use: jobs, samples, bytes and requests."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from raykiln_service.access import Caller, Limits, Scope
from raykiln_service.errors import QuotaError
from raykiln_service.jobs import JobSpec
from raykiln_service.quotas import RateLimiter
from raykiln_service.store import Store
from raykiln_service.tokens import TokenStore, new_text

QUICK = {"width": 16, "height": 16, "spp": 1}


@pytest.fixture(scope="module")
def guarded(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service that asks for tokens."""
    folder = tmp_path_factory.mktemp("limited")
    admin = create(folder, "boss", "--scope", "admin")
    server = module_serve(data_dir=str(folder), require_token=True)
    server.headers["Authorization"] = f"Bearer {admin}"
    return server


def create(folder: Path, name: str, *options: str) -> str:
    """A new token."""
    return subprocess.run(
        [sys.executable, "-m", "raykiln_service.cli", "token", "create", "--name", name, *options],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        env={**os.environ, "RAYKILN_DATA_DIR": str(folder)},
    ).stdout.strip()


def limited(server: Any, name: str, *options: str) -> httpx.Client:
    """A client with a new token of these limits."""
    headers = {"Authorization": f"Bearer {create(server.data_dir, name, *options)}"}
    return httpx.Client(base_url=server.url, headers=headers, timeout=60)


def refused(reply: httpx.Response, limit: str) -> None:
    assert reply.status_code == 429, reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    assert int(reply.headers["Retry-After"]) >= 1
    document = reply.json()
    assert document["type"] == "urn:raykiln:problem:quota-exceeded"
    assert document["limit"] == limit
    assert document["accepted"]


def test_a_limit_of_jobs(guarded: Any, ball: dict[str, Any]) -> None:
    endless = {"width": 256, "height": 256, "spp": 1 << 20}
    body = {"scene": {"inline": ball}, "settings": endless}
    with limited(guarded, "few", "--max-jobs", "2") as client:
        ids = [client.post("/v1/jobs", json=body).json()["id"] for _ in range(2)]
        refused(client.post("/v1/jobs", json=body), "queued_jobs")
        client.post(f"/v1/jobs/{ids[1]}/cancel")
        last = client.post("/v1/jobs", json=body)
        assert last.status_code == 202
        for job_id in (last.json()["id"], ids[0]):
            client.post(f"/v1/jobs/{job_id}/cancel")
            guarded.wait_for_end(job_id)
    folders = {path.name for path in (guarded.data_dir / "jobs").iterdir()}
    with guarded.client() as boss:
        assert folders == {job["id"] for job in boss.get("/v1/jobs?limit=200").json()["items"]}


def test_a_limit_of_samples(guarded: Any) -> None:
    seeds = iter(range(1000, 2000))

    def body(spp: int) -> dict[str, Any]:
        # Each job is another one: an answer from the cache costs nothing.
        settings = {**QUICK, "spp": spp, "seed": next(seeds)}
        return {"scene": {"name": "cornell_box"}, "settings": settings}

    options = ("--max-samples", "2560", "--max-samples-per-day", "5120")
    with limited(guarded, "little", *options) as client:
        refused(client.post("/v1/jobs", json=body(11)), "queued_samples")
        for _ in range(2):
            job = client.post("/v1/jobs", json=body(10), headers={"Prefer": "wait=60"}).json()
            assert job["state"] == "succeeded"
            # Deleting gives nothing back.
            assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
        reply = client.post("/v1/jobs", json=body(1))
        refused(reply, "samples_per_day")
        assert 3600 < int(reply.headers["Retry-After"]) <= 86_400


def test_a_limit_of_bytes(guarded: Any) -> None:
    with limited(guarded, "small", "--max-bytes", "1000") as client:
        first = client.post("/v1/assets", content=b"a" * 600)
        assert first.status_code == 201
        assert client.post("/v1/assets", content=b"a" * 600).status_code == 201
        other = b"b" * 600
        refused(client.post("/v1/assets", content=other), "stored_bytes")
        refused(client.post("/v1/assets", content=(other for _ in range(1))), "stored_bytes")
        assert client.post("/v1/assets", content=b"c" * 400).status_code == 201
    kept = sum(path.is_file() for path in (guarded.data_dir / "assets").rglob("*"))
    with sqlite3.connect(f"file:{guarded.data_dir}/raykiln.db?mode=ro", uri=True) as database:
        assert database.execute("SELECT count(*) FROM assets").fetchone()[0] == kept


def test_a_limit_of_requests(guarded: Any) -> None:
    # So few that no further one comes back while the test asks.
    with limited(guarded, "hasty", "--max-requests-per-minute", "1") as client:
        replies = [client.get("/v1/version") for _ in range(3)]
        assert [reply.status_code for reply in replies] == [200, 429, 429]
        refused(replies[-1], "requests_per_minute")


def test_requests_come_back_evenly() -> None:
    rates = RateLimiter()
    caller = Caller("t", "t", frozenset({Scope.READ}), Limits(requests_per_minute=60))

    def allowed(now_s: float) -> bool:
        try:
            rates.check(caller, now_s)
        except QuotaError:
            return False
        return True

    assert [allowed(0.0) for _ in range(8)] == [True] * 6 + [False] * 2
    assert not allowed(0.9)
    assert allowed(1.1)
    assert not allowed(1.2)
    assert sum(allowed(1000.0) for _ in range(20)) == 6


def test_a_token_in_any_database(store: Store, clock: Any) -> None:
    tokens = TokenStore(store.database, Limits(queued_jobs=7), clock=clock)
    token, text = tokens.create("a", [Scope.READ], limits=Limits(stored_bytes=5), lifetime_ms=1000)
    found = tokens.find(text)
    assert found is not None
    assert found == tokens.recall(text)
    assert found.owner == token.id
    assert found.scopes == frozenset({Scope.READ})
    assert (found.limits.queued_jobs, found.limits.stored_bytes) == (7, 5)
    assert tokens.all()[0].last_used_ms == clock.ms
    assert tokens.find(new_text()) is None
    clock.ms += 1000
    assert tokens.find(text) is None
    assert tokens.recall(text) is None
    assert not tokens.any_active()


def test_limits_hold_in_any_database(store: Store, clock: Any) -> None:
    tokens = TokenStore(store.database, clock=clock)
    limits = Limits(queued_jobs=2, samples_per_day=100, stored_bytes=10)
    _token, text = tokens.create("a", [Scope.SUBMIT], limits=limits)
    caller = tokens.find(text)
    assert caller is not None
    spec = JobSpec({"name": "cornell_box"}, {})

    def limit_met(job_id: str, samples: int) -> str | None:
        try:
            store.create_job(job_id, spec, caller=caller, pixel_samples=samples)
        except QuotaError as error:
            return error.limit
        return None

    assert [limit_met("a", 40), limit_met("b", 40), limit_met("c", 1)] == [
        None,
        None,
        "queued_jobs",
    ]
    store.cancel("a")
    assert limit_met("c", 30) == "samples_per_day"
    clock.ms += 24 * 3_600_000
    assert limit_met("c", 30) is None
    store.add_asset("sha256:" + "0" * 64, 10, None, caller)
    with pytest.raises(QuotaError):
        store.add_asset("sha256:" + "1" * 64, 1, None, caller)
    assert store.missing_assets(["sha256:" + "0" * 64, "sha256:" + "1" * 64], caller) == [
        "sha256:" + "1" * 64
    ]
