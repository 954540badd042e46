"""The Python client of a raykiln service: `Client` (blocking) and `AsyncClient`.

Calls that can be repeated without harm are tried again after a broken connection or a busy
service: reads, uploads (the same bytes are stored once) and submissions (by idempotency key).
"""

from raykiln_service.client.asynchronous import AsyncClient
from raykiln_service.client.blocking import Client
from raykiln_service.client.models import (
    Asset,
    ClientError,
    Deliveries,
    Delivery,
    Event,
    Frame,
    FrameCounts,
    Job,
    JobPage,
    JobProgress,
    Output,
    ServerError,
    ServerUnreachableError,
)
from raykiln_service.client.packing import Package, package

__all__ = [
    "Asset",
    "AsyncClient",
    "Client",
    "ClientError",
    "Deliveries",
    "Delivery",
    "Event",
    "Frame",
    "FrameCounts",
    "Job",
    "JobPage",
    "JobProgress",
    "Output",
    "Package",
    "ServerError",
    "ServerUnreachableError",
    "package",
]
