"""The clients against a server that breaks off, stalls, changes its mind or is no service."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from raykiln_service.client import (
    AsyncClient,
    Client,
    ClientError,
    Event,
    ServerError,
    ServerUnreachableError,
)

JOB = {"id": "j", "state": "running"}
Reply = Callable[["Handler"], None]


class Handler(BaseHTTPRequestHandler):
    """Answers each request with the next reply of the script."""

    protocol_version = "HTTP/1.1"
    script: list[Reply]
    seen: list[Handler]
    body: bytes

    def _answer(self) -> None:
        self.body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.seen.append(self)
        self.script.pop(0)(self)

    do_GET = do_POST = do_DELETE = _answer  # noqa: N815

    def log_message(self, format: str, *args: Any) -> None:
        pass


def document(value: Any, status: int = 200, **headers: str) -> Reply:
    def reply(request: Handler) -> None:
        data = json.dumps(value).encode()
        send(request, status, data, {"Content-Type": "application/json", **headers})

    return reply


def part(data: bytes, *, length: int | None = None, status: int = 200, **headers: str) -> Reply:
    """A body that may be shorter than announced; then the connection ends."""

    def reply(request: Handler) -> None:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        send(request, status, data, named, length)
        request.close_connection = True

    return reply


def send(
    request: Handler, status: int, data: bytes, headers: dict[str, str], length: int | None = None
) -> None:
    request.send_response(status)
    for name, value in headers.items():
        request.send_header(name, value)
    request.send_header("Content-Length", str(len(data) if length is None else length))
    request.end_headers()
    request.wfile.write(data)


def hang_up(request: Handler) -> None:
    request.close_connection = True


def stream(text: str) -> Reply:
    """A piece of an event stream, then the end of the connection."""

    def reply(request: Handler) -> None:
        request.send_response(200)
        request.send_header("Content-Type", "text/event-stream")
        request.send_header("Connection", "close")
        request.end_headers()
        request.wfile.write(text.encode())
        request.close_connection = True

    return reply


@contextmanager
def serving(*script: Reply) -> Iterator[tuple[str, list[Handler]]]:
    seen: list[Handler] = []
    handler: Any = type("Scripted", (Handler,), {"script": list(script), "seen": seen})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", seen
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert not handler.script, "the client asked less often than expected"


Caller = Callable[..., Any]


def blocking(server: str, name: str, *arguments: Any, **options: Any) -> Any:
    with Client(server, timeout_s=60) as client:
        result = getattr(client, name)(*arguments, **options)
        return list(result) if name == "events" else result


def asynchronous(server: str, name: str, *arguments: Any, **options: Any) -> Any:
    async def run() -> Any:
        async with AsyncClient(server, timeout_s=60) as client:
            result = getattr(client, name)(*arguments, **options)
            return [event async for event in result] if name == "events" else await result

    return asyncio.run(run())


@pytest.fixture(params=[blocking, asynchronous])
def call(request: pytest.FixtureRequest) -> Caller:
    caller: Caller = request.param
    return caller


def test_a_read_is_repeated_after_a_broken_connection(call: Caller) -> None:
    with serving(hang_up, document({"title": "busy"}, 503), document(JOB)) as (server, seen):
        assert call(server, "job", "j").state == "running"
    assert len(seen) == 3


def test_a_submission_is_repeated_under_the_same_key(call: Caller) -> None:
    with serving(hang_up, document(JOB, 202)) as (server, seen):
        call(server, "submit", {"name": "cornell_box"}, {"spp": 1}, labels={"a": "b"})
    assert seen[0].headers["Idempotency-Key"] == seen[1].headers["Idempotency-Key"]
    assert json.loads(seen[1].body) == {
        "scene": {"name": "cornell_box"},
        "settings": {"spp": 1},
        "labels": {"a": "b"},
    }


def test_a_full_queue_is_waited_for(call: Caller) -> None:
    full = document({"title": "full"}, 429, **{"Retry-After": "0"})
    with serving(full, document(JOB, 202)) as (server, _):
        assert call(server, "submit", {"name": "x"}).id == "j"


def test_a_cancel_is_never_sent_twice(call: Caller) -> None:
    with serving(hang_up) as (server, _), pytest.raises(ServerUnreachableError):
        call(server, "cancel", "j")


def test_a_refusal_carries_the_problem(call: Caller) -> None:
    problem = {"title": "bad", "detail": "unknown material", "pointer": "/shapes/0", "status": 422}
    with serving(document(problem, 422)) as (server, _), pytest.raises(ServerError) as caught:
        call(server, "submit", {"inline": {}})
    assert caught.value.status == 422
    assert caught.value.problem == problem


def test_giving_up_after_the_last_retry(call: Caller) -> None:
    busy = document({"title": "busy"}, 503)
    with serving(*[busy] * 4) as (server, _), pytest.raises(ServerError, match="busy"):
        call(server, "job", "j")


def test_another_server_is_not_taken_for_the_service(call: Caller) -> None:
    page = part(b"<html>", Content_Type="text/html")
    missing = part(b"<html>", status=404, Content_Type="text/html")
    for reply in (page, missing):
        with serving(reply) as (server, _), pytest.raises(ServerUnreachableError, match="html"):
            call(server, "version")


def test_nobody_answers(call: Caller) -> None:
    with serving() as (server, _):
        pass
    with pytest.raises(ServerUnreachableError, match=f"no raykiln service answers at {server}"):
        call(server, "job", "j")


def test_events_go_on_where_the_connection_broke(call: Caller) -> None:
    first = 'id: 1\nevent: state\ndata: {"state": "running"}\n\nid: 2\nevent: progr'
    second = 'id: 3\nevent: state\ndata: {"state": "succeeded"}\n\nid: 4\ndata: never\n\n'
    with serving(stream(first), hang_up, stream(second)) as (server, seen):
        events = call(server, "events", "j")
    assert events == [
        Event("state", {"state": "running"}, "1"),
        Event("state", {"state": "succeeded"}, "3"),
    ]
    assert "Last-Event-ID" not in seen[0].headers
    # The id of an event that did not arrive whole must not be skipped.
    assert seen[1].headers["Last-Event-ID"] == "1"
    assert seen[2].headers["Last-Event-ID"] == "1"


def test_waiting_ends_with_the_job_as_it_is_then(call: Caller) -> None:
    end = stream('event: state\ndata: {"state": "failed"}\n\n')
    final = document({"id": "j", "state": "failed", "error": {"detail": "crashed"}})
    with serving(end, final) as (server, _):
        job = call(server, "wait", "j")
    assert job.is_final
    assert job.error_text == "crashed"


def test_waiting_has_an_end(call: Caller) -> None:
    nothing = stream(": nothing yet\n\n")

    def nothing_more(request: Handler) -> None:
        nothing(request)
        # Until the client leaves.
        request.rfile.read(1)

    with serving(nothing, nothing_more) as (server, seen), pytest.raises(TimeoutError):
        call(server, "wait", "j", timeout_s=2.0)
    assert len(seen) == 2


def test_events_of_an_unknown_job_are_refused_at_once(call: Caller) -> None:
    missing = document({"title": "There is no such thing"}, 404)
    with serving(missing) as (server, _), pytest.raises(ServerError, match="no such thing"):
        call(server, "events", "j")


def test_a_download_goes_on_where_it_broke(call: Caller, tmp_path: Path) -> None:
    target = tmp_path / "image.exr"
    begin = part(b"0123", length=10, ETag='"a"')
    rest = part(b"456789", status=206, ETag='"a"', Content_Range="bytes 4-9/10")
    with serving(begin, rest) as (server, seen):
        assert call(server, "download", "j", "image.exr", target) == target
    assert target.read_bytes() == b"0123456789"
    assert seen[1].headers["Range"] == "bytes=4-"
    assert seen[1].headers["If-Range"] == '"a"'
    assert list(tmp_path.iterdir()) == [target]


def test_a_download_of_a_file_that_changed_starts_over(call: Caller, tmp_path: Path) -> None:
    target = tmp_path / "image.exr"
    begin = part(b"0123", length=10, ETag='"a"')
    whole = part(b"abcdef", ETag='"b"')
    with serving(begin, whole) as (server, _):
        call(server, "download", "j", "image.exr", target)
    assert target.read_bytes() == b"abcdef"


def test_a_part_that_was_not_asked_for_is_refused(call: Caller, tmp_path: Path) -> None:
    wrong = part(b"45", status=206, Content_Range="bytes 4-5/6")
    with serving(wrong) as (server, _), pytest.raises(ClientError, match="another part"):
        call(server, "download", "j", "image.exr", tmp_path / "image.exr")
    assert not list(tmp_path.iterdir())


def test_a_failed_download_leaves_the_old_file(call: Caller, tmp_path: Path) -> None:
    target = tmp_path / "image.exr"
    target.write_bytes(b"old")
    missing = document({"title": "There is no such thing"}, 404)
    with serving(missing) as (server, _), pytest.raises(ServerError):
        call(server, "download", "j", "image.exr", target)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_upload_is_sent_whole_again(call: Caller, tmp_path: Path) -> None:
    scene = tmp_path / "a.glb"
    scene.write_bytes(bytes(range(256)) * 4000)
    asset = {"id": "sha256:0", "size_bytes": 1_024_000, "filename": "a.glb"}
    with serving(hang_up, document(asset, 201)) as (server, seen):
        assert call(server, "upload_asset", scene).size_bytes == 1_024_000
    assert seen[1].body == scene.read_bytes()
    assert seen[1].path == "/v1/assets?filename=a.glb"


def test_the_token_is_sent_and_an_id_cannot_leave_its_path(call: Caller, monkeypatch: Any) -> None:
    monkeypatch.setenv("RAYKILN_TOKEN", "secret")
    with serving(document(JOB)) as (server, seen):
        call(server, "job", "../../x?y#z")
    assert seen[0].headers["Authorization"] == "Bearer secret"
    assert seen[0].path == "/v1/jobs/..%2F..%2Fx%3Fy%23z"


def test_a_preview_is_the_bytes_of_an_image(call: Caller) -> None:
    with serving(hang_up, part(b"\x89PNG", Content_Type="image/png")) as (server, seen):
        assert call(server, "preview", "j") == b"\x89PNG"
    assert seen[1].path == "/v1/jobs/j/preview.png"
