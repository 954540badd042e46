"""Sends what the outbox holds, in a thread of its own that no job ever waits for."""

from __future__ import annotations

import asyncio
import random
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import raykiln as rk
from sqlalchemy.exc import SQLAlchemyError

from raykiln_service.logs import get_logger
from raykiln_service.metrics import Metrics
from raykiln_service.outbox import Delivery, Outbox
from raykiln_service.rows import StateEvent
from raykiln_service.settings import ServiceSettings
from raykiln_service.webhooks.addresses import ForbiddenTargetError, parse_url
from raykiln_service.webhooks.post import DeliveryError, post
from raykiln_service.webhooks.signatures import headers_of

Made = TypeVar("Made")

_AT_A_TIME = 32
_PER_HOST = 2
_LOOKUPS = 16
_IDLE_S = 5.0
_PRUNE_S = 300.0
_GONE = 410
_GROWTH = 4.0
_JITTER = 0.25
_FINAL = ("succeeded", "failed", "cancelled")


def horizon_ms(settings: ServiceSettings) -> int:
    """The longest that a message may have to wait for its next delivery."""
    return round(settings.webhook_retry_delay_max_s * (1 + _JITTER) * 1000) + 60_000


def pause_s(settings: ServiceSettings, attempts: int, chance: float) -> float | None:
    """How long to wait after so many deliveries that failed; None = give up.

    Parameters
    ----------
    chance
        0 to 1: spreads the receivers of one outage over time.
    """
    if attempts >= settings.webhook_max_attempts:
        return None
    grown = settings.webhook_retry_delay_s * _GROWTH ** min(attempts - 1, 60)
    return min(settings.webhook_retry_delay_max_s, grown) * (1 + _JITTER * (2 * chance - 1))


class Sender:
    """Delivers messages: at least once each, in no order, and slow receivers hold up no others."""

    def __init__(self, outbox: Outbox, settings: ServiceSettings, metrics: Metrics) -> None:
        self._outbox = outbox
        self._settings = settings
        self._metrics = metrics
        self._log = get_logger()
        self._thread = threading.Thread(target=self._run, daemon=True, name="raykiln-webhooks")
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake: asyncio.Event | None = None
        self._stopping = False
        # The database and the resolver have threads of their own: a name server that does not
        # answer must not keep what was delivered from being noted.
        self._store_thread = ThreadPoolExecutor(1, "raykiln-outbox")
        self._resolver = ThreadPoolExecutor(_LOOKUPS, "raykiln-names")
        self._tls = ssl.create_default_context()
        self._busy: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def heard(self, event: StateEvent) -> None:
        """A job's state has changed: there may be something to deliver."""
        if event.data["state"] in _FINAL:
            self.wake_up()

    def stop(self, timeout_s: float) -> None:
        """End; what is under way is delivered again by the next service."""
        self._stopping = True
        self.wake_up()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        for pool in (self._store_thread, self._resolver):
            pool.shutdown(wait=pool is self._store_thread, cancel_futures=True)

    def wake_up(self) -> None:
        """Look at once what there is to deliver."""
        loop, wake = self._loop, self._wake
        if loop is not None and wake is not None:
            try:
                loop.call_soon_threadsafe(wake.set)
            except RuntimeError:
                # The loop has just ended.
                return

    def _run(self) -> None:
        # Not `asyncio.run`: it would wait for look-ups of names that do not end.
        loop = asyncio.new_event_loop()
        try:
            loop.run_until_complete(self._deliver_all())
        except Exception:
            self._log.exception("webhooks are not delivered any more")
        finally:
            self._loop = None
            loop.close()

    async def _deliver_all(self) -> None:
        self._wake, self._loop = asyncio.Event(), asyncio.get_running_loop()
        prune_at = time.monotonic()
        while not self._stopping:
            self._wake.clear()
            try:
                wait_s = await self._begin_due()
                if time.monotonic() >= prune_at:
                    prune_at = time.monotonic() + _PRUNE_S
                    await self._in_store(self._outbox.prune)
            except SQLAlchemyError as error:
                self._log.warning("outbox not read", error=type(error).__name__)
                wait_s = _IDLE_S
            try:
                await asyncio.wait_for(self._wake.wait(), wait_s)
            except TimeoutError:
                continue
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _begin_due(self) -> float:
        """Begin what is due and fits; how long to sleep after that unless woken."""
        room = _AT_A_TIME - len(self._tasks)
        if room <= 0:
            return _IDLE_S
        full = [host for host, count in self._busy.items() if count > 0]
        claimed = await self._in_store(lambda: self._outbox.claim(room, full, _PER_HOST))
        for delivery in claimed:
            self._busy[delivery.host] += 1
            task = asyncio.create_task(self._deliver(delivery))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        next_s = await self._in_store(self._outbox.next_due_s)
        # What is due and was left is for a busy host, whose next free place wakes this.
        return _IDLE_S if next_s is None or next_s <= 0 else min(_IDLE_S, next_s + 0.001)

    async def _deliver(self, delivery: Delivery) -> None:
        began = time.monotonic()
        try:
            await self._attempt(delivery)
        except SQLAlchemyError as error:
            # Its claim runs out, and then it is sent again.
            self._log.warning("delivery not noted", job=delivery.job_id, error=type(error).__name__)
        except Exception:
            self._log.exception("delivery broke", job=delivery.job_id, delivery=delivery.id)
        finally:
            self._metrics.webhook_s.observe(time.monotonic() - began)
            self._busy[delivery.host] -= 1
            if self._busy[delivery.host] <= 0:
                del self._busy[delivery.host]
            assert self._wake is not None
            self._wake.set()

    async def _attempt(self, delivery: Delivery) -> None:
        status: int | None = None
        headers: Mapping[str, str] = {}
        problem: str | None
        try:
            status, headers = await self._post(delivery)
        except ForbiddenTargetError as error:
            problem = f"forbidden: {error}"
        except TimeoutError:
            problem = f"no answer within {self._settings.webhook_timeout_s:g} s"
        except DeliveryError as error:
            problem = str(error)
        except OSError as error:
            problem = f"no connection: {error.strerror or error}"
        else:
            problem = _problem_of(status)
        if status is not None and problem is None:
            await self._in_store(lambda: self._outbox.delivered(delivery, status))
            self._tell(delivery, "delivered", status)
        elif status == _GONE:
            await self._in_store(lambda: self._outbox.disable(delivery, status))
            self._tell(delivery, "gone", status)
        else:
            delay_s = self._delay_s(delivery, headers)
            text = str(problem)[:500]
            await self._in_store(lambda: self._outbox.postpone(delivery, delay_s, status, text))
            self._tell(delivery, "failed" if delay_s is None else "postponed", status, text)

    async def _post(self, delivery: Delivery) -> tuple[int, Mapping[str, str]]:
        settings = self._settings
        url, own = await self._in_store(lambda: self._outbox.target_of(delivery.job_id))
        # Looked at again: what is allowed may have changed since the job came.
        target = parse_url(url, allow_private=settings.webhook_allow_private)
        secret = own
        if secret is None and settings.webhook_secret is not None:
            secret = settings.webhook_secret.get_secret_value()
        if secret is None:
            raise DeliveryError("the service has no webhook_secret any more")
        body = delivery.body.encode()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"raykiln/{rk.__version__}",
            **headers_of(secret, delivery.id, int(time.time()), body),
        }
        return await post(
            target,
            headers,
            body,
            timeout_s=settings.webhook_timeout_s,
            allow_private=settings.webhook_allow_private,
            resolver=self._resolver,
            tls=self._tls,
        )

    def _delay_s(self, delivery: Delivery, headers: Mapping[str, str]) -> float | None:
        delay_s = pause_s(self._settings, delivery.attempts, random.random())
        asked = headers.get("retry-after", "")
        if delay_s is None or not (asked.isdecimal() and len(asked) < 10):
            return delay_s
        return max(delay_s, min(float(asked), self._settings.webhook_retry_delay_max_s))

    def _tell(
        self, delivery: Delivery, result: str, status: int | None, problem: str | None = None
    ) -> None:
        self._metrics.webhooks.labels(result).inc()
        self._log.info(
            f"webhook {result}",
            job=delivery.job_id,
            delivery=delivery.id,
            host=delivery.host,
            attempts=delivery.attempts,
            status=status,
            problem=problem,
        )

    async def _in_store(self, call: Callable[[], Made]) -> Made:
        return await asyncio.get_running_loop().run_in_executor(self._store_thread, call)


def _problem_of(status: int) -> str | None:
    if 200 <= status < 300:
        return None
    if 300 <= status < 400:
        return f"answered {status}, and redirects are not followed"
    return f"answered {status}"
