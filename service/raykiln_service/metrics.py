"""What Prometheus may ask for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from raykiln_service.store import Store

_SECONDS = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)


class Metrics:
    """The metrics of one service, in a registry of their own."""

    def __init__(self, store: Store) -> None:
        self.registry = CollectorRegistry()
        self.registry.register(_JobCollector(store))
        self.submitted = self._counter("jobs_submitted", "Jobs accepted.")
        self.ended = self._counter("jobs_ended", "Jobs ended, by state.", "state")
        self.lost = self._counter("attempts_lost", "Attempts lost, by reason.", "reason")
        self.cache_hits = self._counter("cache_hits", "Jobs answered with an earlier result.")
        self.removed = self._counter("removed", "Jobs and uploads removed by clean-ups.", "kind")
        self.removed_bytes = self._counter("removed_bytes", "Disk space that clean-ups freed.")
        self.rejected = self._counter("submissions_rejected", "Submissions refused.", "problem")
        self.rays = self._counter("rays", "Rays traced, by kind.", "kind")
        self.samples = self._counter("samples", "Camera paths traced.")
        self.uploaded = self._counter("uploaded_bytes", "Bytes of assets received.")
        self.wait_s = self._histogram("job_wait_seconds", "From submission to the first attempt.")
        self.render_s = self._histogram("job_render_seconds", "Render time of finished jobs.")
        self.rays_per_s = Gauge(
            "raykiln_rays_per_second", "Of the last finished job.", registry=self.registry
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
        self.ended.labels("succeeded").inc()

    def text(self) -> bytes:
        """All of it, in the text format of Prometheus."""
        return generate_latest(self.registry)

    def _counter(self, name: str, text: str, *labels: str) -> Counter:
        return Counter(f"raykiln_{name}", text, labels, registry=self.registry)

    def _histogram(self, name: str, text: str) -> Histogram:
        return Histogram(f"raykiln_{name}", text, registry=self.registry, buckets=_SECONDS)


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
