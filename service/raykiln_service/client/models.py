"""What the Python client sends and gets: plain values, no connection."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

_LINE_END = re.compile(r"\r\n|\n|\r")
FINAL_STATES = frozenset({"succeeded", "failed", "cancelled"})


def is_final(state: str) -> bool:
    """Whether a job in this state has ended."""
    return state in FINAL_STATES


class ClientError(Exception):
    """Base of every error that the client raises on purpose."""


class ServerUnreachableError(ClientError):
    """Nothing answers at the address, or it is no raykiln service."""


class ServerError(ClientError):
    """The service refused a request.

    Parameters
    ----------
    status
        HTTP status code.
    problem
        The `application/problem+json` document.
    retry_after_s
        How long the service asks to wait, if it does.
    """

    def __init__(
        self, status: int, problem: Mapping[str, Any], retry_after_s: float | None = None
    ) -> None:
        self.status = status
        self.problem = dict(problem)
        self.retry_after_s = retry_after_s
        super().__init__(self._text())

    def _text(self) -> str:
        get = self.problem.get
        where = ": ".join(str(part) for part in (get("file"), get("pointer")) if part)
        what = str(get("detail") or get("title") or f"HTTP status {self.status}")
        text = f"{where}: {what}" if where else what
        if get("found") is not None and f"(found {get('found')}" not in text:
            text += f" (found {get('found')})"
        if get("accepted") and f"accepted: {get('accepted')}" not in text:
            text += f"; accepted: {get('accepted')}"
        return text


class Model(BaseModel):
    """Base of the replies: unknown fields are kept, so that a newer service can say more."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Asset(Model):
    """A stored upload."""

    id: str
    """`sha256:` and 64 hex digits."""
    size_bytes: int
    filename: str | None = None


class JobProgress(Model):
    """How far a job has come."""

    phase: str = ""
    """waiting, load, render, denoise, encode, gather or done."""
    fraction: float = 0.0
    """0 to 1."""
    spp_done: int | None = None
    spp: int | None = None
    elapsed_s: float | None = None
    eta_s: float | None = None
    frame: int | None = None
    """Number of the frame that is rendered, of a job of frames."""
    frames: int | None = None
    frames_done: int | None = None


class Output(Model):
    """A file of a job's result."""

    name: str
    media_type: str
    size_bytes: int
    sha256: str


class Frame(Model):
    """One of the pictures of a job of frames."""

    number: int
    """From 1."""
    name: str
    """As in file names: 0001."""
    state: str
    """queued, running, succeeded, failed or cancelled."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """What differs from the job's settings."""
    camera: dict[str, Any] | None = None
    """The camera in the native format, if it is not one of the scene's."""
    time_s: float | None = None
    failures: int = 0
    error: dict[str, Any] | None = None
    complete: bool | None = None
    outputs: list[Output] = Field(default_factory=list)
    stats: dict[str, Any] | None = None

    def file_name(self, name: str) -> str:
        """The name of an output in a sequence: image.exr gives image.0001.exr."""
        stem, _, suffix = name.rpartition(".")
        return f"{stem}.{self.name}.{suffix}"


class FrameCounts(Model):
    """How many frames of a job stand how."""

    count: int
    queued: int = 0
    succeeded: int = 0
    failed: int = 0
    cancelled: int = 0


class Job(Model):
    """A job, as the service described it at one moment."""

    id: str
    state: str
    """queued, running, succeeded, failed or cancelled."""
    progress: JobProgress = Field(default_factory=JobProgress)
    queue_position: int | None = None
    """Jobs that go before it, if it is queued."""
    eta: dict[str, Any] | None = None
    """``start_s`` and ``end_s``, None where unknown, and the ``basis`` of the guess."""
    cached: bool = False
    """Whether an earlier job's result is the answer."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """As given."""
    frames: FrameCounts | None = None
    """None for a job of one image."""
    attempts: int = 0
    labels: dict[str, str] = Field(default_factory=dict)
    created_at: datetime | None = None
    finished_at: datetime | None = None
    error: dict[str, Any] | None = None
    warnings: list[str] = Field(default_factory=list)
    complete: bool | None = None
    """False for the partial image of a cancelled job; None without an image."""
    outputs: list[Output] = Field(default_factory=list)
    stats: dict[str, Any] | None = None
    links: dict[str, str] = Field(default_factory=dict)

    @property
    def is_final(self) -> bool:
        """Whether the job has ended."""
        return is_final(self.state)

    @property
    def error_text(self) -> str | None:
        """Why it failed, in one line."""
        if not self.error:
            return None
        return str(ServerError(0, self.error))


class JobPage(Model):
    """One page of jobs, newest first."""

    items: list[Job]
    next_cursor: str | None = None


class Delivery(Model):
    """One message to a webhook."""

    id: str
    """The header `webhook-id`."""
    event: str
    """job.succeeded, job.failed or job.cancelled."""
    state: str
    """pending, delivered or failed."""
    attempts: int
    created_at: datetime | None = None
    last_attempt_at: datetime | None = None
    next_attempt_at: datetime | None = None
    status: int | None = None
    """HTTP status of the last answer."""
    error: str | None = None
    """Why the last attempt did not deliver it."""


class Deliveries(Model):
    """What the webhook of a job has been told, newest first."""

    webhook: dict[str, Any] | None = None
    """``url``, ``events``, ``disabled_at``; None if the job has none."""
    items: list[Delivery] = Field(default_factory=list)


@dataclass(frozen=True)
class Event:
    """One server-sent event of a job."""

    type: str
    """state, progress or preview."""
    data: Any
    """The decoded JSON, or the text if it is none."""
    id: str | None = None


class EventDecoder:
    """Turns the text of an event stream into events (WHATWG HTML, section 9.2.6)."""

    def __init__(self, last_id: str | None = None) -> None:
        self.last_id = last_id
        """The id of the last event that arrived whole."""
        self._id = last_id
        self._type = ""
        self._data: list[str] = []
        self._rest = ""

    def feed(self, text: str) -> list[Event]:
        """Take a piece of the stream, cut anywhere; gives the events that it completes."""
        text = self._rest + text
        # A carriage return at the end may be the first half of a line end.
        held = "\r" if text.endswith("\r") else ""
        *lines, self._rest = _LINE_END.split(text.removesuffix(held))
        self._rest += held
        events = (self._line(line) for line in lines)
        return [event for event in events if event is not None]

    def reset(self) -> None:
        """Drop a half-received event (the connection was lost); the last id stays."""
        self._id = self.last_id
        self._type, self._data, self._rest = "", [], ""

    def _line(self, line: str) -> Event | None:
        if not line:
            return self._dispatch()
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._type = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._id = value or None
        return None

    def _dispatch(self) -> Event | None:
        text, kind, had_data = "\n".join(self._data), self._type or "message", bool(self._data)
        self._type, self._data = "", []
        self.last_id = self._id
        if not had_data:
            return None
        try:
            data = json.loads(text)
        except ValueError:
            data = text
        return Event(kind, data, self.last_id)
