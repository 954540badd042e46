"""News of jobs for those who wait: from the threads that work to the event loop that serves.

States are durable (the store numbers them); progress and previews are news of the moment, of
which a slow reader gets the latest only.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from raykiln_service.rows import StateEvent


class Subscription:
    """What one reader has not seen yet.  Used in the event loop that made it."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._wake = asyncio.Event()
        self.state_changed = False
        self.progress: Mapping[str, Any] | None = None
        self.preview: Mapping[str, Any] | None = None
        self.closed = False

    def post(self, **news: Any) -> None:
        """Add news, from any thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._take, news)

    def _take(self, news: Mapping[str, Any]) -> None:
        for name, value in news.items():
            setattr(self, name, value)
        self._wake.set()

    def end(self) -> None:
        """End the subscription, from any thread."""
        self.post(closed=True)

    async def wait(self, timeout_s: float) -> bool:
        """Wait for news; False if there were none in time."""
        try:
            await asyncio.wait_for(self._wake.wait(), timeout_s)
        except TimeoutError:
            return False
        self._wake.clear()
        return True

    def take_progress(self) -> Mapping[str, Any] | None:
        """The latest progress that was not taken yet."""
        news, self.progress = self.progress, None
        return news

    def take_preview(self) -> Mapping[str, Any] | None:
        """The latest preview that was not taken yet."""
        news, self.preview = self.preview, None
        return news

    def take_state(self) -> bool:
        """Whether the state has changed since the last call."""
        news, self.state_changed = self.state_changed, False
        return news


class Feed:
    """What one reader of all jobs' news has not seen yet.  Used in the event loop that made it.

    Of each job the latest news of each kind are kept; past `LIMIT` unread ones all are dropped,
    and the reader is told to look at the list again.
    """

    LIMIT = 2000

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._wake = asyncio.Event()
        self._news: dict[tuple[str, str], Mapping[str, Any]] = {}
        self._overrun = False
        self.closed = False

    def post(self, job_id: str, kind: str, data: Mapping[str, Any]) -> None:
        """Add news of a job, from any thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._take, job_id, kind, data)

    def end(self) -> None:
        """End the feed, from any thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._close)

    async def take(self, timeout_s: float) -> list[tuple[str, str, Mapping[str, Any]]]:
        """The unread news as (job, kind, data); none if there were none in time.

        An overrun is one entry of the kind ``reload`` with an empty job id.
        """
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._wake.wait(), timeout_s)
        self._wake.clear()
        news, self._news = self._news, {}
        overrun, self._overrun = self._overrun, False
        if overrun:
            return [("", "reload", {})]
        return [(job_id, kind, data) for (job_id, kind), data in news.items()]

    def _take(self, job_id: str, kind: str, data: Mapping[str, Any]) -> None:
        # Taken out first, so that the order is that of the latest news.
        self._news.pop((job_id, kind), None)
        self._news[job_id, kind] = data
        if len(self._news) > self.LIMIT:
            self._news.clear()
            self._overrun = True
        self._wake.set()

    def _close(self) -> None:
        self.closed = True
        self._wake.set()


class EventHub:
    """Passes news on to subscriptions, and knows the latest progress of running jobs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._readers: dict[str, set[Subscription]] = {}
        self._feeds: set[Feed] = set()
        self._owned_by: dict[str, list[Callable[[], None]]] = {}
        self._progress: dict[str, Mapping[str, Any]] = {}
        self._previews: dict[str, int] = {}
        self._closed = False

    @contextlib.contextmanager
    def subscribe_to_all(self, owner: str | None = None) -> Iterator[Feed]:
        """News of all jobs, from now on; `owner` is the token that reads them."""
        feed = Feed(asyncio.get_running_loop())
        with self._lock:
            self._feeds.add(feed)
            feed.closed = self._closed
        try:
            with self._owned(owner, feed.end):
                yield feed
        finally:
            with self._lock:
                self._feeds.discard(feed)

    @contextlib.contextmanager
    def subscribe(self, job_id: str, owner: str | None = None) -> Iterator[Subscription]:
        """News of one job, from now on; `owner` is the token that reads them."""
        reader = Subscription(asyncio.get_running_loop())
        with self._lock:
            self._readers.setdefault(job_id, set()).add(reader)
            reader.closed = self._closed
        try:
            with self._owned(owner, reader.end):
                yield reader
        finally:
            with self._lock:
                readers = self._readers[job_id]
                readers.discard(reader)
                if not readers:
                    del self._readers[job_id]

    @contextlib.contextmanager
    def _owned(self, owner: str | None, end: Callable[[], None]) -> Iterator[None]:
        """Note how to end what a token reads, as long as it does."""
        if owner is None:
            yield
            return
        with self._lock:
            self._owned_by.setdefault(owner, []).append(end)
        try:
            yield
        finally:
            with self._lock:
                self._owned_by[owner].remove(end)
                if not self._owned_by[owner]:
                    del self._owned_by[owner]

    def owners(self) -> list[str]:
        """The tokens that read something now."""
        with self._lock:
            return list(self._owned_by)

    def end_of(self, owner: str) -> None:
        """End all that a token reads."""
        with self._lock:
            ends = list(self._owned_by.get(owner, ()))
        for end in ends:
            end()

    def state_changed(self, event: StateEvent) -> None:
        """A state has changed (a listener of the store)."""
        if event.data["state"] != "running":
            self._drop(event.job_id)
        self._post(event.job_id, state_changed=True)
        self._tell_feeds(event.job_id, "state", {"state": event.data["state"]})

    def progress_made(self, job_id: str, progress: Mapping[str, Any]) -> None:
        """A running job has come so far."""
        with self._lock:
            self._progress[job_id] = progress
        self._post(job_id, progress=progress)
        self._tell_feeds(job_id, "progress", progress)

    def preview_made(self, job_id: str, spp_done: int) -> None:
        """There is a new preview image."""
        with self._lock:
            number = self._previews[job_id] = self._previews.get(job_id, 0) + 1
        self._post(job_id, preview={"number": number, "spp_done": spp_done})
        self._tell_feeds(job_id, "preview", {"number": number, "spp_done": spp_done})

    def latest_progress(self, job_id: str) -> Mapping[str, Any] | None:
        """How far a running job has come, if this process runs it."""
        with self._lock:
            return self._progress.get(job_id)

    def forget(self, job_id: str) -> None:
        """Drop what is known of a deleted job, and end its streams."""
        self._drop(job_id)
        self._post(job_id, closed=True)
        self._tell_feeds(job_id, "deleted", {})

    def reader_count(self) -> int:
        """How many subscriptions there are."""
        with self._lock:
            return len(self._feeds) + sum(len(readers) for readers in self._readers.values())

    def close(self) -> None:
        """End all subscriptions: the service is going down."""
        with self._lock:
            self._closed = True
            readers = [reader for group in self._readers.values() for reader in group]
            feeds = list(self._feeds)
        for reader in readers:
            reader.end()
        for feed in feeds:
            feed.end()

    @property
    def is_closed(self) -> bool:
        """Whether the service is going down."""
        return self._closed

    def _drop(self, job_id: str) -> None:
        with self._lock:
            self._progress.pop(job_id, None)
            self._previews.pop(job_id, None)

    def _post(self, job_id: str, **news: Any) -> None:
        with self._lock:
            readers = list(self._readers.get(job_id, ()))
        for reader in readers:
            reader.post(**news)

    def _tell_feeds(self, job_id: str, kind: str, data: Mapping[str, Any]) -> None:
        with self._lock:
            feeds = list(self._feeds)
        for feed in feeds:
            feed.post(job_id, kind, data)
