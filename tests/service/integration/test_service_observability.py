"""What a running service tells of itself: metrics, log lines and traces."""

from __future__ import annotations

import json
import re
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from raykiln_service.errors import StartupError
from raykiln_service.telemetry import Tracing

QUICK = {"width": 16, "height": 16, "spp": 1}
BROKEN = {"version": 1, "shapes": "none"}


def metrics(server: Any) -> dict[str, float]:
    with server.client() as client:
        text = client.get("/metrics").raise_for_status().text
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines)}


def test_every_end_and_every_refusal_is_counted(server: Any, ball: dict[str, Any]) -> None:
    body: dict[str, Any] = {"scene": {"inline": ball}, "settings": QUICK}
    before = metrics(server)
    with server.client() as client:
        first = server.submit(**body, cache=False)
        server.wait_for_end(first["id"])
        assert server.submit(**body)["cached"]
        client.post("/v1/queue/pause").raise_for_status()
        waiting = server.submit(**body, cache=False)
        during = metrics(server)
        client.post(f"/v1/jobs/{waiting['id']}/cancel").raise_for_status()
        client.post("/v1/queue/resume").raise_for_status()
        late = server.submit(
            scene={"inline": ball},
            settings={"width": 512, "height": 512, "spp": 100_000},
            timeout_s=0.2,
        )
        assert server.wait_for_end(late["id"])["error"]["reason"] == "timeout"
        assert client.post("/v1/jobs", json={"scene": {"inline": BROKEN}}).status_code == 422
        assert client.get("/v1/jobs/job-none").status_code == 404
        assert client.get("/no/such/page").status_code == 404
    # It is counted a moment after it shows.
    deadline = time.monotonic() + 60
    failed = 'raykiln_jobs_failed_total{reason="timeout"}'
    while (after := metrics(server)).get(failed, 0) == before.get(failed, 0):
        assert time.monotonic() < deadline, "the failure is not counted"
        time.sleep(0.02)

    def grown(name: str) -> float:
        return after.get(f"raykiln_{name}", 0) - before.get(f"raykiln_{name}", 0)

    assert during['raykiln_jobs{state="queued"}'] == 1
    assert grown("jobs_submitted_total") == 4
    assert grown('jobs_ended_total{state="succeeded"}') == 2
    assert grown('jobs_ended_total{state="cancelled"}') == 1
    assert grown('jobs_ended_total{state="failed"}') == 1
    assert grown('jobs_failed_total{reason="timeout"}') == 1
    assert grown("cache_hits_total") == 1
    assert grown('checks_total{result="accepted"}') == 4
    assert grown('checks_total{result="refused"}') == 1
    assert grown('phase_seconds_count{phase="render"}') == 1
    assert grown("samples_total") == 16 * 16
    route = 'method="GET",route="/v1/jobs/{job_id}"'
    assert grown(f'http_request_seconds_count{{{route},status="4xx"}}') == 1
    other = 'method="GET",route="other",status="4xx"'
    assert grown(f"http_request_seconds_count{{{other}}}") == 1


def test_no_label_is_made_from_what_a_client_sends(server: Any) -> None:
    with server.client() as client:
        for number in range(20):
            client.request(f"VERB{number}", f"/v1/jobs/job-{number}/x{number}")
            client.get(f"/v1/jobs/job-{number}/outputs/name-{number}")
    names = " ".join(metrics(server))
    assert "VERB" not in names
    assert not re.search(r"job-\d|name-\d", names)


def test_every_metric_is_explained(server: Any, repo_root: Any) -> None:
    page = (repo_root / "docs" / "reference" / "http.md").read_text()
    named = set(re.findall(r"`(\w+?)(?:\{[\w,]+\})?`", page))
    with server.client() as client:
        text = client.get("/metrics").text
    served = set(re.findall(r"^# TYPE raykiln_(\w+)", text, re.MULTILINE))
    assert {name for name in served if not name.endswith("_created")} <= named


def test_lines_of_the_log_about_a_job_have_its_id_and_attempt(
    serve: Any, ball: dict[str, Any]
) -> None:
    server = serve(log_format="json", token="a-secret-of-the-service")
    job = server.submit(scene={"inline": ball}, settings=QUICK)
    server.wait_for_end(job["id"])
    assert server.stop() == 0
    lines = [json.loads(line) for line in server.log.read_text().splitlines()]
    about = [line for line in lines if line.get("job") == job["id"]]
    assert [line["event"] for line in about] == [
        "job accepted",
        "attempt begins",
        "attempt ends, the job is succeeded",
    ]
    assert [line["attempt"] for line in about] == [0, 1, 1]
    assert all({"level", "timestamp"} <= line.keys() for line in about)
    assert "a-secret" not in server.log.read_text()


class Collector:
    """Takes OTLP over HTTP."""

    def __init__(self) -> None:
        self.spans: list[Any] = []
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                from opentelemetry.proto.collector.trace.v1 import trace_service_pb2

                message = trace_service_pb2.ExportTraceServiceRequest()
                message.ParseFromString(self.rfile.read(int(self.headers["Content-Length"])))
                for resource in message.resource_spans:
                    for scope in resource.scope_spans:
                        collector.spans.extend(scope.spans)
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_arguments: Any) -> None:
                """Say nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1/traces"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def collector() -> Iterator[Collector]:
    pytest.importorskip("opentelemetry.sdk", reason="the extra `telemetry` is not installed")
    made = Collector()
    yield made
    made.close()


def test_a_trace_leads_from_the_request_to_the_phases(
    serve: Any, ball: dict[str, Any], collector: Collector
) -> None:
    server = serve(trace_endpoint=collector.url)
    trace_id, parent_id = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"
    with server.client() as client:
        reply = client.post(
            "/v1/jobs",
            json={"scene": {"inline": ball}, "settings": {"width": 64, "height": 64, "spp": 16}},
            headers={"traceparent": f"00-{trace_id}-{parent_id}-01"},
        )
        job_id = reply.json()["id"]
    server.wait_for_end(job_id)
    assert server.stop() == 0
    ours = {span.name: span for span in collector.spans if span.trace_id.hex() == trace_id}
    wanted = {"POST /v1/jobs", "check", "queue wait", "attempt", "load", "render", "encode"}
    assert wanted <= ours.keys()
    request, attempt = ours["POST /v1/jobs"], ours["attempt"]
    assert request.parent_span_id.hex() == parent_id
    for name in ("check", "queue wait", "attempt"):
        assert ours[name].parent_span_id in (request.span_id, ours["check"].span_id)
    for name in ("load", "render", "encode"):
        assert ours[name].parent_span_id == attempt.span_id
        assert attempt.start_time_unix_nano <= ours[name].start_time_unix_nano
        assert ours[name].end_time_unix_nano <= attempt.end_time_unix_nano
    told = {entry.key: entry.value.string_value for entry in attempt.attributes}
    assert (told["raykiln.job"], told["raykiln.state"]) == (job_id, "succeeded")


def test_a_dead_collector_harms_nobody(serve: Any, ball: dict[str, Any]) -> None:
    pytest.importorskip("opentelemetry.sdk", reason="the extra `telemetry` is not installed")
    server = serve(trace_endpoint="http://127.0.0.1:9/v1/traces", log_format="json")
    job = server.submit(scene={"inline": ball}, settings=QUICK)
    assert server.wait_for_end(job["id"])["state"] == "succeeded"
    # Which waits for no more than a while.
    assert server.stop() == 0
    for line in server.log.read_text().splitlines():
        assert isinstance(json.loads(line), dict)


def test_traces_without_their_library_are_an_error_that_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry", None)
    assert not Tracing().is_on
    with pytest.raises(StartupError, match=r"raykiln\[telemetry\]"):
        Tracing("http://127.0.0.1:4318/v1/traces")
