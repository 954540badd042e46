"""What Prometheus may ask for."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from raykiln_service.rows import StateEvent
from raykiln_service.store import Store

_QUICK = (0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100)
_PHASES = ("load", "bvh", "render", "denoise", "encode")
# What else a render process may say is counted as one, so that it cannot make series at will.
_REASONS = frozenset(
    {
        *("rejected", "out-of-memory", "timeout", "crashed", "stalled", "render-error"),
        *("storage", "interrupted", "internal", "not-found", "invalid-asset", "invalid-scene"),
    }
)
_SECONDS = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)


class Metrics:
    """The metrics of one service, in a registry of their own."""

    def __init__(self, store: Store) -> None:
        self.registry = CollectorRegistry()
        self.registry.register(_JobCollector(store))
        self.submitted = self._counter("jobs_submitted", "Jobs accepted.")
        self.ended = self._counter("jobs_ended", "Jobs ended, by state.", "state")
        self._lost = self._counter("attempts_lost", "Attempts lost, by reason.", "reason")
        self._failed = self._counter("jobs_failed", "Jobs failed, by reason.", "reason")
        self.retried = self._counter("units_retried", "Units that are to be rendered once more.")
        self.cache_hits = self._counter("cache_hits", "Jobs answered with an earlier result.")
        self.removed = self._counter("removed", "Jobs and uploads removed by clean-ups.", "kind")
        self.removed_bytes = self._counter("removed_bytes", "Disk space that clean-ups freed.")
        self.rejected = self._counter("submissions_rejected", "Submissions refused.", "problem")
        self.rays = self._counter("rays", "Rays traced, by kind.", "kind")
        self.samples = self._counter("samples", "Camera paths traced.")
        self.checks = self._counter("checks", "Scenes checked, by result.", "result")
        self.check_s = self._histogram("check_seconds", "Time of the check of a scene.", _QUICK)
        self.uploaded = self._counter("uploaded_bytes", "Bytes of assets received.")
        self.wait_s = self._histogram("job_wait_seconds", "From submission to the first attempt.")
        self.render_s = self._histogram("job_render_seconds", "Render time of finished jobs.")
        self.rays_per_s = Gauge(
            "raykiln_rays_per_second", "Of the last finished job.", registry=self.registry
        )
        self._phase_s = self._histogram(
            "phase_seconds", "Time of a finished job by phase.", _SECONDS, "phase"
        )
        self._http_s = self._histogram(
            "http_request_seconds",
            "Time of a request, but for event streams.",
            _QUICK,
            "method",
            "route",
            "status",
        )
        self.webhooks_waiting = Gauge(
            "raykiln_webhooks_waiting", "Messages to deliver.", registry=self.registry
        )
        self.webhooks = self._counter("webhooks", "Attempts at deliveries, by result.", "result")
        self.webhook_s = self._histogram("webhook_seconds", "Time of an attempt at a delivery.")
        self.readers = Gauge("raykiln_event_readers", "Open event streams.", registry=self.registry)

    def note_result(self, queue_s: float, stats: Mapping[str, Any]) -> None:
        """Count a finished job."""
        self.wait_s.observe(queue_s)
        self.render_s.observe(float(stats.get("render_s") or 0))
        self.rays_per_s.set(float(stats.get("rays_per_s") or 0))
        self.samples.inc(float(stats.get("samples") or 0))
        for phase in _PHASES:
            self._phase_s.labels(phase).observe(float(stats.get(f"{phase}_s") or 0))
        for kind in ("camera", "bounce", "shadow"):
            self.rays.labels(kind).inc(float(stats.get(f"{kind}_rays") or 0))

    def note_sweep(self, jobs: int, assets: int, freed_bytes: int) -> None:
        """Count what a clean-up removed."""
        self.removed.labels("job").inc(jobs)
        self.removed.labels("asset").inc(assets)
        self.removed_bytes.inc(freed_bytes)

    def note_answer(self) -> None:
        """Count a job that was answered from the cache."""
        self.cache_hits.inc()

    def heard(self, event: StateEvent) -> None:
        """Count a job that has ended, however that came."""
        state = event.data["state"]
        if state in ("succeeded", "failed", "cancelled"):
            self.ended.labels(str(state)).inc()

    def note_failure(self, reason: str) -> None:
        """Count a job that has failed."""
        self._failed.labels(_known(reason)).inc()

    def note_loss(self, reason: str) -> None:
        """Count an attempt that was lost."""
        self._lost.labels(_known(reason)).inc()

    def note_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request by its route; `status` counts by its hundreds."""
        self._http_s.labels(method, route, f"{status // 100}xx").observe(seconds)

    @contextmanager
    def check(self) -> Iterator[None]:
        """Around the check of a scene."""
        began, result = time.monotonic(), "refused"
        try:
            yield
            result = "accepted"
        finally:
            self.checks.labels(result).inc()
            self.check_s.observe(time.monotonic() - began)

    def text(self) -> bytes:
        """All of it, in the text format of Prometheus."""
        return generate_latest(self.registry)

    def _counter(self, name: str, text: str, *labels: str) -> Counter:
        return Counter(f"raykiln_{name}", text, labels, registry=self.registry)

    def _histogram(
        self, name: str, text: str, buckets: Sequence[float] = _SECONDS, *labels: str
    ) -> Histogram:
        return Histogram(f"raykiln_{name}", text, labels, registry=self.registry, buckets=buckets)


def _known(reason: str) -> str:
    return reason if reason in _REASONS else "other"


class _JobCollector(Collector):
    def __init__(self, store: Store) -> None:
        self._store = store

    def collect(self) -> Iterable[GaugeMetricFamily]:
        """The jobs in each state, counted when asked."""
        family = GaugeMetricFamily("raykiln_jobs", "Jobs, by state.", labels=["state"])
        for state, count in self._store.count_by_state().items():
            family.add_metric([str(state)], count)
        yield family

    def describe(self) -> Iterable[GaugeMetricFamily]:
        """Known beforehand, so that registering does not ask the database."""
        return [GaugeMetricFamily("raykiln_jobs", "Jobs, by state.", labels=["state"])]
