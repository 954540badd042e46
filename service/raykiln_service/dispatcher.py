"""Takes jobs from the store, one thread a slot, and sees each attempt through to its commit."""

from __future__ import annotations

import secrets
import threading

from sqlalchemy.exc import SQLAlchemyError

from raykiln_service.assets import AssetStore
from raykiln_service.attempt import Attempt
from raykiln_service.attempt_frames import FramesAttempt
from raykiln_service.cache import ResultCache
from raykiln_service.errors import LeaseLostError
from raykiln_service.events import EventHub
from raykiln_service.executors.base import Executor
from raykiln_service.jobs import Job, Lease
from raykiln_service.leases import LeaseWatch
from raykiln_service.logs import get_logger
from raykiln_service.metrics import Metrics
from raykiln_service.rows import StateEvent
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.telemetry import Tracing

_IDLE_S = 0.5
_SWEEP_S = 5.0


class Dispatcher:
    """Keeps the slots of an executor busy.

    `start` first takes back the jobs that an earlier service left running.  `begin_stop` makes
    the running attempts write their checkpoints and give their jobs back; `finish_stop` waits.
    """

    def __init__(
        self,
        store: Store,
        assets: AssetStore,
        executor: Executor,
        cache: ResultCache,
        hub: EventHub,
        metrics: Metrics,
        settings: ServiceSettings,
        tracing: Tracing | None = None,
    ) -> None:
        self.owner = secrets.token_hex(8)
        self._store = store
        self._assets = assets
        self._executor = executor
        self._cache = cache
        self._hub = hub
        self._metrics = metrics
        self._settings = settings
        self._tracing = tracing or Tracing()
        self._stopping = threading.Event()
        self._wake = threading.Condition()
        self._signals = 0
        self._held: set[str] = set()
        self._threads: list[threading.Thread] = []
        self._log = get_logger()

    def start(self) -> None:
        """Take over, and begin to work."""
        alone = self._store.database.is_sqlite
        self._store.rerank()
        if alone:
            for lease in self._store.leases_of_others(self.owner):
                if self._store.void(lease):
                    self._log.info("job taken back from an earlier service", job=lease.job_id)
        self._store.listen(self._heard)
        self._store.listen_to_queue(self._wake_all)
        self._executor.start()
        for slot in range(self._executor.slots):
            self._spawn(self._work, slot)
        self._spawn(self._sweep, alone)

    def begin_stop(self) -> None:
        """Claim nothing more; running attempts stop at their next look."""
        self._stopping.set()
        self._wake_all()

    def finish_stop(self, timeout_s: float) -> None:
        """Wait for the attempts, then end the executor."""
        self.begin_stop()
        for thread in self._threads:
            thread.join(timeout_s)
        self._executor.stop()

    def is_ready(self) -> bool:
        """Whether jobs are being worked on."""
        alive = all(thread.is_alive() for thread in self._threads)
        return alive and not self._stopping.is_set() and self._executor.is_ready()

    def _spawn(self, target: object, *arguments: object) -> None:
        assert callable(target)
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _wake_all(self) -> None:
        with self._wake:
            self._signals += 1
            self._wake.notify_all()

    def _heard(self, event: StateEvent) -> None:
        if event.data["state"] == "queued":
            self._wake_all()

    def _work(self, slot: int) -> None:
        while not self._stopping.is_set():
            # Read before the look, so that a job that comes right after it is not slept over.
            signals = self._signals
            job = self._claim()
            if job is None:
                self._sleep(signals)
                continue
            assert job.lease is not None
            self._held.add(job.lease.token)
            try:
                if not self._answered(job):
                    self._attempt(job).run(slot, self._executor)
            except Exception:
                # A slot must outlive whatever one job does to it; the sweep takes the job back.
                self._log.exception("attempt broke in the service", job=job.id)
            finally:
                self._held.discard(job.lease.token)

    def _sleep(self, signals: int) -> None:
        with self._wake:
            self._wake.wait_for(lambda: self._signals != signals, _IDLE_S)

    def _claim(self) -> Job | None:
        try:
            return self._store.claim(self.owner, self._settings.lease_s)
        except SQLAlchemyError as error:
            self._log.warning("no job could be claimed", error=str(error))
            self._stopping.wait(1.0)
            return None

    def _answered(self, job: Job) -> bool:
        """Whether an identical job has meanwhile done this one's work."""
        if job.lease is None or job.cancel_requested:
            return False
        try:
            key = self._store.cache_key_of(job.id)
            answer = None if key is None else self._cache.answer(job.id, key)
            if answer is None:
                return False
            self._store.succeed(job.lease, answer)
        except LeaseLostError:
            return True
        except SQLAlchemyError as error:
            self._log.warning("no look into the cache", job=job.id, error=str(error))
            return False
        self._metrics.note_answer()
        return True

    def _attempt(self, job: Job) -> Attempt:
        kind = Attempt if job.spec.frames is None else FramesAttempt
        return kind(
            job,
            store=self._store,
            assets=self._assets,
            hub=self._hub,
            metrics=self._metrics,
            settings=self._settings,
            is_stopping=self._stopping.is_set,
            tracing=self._tracing,
        )

    def _sweep(self, alone: bool) -> None:
        watch = LeaseWatch(self._store, self._settings.lease_s)
        suspects: set[Lease] = set()
        while not self._stopping.wait(min(_SWEEP_S, self._settings.lease_s / 4)):
            try:
                for job_id in [] if alone else watch.sweep(self.owner):
                    self._log.info("job taken back from a service that is gone", job=job_id)
                suspects = self._drop_orphans(suspects)
            except SQLAlchemyError as error:
                self._log.warning("leases not swept", error=str(error))

    def _drop_orphans(self, suspects: set[Lease]) -> set[Lease]:
        """Take back the jobs of this service that no slot works on; returns new suspects.

        That happens where the database failed between a change and the news of it.  A job that
        is just being claimed looks the same, so it takes two looks.
        """
        leases = self._store.leases_of(self.owner)
        found = {lease for lease in leases if lease.token not in self._held}
        for lease in found & suspects:
            if self._store.void(lease, self._settings.retry_pause_s(lease.attempt)):
                self._log.warning("job taken back that nobody worked on", job=lease.job_id)
        return found - suspects
