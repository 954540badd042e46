"""The API as it describes itself: Schemathesis reads the description and tries what it allows."""

from __future__ import annotations

import json
import sqlite3
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

schemathesis = pytest.importorskip("schemathesis", reason="schemathesis is not installed")

from hypothesis import HealthCheck, Phase, seed, settings  # noqa: E402
from hypothesis.errors import FlakyStrategyDefinition  # noqa: E402
from schemathesis.checks import CHECKS, load_all_checks  # noqa: E402

TOKEN = "a token for the tests"
# These streams do not end by themselves.
ENDLESS = r"/events$"
# A valid request may name a scene that does not exist, and a job that waits has no image yet.
SEMANTIC = {"positive_data_acceptance", "ensure_resource_availability"}
# A null or a number in a list is wrong by the schema, and text like any other in a URL.
QUERIES_WITH_LISTS = {"GET /v1/jobs", "GET /v1/jobs/{job_id}/frames"}

load_all_checks()


@schemathesis.serializer("application/offset+octet-stream")  # type: ignore[untyped-decorator,unused-ignore]
def _bytes(_context: Any, value: Any) -> Any:
    return value if isinstance(value, bytes) else str(value).encode()


@pytest.fixture(scope="module")
def guarded(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service with a token, and without the patience for the large images that are made up."""
    folder = str(tmp_path_factory.mktemp("api"))
    return module_serve(data_dir=folder, token=TOKEN, max_job_s=0.5, warm_scenes=0)


def schema_of(server: Any) -> Any:
    found = schemathesis.openapi.from_url(f"{server.url}/openapi.json", headers=server.headers)
    return found.exclude(path_regex=ENDLESS)


@dataclass
class Tally:
    """What runs have done: the answers by operation and status, and the errors of the service."""

    answers: Counter[tuple[str, int]] = field(default_factory=Counter)
    errors: list[Exception] = field(default_factory=list)

    @property
    def calls(self) -> int:
        """All calls that were answered."""
        return self.answers.total()

    @property
    def accepted(self) -> set[str]:
        """The operations that were answered with what was asked for."""
        return {operation for operation, status in self.answers if status < 300}

    def check(self) -> None:
        """Raise what was found wrong, all at once."""
        if self.errors:
            raise ExceptionGroup("the service answered wrongly", self.errors)


def machine_of(server: Any, tally: Tally) -> Any:
    """Call after call, each with what the one before answered."""
    not_asked = [CHECKS.get_one(name) for name in sorted(SEMANTIC)]
    lists = [CHECKS.get_one("negative_data_rejection")]
    machine = schema_of(server).as_state_machine()

    class Steps(machine):  # type: ignore[misc,valid-type]
        def get_call_kwargs(self, case: Any) -> dict[str, Any]:
            return {"headers": server.headers, "timeout": 60}

        def step(self, step: Any) -> Any:
            # Hypothesis tries again what has failed; the service need not fail again.
            try:
                return super().step(step)
            except Exception as error:
                tally.errors.append(error)
                raise

        def after_call(self, response: Any, case: Any) -> None:
            super().after_call(response, case)
            tally.answers[case.operation.label, response.status_code] += 1

        def validate_response(self, response: Any, case: Any, **_options: Any) -> None:
            label = case.operation.label
            case.validate_response(
                response,
                excluded_checks=[*not_asked, *(lists if label in QUERIES_WITH_LISTS else ())],
                transport_kwargs={"headers": server.headers},
                recorder=self.recorder,
            )

    return Steps


def run_steps(server: Any, *, runs: int, scenarios: int, steps: int) -> Tally:
    """Runs that know nothing of each other, each from its own seed.

    Hypothesis wants one beginning to go on alike each time.  A service that works while it is
    asked does not: what was queued is done a moment later.  So runs are short, and one where this
    is noticed ends there; what the service did wrong until then counts all the same.
    """
    tally = Tally()
    machine = machine_of(server, tally)
    few = settings(
        max_examples=scenarios,
        stateful_step_count=steps,
        phases=[Phase.generate],
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    for number in range(runs):
        machine.rule_order_seed = number
        try:
            seed(number)(machine).run(settings=few)
        except FlakyStrategyDefinition:
            pass
        except Exception:
            tally.check()
            raise
        tally.check()
    return tally


def is_well(server: Any) -> None:
    """The service still answers, and has not logged an error of its own."""
    assert httpx.get(f"{server.url}/healthz", timeout=60).status_code == 200
    assert '"level": "error"' not in server.log.read_text()


def test_calls_in_a_row(guarded: Any) -> None:
    tally = run_steps(guarded, runs=4, scenarios=4, steps=6)
    assert tally.calls >= 40, tally
    is_well(guarded)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_very_many_calls_in_a_row(guarded: Any) -> None:
    tally = run_steps(guarded, runs=60, scenarios=6, steps=10)
    assert tally.calls >= 1500, tally
    assert len(tally.accepted) >= 12, tally
    is_well(guarded)


def test_every_operation_is_described(guarded: Any) -> None:
    document = httpx.get(f"{guarded.url}/openapi.json", timeout=60).json()
    ids = []
    for path, operations in document["paths"].items():
        for operation in operations.values():
            ids.append(operation["operationId"])
            assert operation.get("summary"), path
            if path.startswith("/v1/"):
                problem = operation["responses"]["4XX"]["content"]["application/problem+json"]
                assert problem["schema"] == {"$ref": "#/components/schemas/Problem"}
                assert operation["security"] == [{"token": []}]
    assert len(ids) == len(set(ids))
    for operations in document["paths"].values():
        for operation in operations.values():
            for response in operation["responses"].values():
                for link in response.get("links", {}).values():
                    assert link["operationId"] in ids
    assert "HTTPValidationError" not in document["components"]["schemas"]


# Problem documents, everywhere.


def problem(reply: httpx.Response, status: int) -> dict[str, Any]:
    assert reply.status_code == status, reply.text
    assert reply.headers["Content-Type"] == "application/problem+json"
    document: dict[str, Any] = reply.json()
    assert document["status"] == status
    assert document["type"].startswith("urn:raykiln:problem:")
    return document


def test_problems_of_every_kind(guarded: Any) -> None:
    with guarded.client() as client:
        problem(client.get("/v1/nothing"), 404)
        problem(client.get("/nothing"), 404)
        wrong_method = client.put("/v1/jobs")
        problem(wrong_method, 405)
        assert wrong_method.headers["Allow"] == "GET, POST"
        assert client.patch("/v1/jobs/x").headers["Allow"] == "DELETE, GET"
        form = client.post("/v1/jobs", data={"scene": "x"})
        assert problem(form, 415)["accepted"] == "application/json"
        unknown = problem(client.get("/v1/jobs", params={"limt": 3}), 422)
        assert unknown["pointer"] == "?limt"
        assert "limit" in unknown["accepted"]
        assert problem(client.get("/v1/jobs?label="), 422)["pointer"] == "?label"
        assert problem(client.get("/v1/jobs?label==x"), 422)["found"] == "=x"
        twice_given = problem(client.get("/v1/jobs?limit=3&limit=4"), 422)
        assert (twice_given["pointer"], twice_given["found"]) == ("?limit", "3, 4")
        assert client.get("/v1/jobs?state=queued&state=running").status_code == 200
        problem(client.get("/v1/version", params={"x": "1"}), 422)
        problem(client.post("/v1/jobs", content=b"{"), 400)
        twice = httpx.Headers([("Authorization", "Bearer a"), ("Authorization", "Bearer b")])
        problem(httpx.get(f"{guarded.url}/v1/jobs", headers=twice, timeout=60), 401)


def test_a_range_that_is_none_is_a_problem(server: Any, ball: dict[str, Any]) -> None:
    job = server.submit(scene={"inline": ball}, settings={"width": 16, "height": 16, "spp": 1})
    server.wait_for_end(job["id"])
    path = f"/v1/jobs/{job['id']}/outputs/image.exr"
    with server.client() as client:
        size = len(client.get(path).content)
        beyond = client.get(path, headers={"Range": f"bytes={size}-"})
        problem(beyond, 416)
        assert beyond.headers["Content-Range"] == f"bytes */{size}"
        problem(client.get(path, headers={"Range": "bytes=b-a"}), 400)
        assert client.get(path, headers={"Range": "bytes=0-3"}).status_code == 206


def test_a_broken_database_is_a_problem_and_no_traceback(serve: Any) -> None:
    server = serve()
    with server.client() as client, sqlite3.connect(server.data_dir / "raykiln.db") as database:
        assert client.get("/v1/jobs").status_code == 200
        database.execute("ALTER TABLE jobs RENAME TO lost")
        database.commit()
        reply = client.get("/v1/jobs/job-1/outputs/x")
        problem(reply, 503)
        assert "SELECT" not in reply.text
        assert client.get("/healthz").status_code == 200


# Idempotency.


QUICK = {"width": 16, "height": 16, "spp": 1}


def test_the_repeat_while_the_first_is_worked_on(server: Any, ball: dict[str, Any]) -> None:
    """Many at once with one key: one job; whoever came too early may ask again."""
    import concurrent.futures

    body = {"scene": {"inline": {**ball, "name": "at once"}}, "settings": QUICK}

    def post(_number: int) -> httpx.Response:
        headers = {"Idempotency-Key": "at once"}
        return httpx.post(f"{server.url}/v1/jobs", json=body, headers=headers, timeout=60)

    with concurrent.futures.ThreadPoolExecutor(12) as pool:
        replies = list(pool.map(post, range(24)))
    made = {reply.json()["id"] for reply in replies if reply.status_code == 202}
    assert len(made) == 1
    for reply in replies:
        if reply.status_code != 202:
            assert problem(reply, 409)["type"] == "urn:raykiln:problem:idempotency-in-flight"
            assert reply.headers["Retry-After"] == "1"
    again = post(0)
    assert (again.status_code, again.json()["id"]) == (202, made.pop())


def wait_for_replies(server: Any, count: int) -> None:
    """Until so many replies are in the database."""
    deadline = time.monotonic() + 60
    query = "SELECT count(*) FROM idempotency WHERE reply IS NOT NULL"
    with closing(sqlite3.connect(f"file:{server.data_dir}/raykiln.db?mode=ro", uri=True)) as there:
        while there.execute(query).fetchone()[0] < count:
            assert time.monotonic() < deadline, "the replies are not written down"
            time.sleep(0.05)


def test_a_repeat_gets_the_reply_of_the_first(serve: Any, ball: dict[str, Any]) -> None:
    """Status, headers and body, whatever the job has become, also after a kill of the service."""
    server = serve()
    body = {"scene": {"inline": ball}, "settings": QUICK, "labels": {"a": "ü"}}

    def post(key: str, **headers: str) -> httpx.Response:
        headers = {"Idempotency-Key": key, **headers}
        with server.client() as client:
            reply: httpx.Response = client.post("/v1/jobs", json=body, headers=headers)
            return reply

    first, waited = post("stored"), post("waited", Prefer="wait=60")
    assert (first.status_code, waited.status_code) == (202, 200)
    job_id = first.json()["id"]
    server.wait_for_end(job_id)
    for _ in range(2):
        for key, given in (("stored", first), ("waited", waited)):
            again = post(key)
            assert (again.status_code, again.content) == (given.status_code, given.content)
            assert again.headers.pop("Idempotent-Replayed") == "true"
            names = {name for name in given.headers if name not in ("date", "traceparent")}
            assert {n: again.headers[n] for n in names} == {n: given.headers[n] for n in names}
        # Replies are written down together, a little later.
        wait_for_replies(server, 2)
        server.kill_all()
        server = serve()
    # To wait is to ask anew.
    assert post("stored", Prefer="wait=60").json()["state"] == "succeeded"
    assert post("stored").content == first.content


def test_a_key_outlives_its_job(server: Any, ball: dict[str, Any]) -> None:
    body = {"scene": {"inline": ball}, "settings": QUICK}
    headers = {"Idempotency-Key": "gone", "Prefer": "wait=60"}
    with server.client() as client:
        job = client.post("/v1/jobs", json=body, headers=headers).json()
        assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
        reply = client.post("/v1/jobs", json=body, headers=headers)
        assert job["id"] in problem(reply, 410)["detail"]


def test_a_refused_request_does_not_use_up_its_key(server: Any, ball: dict[str, Any]) -> None:
    headers = {"Idempotency-Key": "second try"}
    bad = {"scene": {"inline": {**ball, "shapes": []}}, "settings": QUICK}
    with server.client() as client:
        problem(client.post("/v1/jobs", json=bad, headers=headers), 422)
        good = {"scene": {"inline": ball}, "settings": QUICK}
        assert client.post("/v1/jobs", json=good, headers=headers).status_code == 202


# Many at once.


def test_very_many_clients_at_once(server: Any) -> None:
    """Each of a thousand connections gets its answer, and health answers among them."""
    import asyncio

    host, port = server.url.removeprefix("http://").split(":")
    body = json.dumps({"scene": {"name": "cornell_box"}, "settings": QUICK}).encode()
    head = f"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n"
    post = head.encode() + b"Content-Type: application/json\r\nConnection: close\r\n\r\n" + body
    look = b"GET /v1/jobs?limit=1 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    health = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"

    async def call(request: bytes) -> bytes:
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(request)
        reply = await reader.read()
        writer.close()
        return reply.split(b"\r\n")[0]

    async def run() -> list[bytes]:
        requests = [post] * 300 + [look] * 600 + [health] * 100
        return await asyncio.gather(*map(call, requests))

    lines = asyncio.run(run())
    counts = {line: lines.count(line) for line in set(lines)}
    assert counts == {b"HTTP/1.1 202 Accepted": 300, b"HTTP/1.1 200 OK": 700}
    is_well(server)


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
def test_health_passes_the_line(server: Any, path: str) -> None:
    """While hundreds ask for more than can be answered, a probe waits for few of them."""
    import asyncio

    host, port = server.url.removeprefix("http://").split(":")
    answered = 0

    async def call(path: str) -> None:
        reader, writer = await asyncio.open_connection(host, int(port))
        head = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        writer.write(head.encode())
        assert (await reader.read()).startswith(b"HTTP/1.1 200 ")
        writer.close()

    async def ask_on() -> None:
        nonlocal answered
        while not done.is_set():
            await call("/v1/jobs?limit=5")
            answered += 1

    async def run() -> list[int]:
        crowd = [asyncio.create_task(ask_on()) for _ in range(300)]
        waited_for = []
        while answered < 300:
            await asyncio.sleep(0.01)
        for _ in range(9):
            before = answered
            await call(path)
            waited_for.append(answered - before)
        done.set()
        await asyncio.gather(*crowd)
        return waited_for

    done = asyncio.Event()
    waited_for = asyncio.run(run())
    assert sorted(waited_for)[4] < 100, waited_for


def test_a_request_in_pieces_that_waits_in_line(server: Any) -> None:
    """Nothing that comes while a connection waits is lost, nor another request on it."""
    import socket

    host, port = server.url.removeprefix("http://").split(":")
    filler = [socket.create_connection((host, int(port)), timeout=120) for _ in range(100)]
    look = b"GET /v1/jobs?limit=1 HTTP/1.1\r\nHost: localhost\r\n"
    with socket.create_connection((host, int(port)), timeout=120) as connection:
        for other in filler:
            other.sendall(look + b"\r\n")
        body = json.dumps({"ids": ["sha256:" + "0" * 64] * 2000}).encode()
        head = f"POST /v1/assets/missing HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}"
        request = head.encode() + b"\r\nContent-Type: application/json\r\n\r\n" + body
        for start in range(0, len(request), 40_000):
            connection.sendall(request[start : start + 40_000])
        connection.sendall(look + b"Connection: close\r\n\r\n")
        replies = connection.makefile("rb").read()
    assert replies.count(b"HTTP/1.1 200 OK") == 2
    assert b'"missing"' in replies
    for other in filler:
        assert other.recv(15) == b"HTTP/1.1 200 OK"
        other.close()


def test_more_connections_than_allowed(serve: Any) -> None:
    import socket

    server = serve(max_connections=16)
    host, port = server.url.removeprefix("http://").split(":")
    # Connections are taken in the order in which they come.
    open_ones = [socket.create_connection((host, int(port)), timeout=60) for _ in range(16)]
    with socket.create_connection((host, int(port)), timeout=60) as one_more:
        reply = one_more.makefile("rb").read()
    assert reply.startswith(b"HTTP/1.1 503")
    assert b"application/problem+json" in reply
    for connection in open_ones:
        connection.close()
    deadline = time.monotonic() + 60
    while True:
        try:
            if httpx.get(f"{server.url}/healthz", timeout=60).status_code == 200:
                return
        except httpx.TransportError:
            pass
        assert time.monotonic() < deadline
        time.sleep(0.05)


def is_connected(here: int, there: int) -> bool:
    """Whether the end at port `here` of a connection to port `there` has not closed it."""
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, local, remote, state, *_ = line.split()
        if [int(end.split(":")[1], 16) for end in (local, remote)] == [here, there]:
            return state == "01"
    return False


def test_a_client_that_does_not_read_is_hung_up_on(serve: Any, ball: dict[str, Any]) -> None:
    import socket

    server = serve(request_timeout_s=1.0)
    settings = {"width": 1024, "height": 1024, "spp": 1, "aovs": ["albedo", "normal"]}
    job = server.submit(scene={"inline": ball}, settings=settings)
    server.wait_for_end(job["id"])
    host, port = server.url.removeprefix("http://").split(":")
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.settimeout(60)
        connection.connect((host, int(port)))
        for _ in range(40):
            path = f"/v1/jobs/{job['id']}/outputs/image.exr"
            connection.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        deadline = time.monotonic() + 60
        while is_connected(int(port), connection.getsockname()[1]):
            assert time.monotonic() < deadline, "the service waits for ever"
            time.sleep(0.05)
        received = 0
        try:
            while piece := connection.recv(65536):
                received += len(piece)
        except ConnectionResetError:
            pass
    outputs = server.job(job["id"])["outputs"]
    whole = next(o["size_bytes"] for o in outputs if o["name"] == "image.exr")
    assert received < 40 * whole
    assert httpx.get(f"{server.url}/healthz", timeout=60).status_code == 200
