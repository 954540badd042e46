"""Webhooks from a real service to real receivers, of which some are dead, slow or hostile."""

from __future__ import annotations

import base64
import json
import socket
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from raykiln_service.webhooks.signatures import headers_of

SECRET = "whsec_" + base64.b64encode(b"a key of more than 24 bytes").decode()
OTHER = "whsec_" + base64.b64encode(b"another key, just as long").decode()
QUICK = {"width": 16, "height": 16, "spp": 1}
RETRIES = {"webhook_retry_delay_s": 0.05, "webhook_retry_delay_max_s": 0.2}


class Receiver:
    """An HTTP server that keeps what it gets, and answers as told."""

    def __init__(self, answers: list[int]) -> None:
        self.got: list[tuple[str, dict[str, str], bytes]] = []
        self.answers = answers
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["content-length"]))
                number = len(receiver.got)
                headers = {name.lower(): value for name, value in self.headers.items()}
                receiver.got.append((self.path, headers, body))
                self.send_response(receiver.answers[min(number, len(receiver.answers) - 1)])
                self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_arguments: Any) -> None:
                """Say nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/hook?key=q-secret"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def wait_for(self, count: int) -> None:
        wait_until(lambda: len(self.got) >= count)


class RawReceiver:
    """A TCP server that gives each connection to a function."""

    def __init__(self, serve: Callable[[socket.socket], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}/"
        self.connections = 0
        self.ended = 0
        self._serve = serve
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self.connections += 1
                threading.Thread(target=self._one, args=(connection,), daemon=True).start()

    def _one(self, connection: socket.socket) -> None:
        with connection, suppress(OSError):
            self._serve(connection)
        self.ended += 1

    def close(self) -> None:
        # Closing alone would leave the port to the thread that waits for a connection.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


def wait_until(reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not reached():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


@pytest.fixture
def receiver() -> Iterator[Callable[..., Receiver]]:
    made: list[Receiver] = []

    def make(*answers: int) -> Receiver:
        made.append(Receiver(list(answers) or [204]))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture(scope="module")
def hooked(module_serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service that may reach this machine, has a secret, and soon tries again."""
    return module_serve(
        data_dir=str(tmp_path_factory.mktemp("hooked")),
        webhook_secret=SECRET,
        webhook_allow_private=True,
        webhook_max_attempts=4,
        **RETRIES,
    )


def deliveries(server: Any, job_id: str) -> dict[str, Any]:
    with server.client() as client:
        reply = client.get(f"/v1/jobs/{job_id}/deliveries").raise_for_status()
        view: dict[str, Any] = reply.json()
        return view


def ended(server: Any, job_id: str) -> dict[str, Any]:
    def settled() -> bool:
        items = deliveries(server, job_id)["items"]
        return bool(items) and all(item["state"] != "pending" for item in items)

    wait_until(settled)
    found: dict[str, Any] = deliveries(server, job_id)["items"][0]
    return found


def submit(server: Any, ball: dict[str, Any], **webhook: Any) -> str:
    job = server.submit(scene={"inline": ball}, settings=QUICK, cache=False, webhook=webhook)
    return str(job["id"])


def test_the_end_of_a_job_is_told_and_signed(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver()
    job_id = submit(hooked, ball, url=there.url)
    there.wait_for(1)
    (path, headers, body) = there.got[0]
    assert path == "/hook?key=q-secret"
    wanted = headers_of(SECRET, headers["webhook-id"], int(headers["webhook-timestamp"]), body)
    assert headers["webhook-signature"] == wanted["webhook-signature"]
    assert abs(int(headers["webhook-timestamp"]) - time.time()) < 60
    message = json.loads(body)
    assert (message["type"], message["data"]["id"]) == ("job.succeeded", job_id)
    delivery = ended(hooked, job_id)
    assert (delivery["state"], delivery["status"], delivery["attempts"]) == ("delivered", 204, 1)
    assert delivery["id"] == headers["webhook-id"]
    assert delivery["next_attempt_at"] is None
    webhook = deliveries(hooked, job_id)["webhook"]
    assert webhook["url"] == there.url.partition("?")[0]


def test_secrets_are_shown_nowhere(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver()
    job_id = submit(hooked, ball, url=there.url, secret=OTHER, events=["succeeded"])
    there.wait_for(1)
    headers, body = there.got[0][1:]
    signed = headers_of(OTHER, headers["webhook-id"], int(headers["webhook-timestamp"]), body)
    assert headers["webhook-signature"] == signed["webhook-signature"]
    ended(hooked, job_id)
    with hooked.client() as client:
        texts = [client.get(f"/v1/jobs/{job_id}{part}").text for part in ("", "/deliveries")]
        bad = {"scene": {"inline": ball}, "webhook": {"url": there.url, "secret": OTHER + "?"}}
        reply = client.post("/v1/jobs", json=bad)
        assert (reply.status_code, reply.json()["pointer"]) == (422, "/webhook/secret")
        texts.append(reply.text)
    texts += [hooked.log.read_text(), body.decode()]
    for text in texts:
        assert OTHER[6:30] not in text
        assert "q-secret" not in text


def test_what_is_not_accepted_is_sent_again_with_the_same_id(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver(500, 302, 200)
    delivery = ended(hooked, submit(hooked, ball, url=there.url))
    assert (delivery["state"], delivery["attempts"]) == ("delivered", 3)
    assert [path for path, _, _ in there.got] == ["/hook?key=q-secret"] * 3
    assert len({headers["webhook-id"] for _, headers, _ in there.got}) == 1
    assert len({body for _, _, body in there.got}) == 1


def test_it_is_given_up_some_day(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver(503)
    delivery = ended(hooked, submit(hooked, ball, url=there.url))
    assert (delivery["state"], delivery["attempts"]) == ("failed", 4)
    assert (delivery["status"], delivery["error"]) == (503, "answered 503")
    assert len(there.got) == 4


def test_what_was_given_up_is_sent_again_on_request(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver(410, 204)
    job_id = submit(hooked, ball, url=there.url)
    first = ended(hooked, job_id)
    assert (first["state"], first["status"]) == ("failed", 410)
    path = f"/v1/jobs/{job_id}/deliveries/{first['id']}/redeliver"
    with hooked.client() as client:
        reply = client.post(path)
        assert reply.status_code == 202
        assert reply.json()["webhook"]["disabled_at"] is None
        there.wait_for(2)
        again = ended(hooked, job_id)
        assert (again["id"], again["state"], again["attempts"]) == (first["id"], "delivered", 1)
        assert again["error"] is None
        # Also what has arrived, for a receiver that has lost it.
        client.post(path).raise_for_status()
        there.wait_for(3)
        assert client.post(f"/v1/jobs/{job_id}/deliveries/msg_none/redeliver").status_code == 404
        other = submit(hooked, ball, url=there.url)
        assert client.post(path.replace(job_id, other)).status_code == 404
    assert len({body for _, _, body in there.got[:3]}) == 1


def test_gone_means_never_again(
    hooked: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver(410)
    endless = {"width": 256, "height": 256, "spp": 100_000}
    body = {"scene": {"inline": ball}, "settings": endless, "webhook": {"url": there.url}}
    job_id = hooked.submit(**body)["id"]
    with hooked.client() as client:
        client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        hooked.wait_for_end(job_id)
        assert ended(hooked, job_id)["status"] == 410
        assert deliveries(hooked, job_id)["webhook"]["disabled_at"] is not None
        client.post(f"/v1/jobs/{job_id}/retry").raise_for_status()
        client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        hooked.wait_for_end(job_id)
    assert len(deliveries(hooked, job_id)["items"]) == len(there.got) == 1


def drip(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    while True:
        connection.sendall(b"X-A: b\r\n")
        time.sleep(0.1)


def flood(connection: socket.socket) -> None:
    while True:
        connection.sendall(b"HTTP/1.1 103 Early Hints\r\nLink: </a>\r\n\r\n" * 100)


def endless_body(connection: socket.socket) -> None:
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        connection.sendall(b"x" * 65536)


def not_http(connection: socket.socket) -> None:
    connection.sendall(b"220 mail.example ESMTP\r\n")
    connection.recv(1 << 16)


def silent(connection: socket.socket) -> None:
    # Until the other end has had enough.
    while connection.recv(1 << 16):
        pass


@pytest.mark.parametrize(
    ("behaviour", "error"),
    [
        (silent, "no answer within 1 s"),
        (drip, "no answer within 1 s"),
        (flood, "the answer has no end"),
        (not_http, "the answer is not HTTP"),
        (endless_body, None),
    ],
)
def test_hostile_receivers(
    serve: Any, ball: dict[str, Any], behaviour: Any, error: str | None
) -> None:
    server = serve(
        webhook_secret=SECRET,
        webhook_allow_private=True,
        # Only where nothing else ends it: one that answers wrongly is to have the time for it.
        webhook_timeout_s=1.0 if behaviour in (silent, drip) else 20.0,
        webhook_max_attempts=1,
    )
    there = RawReceiver(behaviour)
    try:
        delivery = ended(server, submit(server, ball, url=there.url))
    finally:
        there.close()
    if error is None:
        assert delivery["state"] == "delivered"
    else:
        assert delivery["state"] == "failed"
        assert error in delivery["error"]


def test_dead_receivers_hold_up_neither_jobs_nor_others(
    serve: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    server = serve(webhook_secret=SECRET, webhook_allow_private=True, webhook_timeout_s=20.0)
    dead, there = RawReceiver(silent), receiver()
    try:
        with server.client() as client:
            client.post("/v1/queue/pause").raise_for_status()
            jobs = [submit(server, ball, url=url) for url in [*[dead.url] * 4, there.url]]
            client.post("/v1/queue/resume").raise_for_status()
        there.wait_for(1)
        # None of them was given up by then: the last message had a place of its own.
        assert dead.connections in (1, 2)
        assert dead.ended == 0
        assert [server.job(job)["state"] for job in jobs] == ["succeeded"] * 5
    finally:
        dead.close()


def test_a_kill_between_sending_and_noting_sends_again(serve: Any, ball: dict[str, Any]) -> None:
    requests: list[bytes] = []

    def hold_the_first(connection: socket.socket) -> None:
        requests.append(connection.recv(65536))
        if len(requests) == 1:
            silent(connection)
        else:
            connection.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")

    there = RawReceiver(hold_the_first)
    settings = {"webhook_secret": SECRET, "webhook_allow_private": True}
    server = serve(**settings, webhook_timeout_s=20.0)
    try:
        job_id = submit(server, ball, url=there.url)
        wait_until(lambda: len(requests) == 1)
        server.kill_all()
        with closing(sqlite3.connect(server.data_dir / "raykiln.db")) as database, database:
            state, attempts = database.execute("SELECT state, attempts FROM deliveries").fetchone()
            # As if the half minute had passed after which the claim of a dead service is void.
            database.execute("UPDATE deliveries SET next_ms = 0")
        assert (state, attempts) == ("pending", 1)
        server = serve(**settings)
        delivery = ended(server, job_id)
    finally:
        there.close()
    assert (delivery["state"], delivery["attempts"]) == ("delivered", 2)
    ids = {
        line for sent in requests for line in sent.lower().split(b"\r\n") if b"webhook-id" in line
    }
    assert len(requests) == 2
    assert ids == {b"webhook-id: " + delivery["id"].encode()}


@pytest.mark.parametrize(
    ("webhook", "pointer"),
    [
        ({"url": "http://127.0.0.1/"}, "/webhook/url"),
        ({"url": "http://169.254.169.254/latest/"}, "/webhook/url"),
        ({"url": "http://2130706433/"}, "/webhook/url"),
        ({"url": "http://[::ffff:10.0.0.1]/"}, "/webhook/url"),
        ({"url": "file:///etc/passwd"}, "/webhook/url"),
        ({"url": "https://user:pw@example.com/"}, "/webhook/url"),
        ({"url": "https://example.com/"}, "/webhook/secret"),
        ({"url": "https://example.com/", "secret": "short"}, "/webhook/secret"),
        ({"url": "https://example.com/", "secret": 7}, "/webhook/secret"),
        ({"url": "https://example.com/", "events": []}, "/webhook/events"),
        ({"url": "https://example.com/", "events": ["queued"]}, "/webhook/events/0"),
        ({"url": "https://example.com/", "method": "GET"}, "/webhook/method"),
        ({}, "/webhook/url"),
        ("https://example.com/", "/webhook"),
    ],
)
def test_a_bad_webhook_is_refused_at_once(
    server: Any, ball: dict[str, Any], webhook: Any, pointer: str
) -> None:
    with server.client() as client:
        before = len(client.get("/v1/jobs").json()["items"])
        reply = client.post("/v1/jobs", json={"scene": {"inline": ball}, "webhook": webhook})
        assert reply.status_code == 422, reply.text
        assert reply.json()["pointer"] == pointer
        assert len(client.get("/v1/jobs").json()["items"]) == before


def test_a_name_that_leads_inside_is_not_followed(
    serve: Any, ball: dict[str, Any], receiver: Callable[..., Receiver]
) -> None:
    there = receiver()
    # This machine's own name leads to an address of its private network.
    name = socket.gethostname()
    url = there.url.replace("127.0.0.1", name)
    server = serve(webhook_secret=SECRET, webhook_max_attempts=1)
    with server.client() as client:
        body = {"scene": {"inline": ball}, "settings": QUICK, "webhook": {"url": url}}
        reply = client.post("/v1/jobs", json=body)
        if reply.status_code == 422:
            pytest.skip(f"the name {name!r} of this machine is refused as such")
        delivery = ended(server, reply.json()["id"])
    assert delivery["state"] == "failed"
    assert "forbidden" in delivery["error"] or "no connection" in delivery["error"]
    assert there.got == []


def test_jobs_without_a_webhook_say_so(server: Any, ball: dict[str, Any]) -> None:
    job = server.submit(scene={"inline": ball}, settings=QUICK)
    with server.client() as client:
        assert client.get(job["links"]["deliveries"]).json() == {"webhook": None, "items": []}
        assert client.get("/v1/jobs/job-none/deliveries").status_code == 404
