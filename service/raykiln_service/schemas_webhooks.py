"""Webhooks over the wire: what may be asked for, and how each delivery stands."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from raykiln_service.webhooks.addresses import MAX_URL
from raykiln_service.webhooks.signatures import key_of

WebhookEvent = Literal["succeeded", "failed", "cancelled"]


class WebhookChoice(BaseModel):
    """Who is to hear how the job ends, by a signed POST."""

    model_config = ConfigDict(extra="forbid", hide_input_in_errors=True)

    url: Annotated[str, Field(min_length=1, max_length=MAX_URL)]
    """https:// or http://, of the public internet."""
    events: Annotated[list[WebhookEvent], Field(min_length=1, max_length=3)] = [
        "succeeded",
        "failed",
        "cancelled",
    ]
    """Which ends to tell of."""
    secret: Annotated[str | None, Field(repr=False)] = None
    """Key of the signatures: `whsec_` and base64; null = the service's own."""

    @field_validator("secret")
    @classmethod
    def _is_key(cls, secret: str | None) -> str | None:
        if secret is not None:
            key_of(secret)
        return secret


class WebhookView(BaseModel):
    """A job's webhook; its secret is never shown."""

    url: str
    """Without the query, which may hold a secret."""
    events: list[str]
    own_secret: bool
    """Whether its signatures have a key of the job's own, not the service's."""
    disabled_at: datetime | None
    """When the receiver answered 410 and so asked for no more."""


class DeliveryView(BaseModel):
    """One message to the webhook."""

    id: str
    """The header `webhook-id`, the same in each attempt."""
    event: str
    """job.succeeded, job.failed or job.cancelled."""
    state: Literal["pending", "delivered", "failed"]
    attempts: int
    created_at: datetime
    last_attempt_at: datetime | None
    next_attempt_at: datetime | None
    """Null once it is delivered or given up."""
    status: int | None
    """HTTP status of the last answer; null = none came."""
    error: str | None
    """Why the last attempt did not deliver it."""


class DeliveriesView(BaseModel):
    """What a job's webhook has been told, newest first."""

    webhook: WebhookView | None
    items: list[DeliveryView]
