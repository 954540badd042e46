"""Traces by OpenTelemetry, for who runs a collector: of requests, and of jobs from their
submission to their results.  Without the extra `telemetry` or a collector nothing is traced.

The context of a request is kept with the job that it submits, so one trace shows the request, the
wait and every attempt, across restarts of the service.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from raykiln_service.errors import StartupError
from raykiln_service.jobs import Job, JobState
from raykiln_service.logs import get_logger

if TYPE_CHECKING:
    from opentelemetry.sdk.trace.export import SpanExporter

_TIMEOUT_S = 5.0
_CLOSE_S = 2.0
_PHASES = ("load", "bvh", "render", "denoise", "encode")
_NS = 1_000_000_000


class Tracing:
    """Makes spans; an object without a collector makes none and costs nothing.

    Parameters
    ----------
    endpoint
        URL of a collector of OTLP over HTTP; None = no traces.
    exporter
        Takes the spans instead.

    Raises
    ------
    StartupError
        There is an endpoint, but the extra `telemetry` is not installed.
    """

    def __init__(self, endpoint: str | None = None, exporter: SpanExporter | None = None) -> None:
        self._tracer: Any = None
        if endpoint is None and exporter is None:
            return
        try:
            from opentelemetry import trace
            from opentelemetry.sdk.resources import Resource
            from opentelemetry.sdk.trace import TracerProvider
            from opentelemetry.sdk.trace.export import BatchSpanProcessor
            from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

            if exporter is None:
                from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter

                exporter = OTLPSpanExporter(endpoint=endpoint, timeout=_TIMEOUT_S)
        except ImportError:
            raise StartupError(
                "trace_endpoint needs the extra 'telemetry': pip install 'raykiln[telemetry]'"
            ) from None
        _log_like_the_service()
        self._trace = trace
        self._provider = TracerProvider(
            resource=Resource.create({"service.name": "raykiln"}), shutdown_on_exit=False
        )
        self._provider.add_span_processor(BatchSpanProcessor(exporter))
        self._tracer = self._provider.get_tracer("raykiln_service")
        self._propagator = TraceContextTextMapPropagator()

    @property
    def is_on(self) -> bool:
        """Whether anything is traced."""
        return self._tracer is not None

    @contextmanager
    def request(self, method: str, headers: Mapping[str, str]) -> Iterator[RequestTrace]:
        """Around a request; goes on with the trace that its `traceparent` names."""
        if self._tracer is None:
            yield RequestTrace(None, method)
            return
        parent = self._propagator.extract(headers)
        kind = self._trace.SpanKind.SERVER
        with self._tracer.start_as_current_span(method, context=parent, kind=kind) as span:
            span.set_attribute("http.request.method", method)
            yield RequestTrace(span, method)

    @contextmanager
    def span(self, name: str, **attributes: str) -> Iterator[None]:
        """Around a part of what is traced already."""
        if self._tracer is None:
            yield
            return
        with self._tracer.start_as_current_span(name, attributes=attributes):
            yield

    def context(self) -> str | None:
        """The `traceparent` of what happens now, to keep with a job."""
        if self._tracer is None:
            return None
        carrier: dict[str, str] = {}
        self._propagator.inject(carrier)
        return carrier.get("traceparent")

    @contextmanager
    def attempt(self, job: Job) -> Iterator[AttemptTrace]:
        """Around an attempt at a job; before the first one comes the wait in the queue."""
        if self._tracer is None:
            yield AttemptTrace(None, None)
            return
        parent = self._propagator.extract(
            {} if job.spec.trace is None else {"traceparent": job.spec.trace}
        )
        attributes = {"raykiln.job": job.id, "raykiln.attempt": job.attempts}
        if job.attempts == 1:
            # By this machine's clock, which may have been set back since the submission.
            end_ns = max(time.time_ns(), job.created_ms * 1_000_000)
            wait = self._tracer.start_span(
                "queue wait",
                context=parent,
                attributes=attributes,
                start_time=job.created_ms * 1_000_000,
            )
            wait.end(end_ns)
        with self._tracer.start_as_current_span(
            "attempt", context=parent, attributes=attributes
        ) as span:
            yield AttemptTrace(self._tracer, span)

    def close(self) -> None:
        """Send what is left; a collector that does not answer is not waited for."""
        if self._tracer is None:
            return
        closing = threading.Thread(target=self._provider.shutdown, daemon=True)
        closing.start()
        closing.join(_CLOSE_S)


class RequestTrace:
    """The span of a request."""

    def __init__(self, span: Any, method: str) -> None:
        self._span = span
        self._method = method

    def ended(self, route: str, status: int) -> None:
        """It was answered."""
        if self._span is None:
            return
        self._span.update_name(f"{self._method} {route}")
        self._span.set_attribute("http.route", route)
        self._span.set_attribute("http.response.status_code", status)


class AttemptTrace:
    """The span of an attempt."""

    def __init__(self, tracer: Any, span: Any) -> None:
        self._tracer = tracer
        self._span = span
        self._at_ns = time.time_ns()

    def rendered(self, stats: Mapping[str, Any]) -> None:
        """Show the phases of a render, which are known by their lengths, end to end."""
        if self._span is None:
            return
        for phase in _PHASES:
            length_ns = int(float(stats.get(f"{phase}_s") or 0) * _NS)
            if length_ns > 0:
                span = self._tracer.start_span(phase, start_time=self._at_ns)
                self._at_ns += length_ns
                span.end(self._at_ns)

    def ended(self, state: JobState) -> None:
        """The job is in this state now."""
        if self._span is not None:
            self._span.set_attribute("raykiln.state", str(state))


class _ToLog(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        get_logger().warning("traces", problem=record.getMessage()[:500])


def _log_like_the_service() -> None:
    logger = logging.getLogger("opentelemetry")
    if not any(isinstance(handler, _ToLog) for handler in logger.handlers):
        logger.addHandler(_ToLog(logging.WARNING))
    logger.propagate = False
