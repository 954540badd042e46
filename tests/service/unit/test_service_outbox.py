"""Webhooks without a service: the outbox, the signatures, and where messages may go."""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
import json
import socket
from typing import Any

import pytest
from raykiln_service.jobs import Job, JobEvent, JobSpec, Webhook
from raykiln_service.outbox import CLAIM_MS, Delivery, Outbox
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.webhooks.addresses import (
    ForbiddenTargetError,
    check_address,
    parse_url,
    resolve,
)
from raykiln_service.webhooks.sender import horizon_ms, pause_s
from raykiln_service.webhooks.signatures import headers_of, key_of

SECRET = "whsec_" + base64.b64encode(bytes(range(32))).decode()
HOUR_MS = 3_600_000


@pytest.fixture
def outbox(store: Store) -> Outbox:
    return Outbox(store.database, store.clock, HOUR_MS)


def submit(store: Store, job_id: str, host: str = "a.example", **options: Any) -> None:
    webhook = Webhook(f"https://{host}/hook", host, secret=SECRET, **options)
    spec = JobSpec({"name": "cornell_box"}, {}, labels={"shot": "a"}, webhook=webhook)
    store.create_job(job_id, spec)


def claimed(store: Store) -> Job:
    job = store.claim("me", 30.0)
    assert job is not None
    assert job.lease is not None
    return job


def succeed(store: Store, job_id: str) -> None:
    job = claimed(store)
    assert job.id == job_id
    assert job.lease is not None
    store.succeed(job.lease, {"dir": "r", "files": [], "complete": True})


def take(outbox: Outbox) -> list[Delivery]:
    return outbox.claim(100, [], 100)


def test_the_end_of_a_job_is_in_the_outbox(store: Store, outbox: Outbox, clock: Any) -> None:
    submit(store, "a")
    assert outbox.next_due_s() is None
    clock.ms = 5_000_000
    succeed(store, "a")
    assert (outbox.waiting(), outbox.next_due_s()) == (1, 0.0)
    (delivery,) = take(outbox)
    assert (delivery.event, delivery.job_id, delivery.attempts) == ("job.succeeded", "a", 1)
    body = json.loads(delivery.body)
    assert body["type"] == "job.succeeded"
    assert body["timestamp"] == body["data"]["finished_at"] == "1970-01-01T01:23:20.000Z"
    assert (body["data"]["id"], body["data"]["labels"]) == ("a", {"shot": "a"})
    assert outbox.target_of("a") == ("https://a.example/hook", SECRET)


def test_an_answer_from_the_cache_is_news_too(store: Store, outbox: Outbox) -> None:
    webhook = Webhook("https://a.example/", "a.example", secret=SECRET)
    spec = JobSpec({"name": "cornell_box"}, {}, webhook=webhook)
    store.create_job("a", spec, answer={"dir": "r", "files": [], "cached_from": "b"})
    (delivery,) = take(outbox)
    assert json.loads(delivery.body)["data"]["cached"] is True


def test_only_the_wanted_ends_are_told(store: Store, outbox: Outbox) -> None:
    submit(store, "a", events=("failed",))
    store.cancel("a")
    assert take(outbox) == []
    store.retry("a")
    job = claimed(store)
    assert job.lease is not None
    store.fail(job.lease, {"reason": "crashed", "detail": "it broke", "file": "/secret/place"})
    (delivery,) = take(outbox)
    error = json.loads(delivery.body)["data"]["error"]
    assert error == {"reason": "crashed", "detail": "it broke"}


def test_a_change_that_is_rolled_back_tells_nothing(store: Store, outbox: Outbox) -> None:
    submit(store, "a")

    class BrokenError(Exception):
        pass

    def break_off() -> None:
        with store._change() as change:
            store._move(change, store.job("a"), JobEvent.CANCEL)
            raise BrokenError

    with pytest.raises(BrokenError):
        break_off()
    assert store.job("a").state == "queued"
    assert outbox.waiting() == 0


def test_what_was_being_sent_at_a_kill_is_sent_again_with_its_id(
    store: Store, outbox: Outbox, clock: Any
) -> None:
    submit(store, "a")
    succeed(store, "a")
    (first,) = take(outbox)
    assert take(outbox) == []
    clock.ms += CLAIM_MS
    (again,) = take(outbox)
    assert (again.id, again.body, again.attempts) == (first.id, first.body, 2)
    outbox.delivered(again, 200)
    # The sender that was slow must not take it back into the queue.
    outbox.postpone(first, 5.0, 500, "late")
    clock.ms += 10 * CLAIM_MS
    assert take(outbox) == []
    assert outbox.of_job("a")[1][0].state == "delivered"


def test_a_host_gets_no_more_than_its_share(store: Store, outbox: Outbox) -> None:
    for number in range(5):
        submit(store, f"slow-{number}", "slow.example")
        store.cancel(f"slow-{number}")
    submit(store, "quick", "quick.example")
    store.cancel("quick")
    found = outbox.claim(10, [], 2)
    assert [d.job_id for d in found] == ["slow-0", "slow-1", "quick"]
    assert outbox.claim(10, ["slow.example"], 2) == []
    assert [d.job_id for d in outbox.claim(1, [], 2)] == ["slow-2"]


def test_a_clock_that_was_ahead_holds_nothing_back(
    store: Store, outbox: Outbox, clock: Any
) -> None:
    clock.ms += 100 * HOUR_MS
    submit(store, "a")
    store.cancel("a")
    clock.ms -= 100 * HOUR_MS
    assert len(take(outbox)) == 1


def test_a_receiver_that_is_gone_hears_nothing_more(store: Store, outbox: Outbox) -> None:
    submit(store, "a")
    store.cancel("a")
    store.retry("a")
    store.cancel("a")
    first, _second = take(outbox)
    outbox.disable(first, 410)
    hook, found = outbox.of_job("a")
    assert hook is not None
    assert hook.disabled_ms == store.clock()
    assert [d.state for d in found] == ["failed", "failed"]
    store.retry("a")
    store.cancel("a")
    assert outbox.waiting() == 0


def test_the_news_outlives_its_job_until_it_is_told(store: Store, outbox: Outbox) -> None:
    submit(store, "a")
    store.cancel("a")
    store.delete("a")
    assert outbox.prune() == 0
    (delivery,) = take(outbox)
    outbox.delivered(delivery, 204)
    submit(store, "b")
    assert outbox.prune() == 1
    assert outbox.of_job("a") == (None, [])
    assert outbox.of_job("b")[0] is not None


def test_pauses_grow_up_to_a_limit_and_end() -> None:
    settings = ServiceSettings(webhook_max_attempts=10)
    middle = [pause_s(settings, n, 0.5) for n in range(1, 11)]
    assert middle[:4] == [5.0, 20.0, 80.0, 320.0]
    assert middle[7:] == [21600.0, 21600.0, None]
    assert (pause_s(settings, 1, 0.0), pause_s(settings, 1, 1.0)) == (3.75, 6.25)
    longest = pause_s(settings, 9, 1.0)
    assert longest is not None
    assert horizon_ms(settings) > longest * 1000
    assert horizon_ms(settings) > CLAIM_MS


def test_the_signature_is_that_of_standard_webhooks() -> None:
    # The example of the specification's reference implementations.
    secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
    body = b'{"test": 2432232314}'
    found = headers_of(secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, body)
    assert found["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
    signed = b"msg_p5jXN8AQM9LWM0D4loKWxJek.1614265330." + body
    digest = hmac.new(key_of(secret), signed, hashlib.sha256).digest()
    assert found["webhook-signature"] == f"v1,{base64.b64encode(digest).decode()}"


@pytest.mark.parametrize(
    "secret", ["", "secret", "whsec_", "whsec_c2hvcnQ=", "whsec_!!!!", SECRET[6:], "whsec_\u00e9"]
)
def test_what_is_no_secret_is_refused_and_not_repeated(secret: str) -> None:
    with pytest.raises(ValueError, match="24 to 64") as caught:
        key_of(secret)
    assert len(secret) < 7 or secret not in str(caught.value)


FORBIDDEN = [
    "http://127.0.0.1/",
    "http://127.0.0.1:8000/v1/queue/pause",
    "http://[::1]/",
    "http://[::ffff:127.0.0.1]/",
    "http://[::ffff:169.254.169.254]/",
    "http://[::127.0.0.1]/",
    "http://[64:ff9b::7f00:1]/",
    "http://[2002:7f00:1::]/",
    "http://[fe80::1]/",
    "http://[fe80::1%25eth0]/",
    "http://[fd00:ec2::254]/",
    "http://[ff02::1]/",
    "http://[::]/",
    "http://0.0.0.0/",
    "http://10.0.0.1/",
    "http://172.16.0.1/",
    "http://192.168.1.1/",
    "http://100.64.0.1/",
    "http://169.254.169.254/latest/meta-data/",
    "http://168.63.129.16/",
    "http://224.0.0.1/",
    "http://240.0.0.1/",
    "http://255.255.255.255/",
    "http://198.18.0.1/",
    "http://2130706433/",
    "http://0x7f000001/",
    "http://0x7f.1/",
    "http://017700000001/",
    "http://0177.0.0.1/",
    "http://127.1/",
    "http://localhost/",
    "http://LOCALHOST./",
    "http://db.internal/",
    "http://printer.local/",
    "ftp://example.com/",
    "file:///etc/passwd",
    "gopher://example.com/",
    "//example.com/",
    "example.com",
    "http://",
    "http://user:pass@example.com/",
    "http://example.com@127.0.0.1/",
    "http://example.com\\@127.0.0.1/",
    "http://example.com/#x",
    "http://example.com:22/",
    "http://example.com:0/",
    "http://example.com:99999/",
    "http://example.com:x/",
    "http://exa mple.com/",
    "http://example.com/\r\nHost: evil",
    "http://ex\u00e4mple.com/",
    "http://-bad-.com/",
    "http://a..b/",
    "https://example.com/" + "x" * 2000,
]


@pytest.mark.parametrize("url", FORBIDDEN)
def test_what_leads_inside_is_refused(url: str) -> None:
    with pytest.raises(ForbiddenTargetError):
        parse_url(url)


@pytest.mark.parametrize(
    ("url", "host", "port", "path"),
    [
        ("https://example.com", "example.com", 443, "/"),
        ("http://Example.com/a/b?c=d&e", "example.com", 80, "/a/b?c=d&e"),
        ("https://hooks.example.com:8443/x", "hooks.example.com", 8443, "/x"),
        ("https://8.8.8.8/x", "8.8.8.8", 443, "/x"),
        ("https://[2606:4700::1111]:443/", "2606:4700::1111", 443, "/"),
    ],
)
def test_what_leads_out_is_taken_apart(url: str, host: str, port: int, path: str) -> None:
    target = parse_url(url)
    assert (target.host, target.port, target.path) == (host, port, path)


def test_a_private_network_may_be_allowed_but_not_metadata() -> None:
    for url in ("http://127.0.0.1:22/", "http://localhost:8000/", "http://[fd00::1]/"):
        assert parse_url(url, allow_private=True).host
    for text in ("169.254.169.254", "fe80::1", "0.0.0.0", "224.0.0.1", "fd00:ec2::254"):
        with pytest.raises(ForbiddenTargetError):
            check_address(ipaddress.ip_address(text), allow_private=True)


def test_one_inner_address_behind_a_name_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = ["93.184.216.34", "10.0.0.7"]

    def looked_up(host: str, port: int, **_options: Any) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (text, port)) for text in answers]

    monkeypatch.setattr(socket, "getaddrinfo", looked_up)
    target = parse_url("https://rebind.example/")
    with pytest.raises(ForbiddenTargetError, match=r"10\.0\.0\.7"):
        resolve(target)
    del answers[1]
    assert resolve(target) == ["93.184.216.34"]
