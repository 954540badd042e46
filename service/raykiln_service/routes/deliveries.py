"""What the webhook of a job has been told."""

from __future__ import annotations

from urllib.parse import urlsplit

from fastapi import APIRouter

from raykiln_service.outbox import Delivery, Hook
from raykiln_service.routes.context import ERRORS, Context, InContext
from raykiln_service.schemas import timestamp
from raykiln_service.schemas_webhooks import DeliveriesView, DeliveryView, WebhookView

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["webhooks"], responses=ERRORS)


@router.get("/deliveries")
def list_deliveries(job_id: str, context: InContext) -> DeliveriesView:
    """The webhook of a job, and its last hundred messages, newest first."""
    return _deliveries(job_id, context)


@router.post("/deliveries/{delivery_id}/redeliver", status_code=202)
def redeliver(job_id: str, delivery_id: str, context: InContext) -> DeliveriesView:
    """Send a message again, at once, whatever became of it; its id stays.

    It gets all its attempts anew, and a webhook that answered 410 is told again.
    """
    context.outbox.redeliver(job_id, delivery_id)
    context.wake_sender()
    return _deliveries(job_id, context)


def _deliveries(job_id: str, context: Context) -> DeliveriesView:
    context.store.job(job_id)
    hook, found = context.outbox.of_job(job_id)
    return DeliveriesView(
        webhook=None if hook is None else _webhook_view(hook),
        items=[_delivery_view(delivery) for delivery in found],
    )


def _webhook_view(hook: Hook) -> WebhookView:
    parts = urlsplit(hook.url)
    return WebhookView(
        url=parts._replace(query="", fragment="").geturl(),
        events=list(hook.events),
        own_secret=hook.has_secret,
        disabled_at=None if hook.disabled_ms is None else timestamp(hook.disabled_ms),
    )


def _delivery_view(delivery: Delivery) -> DeliveryView:
    return DeliveryView(
        id=delivery.id,
        event=delivery.event,
        state=delivery.state,
        attempts=delivery.attempts,
        created_at=timestamp(delivery.created_ms),
        last_attempt_at=None if delivery.last_ms is None else timestamp(delivery.last_ms),
        next_attempt_at=None if delivery.next_ms is None else timestamp(delivery.next_ms),
        status=delivery.status,
        error=delivery.error,
    )
