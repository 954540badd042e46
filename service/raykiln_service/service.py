"""The parts of the service, put together."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from typing import BinaryIO

from sqlalchemy.exc import SQLAlchemyError

from raykiln_service.assets import AssetStore
from raykiln_service.bundles import BundleLimits
from raykiln_service.cache import ResultCache
from raykiln_service.database import Database, has_wal_reset_bug
from raykiln_service.dispatcher import Dispatcher
from raykiln_service.errors import StartupError
from raykiln_service.events import EventHub
from raykiln_service.executors.checks import CheckPool
from raykiln_service.executors.limits import Limits as RenderLimits
from raykiln_service.executors.limits import default_job_memory, default_warm_memory
from raykiln_service.executors.local import LocalExecutor
from raykiln_service.executors.nursery import Nursery
from raykiln_service.logs import get_logger
from raykiln_service.metrics import Metrics
from raykiln_service.outbox import Outbox
from raykiln_service.queueing import QueueWatch
from raykiln_service.replies import Replies
from raykiln_service.retention import Keeper, Rounds
from raykiln_service.routes.context import Context
from raykiln_service.settings import ServiceSettings
from raykiln_service.store import Store
from raykiln_service.submission import Submissions
from raykiln_service.telemetry import Tracing
from raykiln_service.tokens import TokenStore
from raykiln_service.uploads import Uploads
from raykiln_service.webhooks.sender import Sender, horizon_ms

_STOP_S = 4.0


class Service:
    """One running service on one data folder.

    Making it opens the folder and the database; `start` begins to render; `close` ends it all.
    """

    def __init__(self, settings: ServiceSettings) -> None:
        self.settings = settings
        self._lock = _lock_data_dir(settings)
        url = settings.database_url or Database.sqlite_url(settings.data_dir / "raykiln.db")
        self.database = Database(url)
        self.database.migrate()
        self.store = Store(self.database, priority_step_s=settings.priority_step_s)
        self.tokens = TokenStore(self.database, settings.token_limits)
        limits = BundleLimits(
            settings.max_bundle_bytes, settings.max_bundle_entries, settings.max_bundle_ratio
        )
        self.assets = AssetStore(settings.data_dir.resolve(), self.store, limits)
        self.assets.prepare()
        self.uploads = Uploads(self.assets, settings.upload_expiry_s)
        self.uploads.prepare()
        self.hub = EventHub()
        self.store.listen(self.hub.state_changed)
        self.metrics = Metrics(self.store)
        self.store.listen(self.metrics.heard)
        self.tracing = Tracing(settings.trace_endpoint)
        allowed = _render_limits(settings)
        self._nursery = nursery = Nursery()
        self.checks = CheckPool(
            settings.check_timeout_s,
            settings.check_memory_bytes or allowed.memory_bytes,
            sandbox=settings.sandbox,
            nursery=nursery,
        )
        self.executor = LocalExecutor(
            settings.slots,
            checkpoint_interval_s=settings.checkpoint_interval_s,
            limits=allowed,
            scratch=self.assets.tmp,
            nursery=nursery,
        )
        # Raises before anything is served where the sandbox is required and cannot be had.
        layers = self.executor.sandbox_layers()
        cache = ResultCache(self.store, self.assets)
        self.dispatcher = Dispatcher(
            self.store,
            self.assets,
            self.executor,
            cache,
            self.hub,
            self.metrics,
            settings,
            self.tracing,
        )
        keeper = Keeper(self.store, self.assets, settings, self.hub.forget)
        self.rounds = Rounds(keeper, settings.gc_interval_s, self.metrics.note_sweep)
        self.replies = Replies(self.database)
        outbox = Outbox(self.database, self.store.clock, horizon_ms(settings))
        self.sender = Sender(outbox, settings, self.metrics)
        self.store.listen(self.sender.heard)
        self.context = Context(
            settings=settings,
            store=self.store,
            assets=self.assets,
            uploads=self.uploads,
            hub=self.hub,
            outbox=outbox,
            replies=self.replies,
            wake_sender=self.sender.wake_up,
            metrics=self.metrics,
            submissions=Submissions(
                self.store,
                self.assets,
                self.checks,
                cache,
                settings,
                self.metrics,
                self.tracing,
            ),
            queue=QueueWatch(self.store, self.hub, settings.slots),
            readiness=self.readiness,
            sandbox=layers,
        )

    def start(self) -> None:
        """Take over what an earlier service left, and begin to render."""
        if self.database.is_sqlite and has_wal_reset_bug(sqlite3.sqlite_version_info):
            get_logger().info(
                "this SQLite needs the rule of one writing connection, which is kept",
                sqlite=sqlite3.sqlite_version,
            )
        get_logger().info("render processes are confined", **self.context.sandbox)
        self.dispatcher.start()
        self.rounds.start()
        self.sender.start()

    def readiness(self) -> dict[str, str]:
        """ "ok" or what is wrong, by part."""
        parts = {"database": "ok", "executor": "ok"}
        try:
            self.store.paused()
        except SQLAlchemyError as error:
            parts["database"] = f"does not answer: {type(error).__name__}"
        if not self.dispatcher.is_ready():
            parts["executor"] = "does not run"
        return parts

    def begin_stop(self) -> None:
        """Make the renders write their checkpoints, and the open streams end."""
        self.dispatcher.begin_stop()
        self.hub.close()

    def close(self) -> None:
        """End it all."""
        self.begin_stop()
        self.dispatcher.finish_stop(_STOP_S)
        self.rounds.stop(_STOP_S)
        self.sender.stop(_STOP_S)
        self.tracing.close()
        self.checks.close()
        self._nursery.close()
        self.database.close()
        self._lock.close()


def _render_limits(settings: ServiceSettings) -> RenderLimits:
    own = settings.job_memory_bytes or default_job_memory(settings.slots)
    warm = settings.warm_memory_bytes
    return RenderLimits(
        memory_bytes=own,
        silence_s=settings.silence_timeout_s,
        warm_scenes=settings.warm_scenes,
        warm_memory_bytes=default_warm_memory() if warm is None else warm,
        sandbox=settings.sandbox,
    )


def _lock_data_dir(settings: ServiceSettings) -> BinaryIO:
    folder = settings.data_dir
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("ab+")
    except OSError as error:
        raise StartupError(
            f"the data folder {folder} cannot be used: {error.strerror or error}"
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.seek(0)
        owner = lock.read(20).decode("ascii", errors="replace").strip()
        lock.close()
        raise StartupError(
            f"the data folder {folder} is in use by another service"
            + (f" (process {owner})" if owner else "")
        ) from None
    lock.truncate(0)
    lock.write(str(os.getpid()).encode())
    lock.flush()
    return lock
