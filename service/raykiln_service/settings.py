"""The settings of the service, with their defaults."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, SecretStr, ValidationError, field_validator

from raykiln_service.access import Limits
from raykiln_service.errors import StartupError
from raykiln_service.webhooks.signatures import key_of

_GIB = 1 << 30
_LISTS = {"allowed_hosts"}
_SECRETS = {"token", "webhook_secret"}
# A pause that is longer was written by a clock that was ahead.
MAX_DELAY_S = 300.0


class ServiceSettings(BaseModel):
    """How the service runs.  Sizes are bytes, times seconds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    """Address to listen on; anything but loopback needs a token."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on; 0 = any free one."""
    data_dir: Path = Path("raykiln-data")
    """Folder of the database, assets and results; made if missing."""
    database_url: str | None = None
    """SQLAlchemy URL; None = SQLite in the data folder."""
    slots: Annotated[int, Field(ge=1, le=256)] = 1
    """Jobs rendered at the same time."""
    executor: Literal["local"] = "local"
    """Where units are rendered: supervised child processes of this machine."""
    token: SecretStr | None = None
    """Bearer token that may do everything; `raykiln token` makes those that may do less."""
    require_token: bool = False
    """Ask for a token on a loopback address too (behind a proxy that lets others in)."""
    insecure: bool = False
    """Allow an address that is not loopback without a token."""
    token_queued_jobs: Annotated[int, Field(ge=1)] | None = 10_000
    """Jobs of one token that may wait or run, unless the token has a limit of its own."""
    token_stored_bytes: Annotated[int, Field(ge=1)] | None = 100 * _GIB
    """Bytes of uploads of one token."""
    token_queued_samples: Annotated[int, Field(ge=1)] | None = 10**13
    """Pixel samples of one token's jobs that wait or run."""
    token_samples_per_day: Annotated[int, Field(ge=1)] | None = 10**14
    """Pixel samples that one token may submit in 24 hours."""
    token_requests_per_minute: Annotated[int, Field(ge=1)] | None = 6_000
    """Requests of one token."""
    allowed_hosts: tuple[str, ...] = ()
    """Further names by which a loopback service without a token may be called (its own proxy)."""
    max_json_bytes: Annotated[int, Field(ge=1)] = 64 << 20
    """Largest body of a request other than an upload."""
    max_asset_bytes: Annotated[int, Field(ge=1)] = 2 * _GIB
    """Largest upload."""
    max_bundle_bytes: Annotated[int, Field(ge=1)] = 8 * _GIB
    """Largest unpacked size of a zip bundle."""
    max_bundle_entries: Annotated[int, Field(ge=1)] = 20_000
    """Most files in a zip bundle."""
    max_bundle_ratio: Annotated[float, Field(ge=1)] = 200.0
    """Largest unpacked size of a bundle's file over its packed size."""
    upload_expiry_s: Annotated[float, Field(gt=0)] = 24 * 3600.0
    """An unfinished resumable upload is dropped when nothing has come for so long."""
    max_connections: Annotated[int, Field(ge=1)] = 4096
    """Connections at a time; more are answered with 503."""
    request_timeout_s: Annotated[float, Field(gt=0)] = 30.0
    """Time for a request to arrive; long bodies get more, by their length."""
    check_timeout_s: Annotated[float, Field(gt=0)] = 120.0
    """Longest check of a submitted scene."""
    check_memory_bytes: Annotated[int, Field(ge=1 << 26)] | None = None
    """Memory of a scene check; None = as much as a job may take."""
    sandbox: Literal["auto", "require", "off"] = "auto"
    """Confinement of the processes that read scenes: as far as the machine can, wholly or not at
    all to start, or none."""
    job_memory_bytes: Annotated[int, Field(ge=1 << 26)] | None = None
    """Memory that one job may take; None = a slot's share of three quarters of the machine."""
    max_job_s: Annotated[float, Field(gt=0)] | None = None
    """Longest time that a job may take on a slot, all attempts together; None = no limit."""
    silence_timeout_s: Annotated[float, Field(gt=0)] = 120.0
    """A render process that says nothing for so long is ended; loading and writing get ten times
    that."""
    warm_scenes: Annotated[int, Field(ge=0, le=1000)] = 4
    """Scenes that stay in memory for further jobs; 0 = none."""
    warm_memory_bytes: Annotated[int, Field(ge=0)] | None = None
    """Memory that these may take together; None = an eighth of the machine."""
    priority_step_s: Annotated[float, Field(ge=0, le=1e6)] = 600.0
    """Waiting that one level of priority is worth; nothing waits for ever."""
    retry_delay_s: Annotated[float, Field(ge=0)] = 1.0
    """Pause after the first lost attempt of a job; each further one doubles it."""
    retry_delay_max_s: Annotated[float, Field(ge=0, le=MAX_DELAY_S)] = 60.0
    """Longest such pause."""
    result_cache: bool = True
    """Answer a job with the result of an identical one, if it is there."""
    keep_results_s: Annotated[float, Field(ge=0)] | None = None
    """Ended jobs are removed with their results after this time; None = never."""
    keep_assets_s: Annotated[float, Field(ge=0)] | None = None
    """Uploads that no job refers to are removed this long after their last use; None = never."""
    max_results_bytes: Annotated[int, Field(ge=0)] | None = None
    """Size of all jobs' folders past which the oldest ended jobs are removed; None = no limit."""
    max_assets_bytes: Annotated[int, Field(ge=0)] | None = None
    """Size of all uploads past which those without a job are removed; None = no limit."""
    gc_interval_s: Annotated[float, Field(gt=0)] = 600.0
    """Time between clean-ups."""
    max_queued: Annotated[int, Field(ge=1)] = 100_000
    """Jobs that may wait; more are answered with 429."""
    max_frames: Annotated[int, Field(ge=1, le=100_000)] = 2000
    """Frames that one job may ask for."""
    max_attempts: Annotated[int, Field(ge=1, le=100)] = 3
    """Attempts of a job that crashes its render process."""
    lease_s: Annotated[float, Field(gt=0)] = 30.0
    """After this time without a heartbeat an attempt counts as lost."""
    heartbeat_s: Annotated[float, Field(gt=0)] = 2.0
    """Time between heartbeats of a running attempt."""
    checkpoint_interval_s: Annotated[float, Field(ge=0)] = 5.0
    """Render time between checkpoints (they are written at pass ends)."""
    webhook_secret: SecretStr | None = None
    """Key of the signatures of webhooks that bring none of their own."""
    webhook_allow_private: bool = False
    """Whether webhooks may lead to private and loopback addresses, and to any port."""
    webhook_timeout_s: Annotated[float, Field(gt=0, le=20)] = 10.0
    """Time for one delivery in all."""
    webhook_max_attempts: Annotated[int, Field(ge=1, le=100)] = 12
    """Deliveries of a message that is not accepted are given up after so many."""
    webhook_retry_delay_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """Pause after the first delivery that failed; each further one makes it four times as long."""
    webhook_retry_delay_max_s: Annotated[float, Field(gt=0, le=24 * 3600)] = 6 * 3600.0
    """Longest such pause."""
    trace_endpoint: str | None = None
    """URL of an OpenTelemetry collector (OTLP over HTTP); needs the extra `telemetry`."""
    log_format: Literal["auto", "json", "console"] = "auto"
    """How the log looks; auto = console on a terminal, JSON lines otherwise."""

    @field_validator("webhook_secret")
    @classmethod
    def _is_key(cls, secret: SecretStr | None) -> SecretStr | None:
        if secret is not None:
            key_of(secret.get_secret_value())
        return secret

    @classmethod
    def create(cls, **values: Any) -> ServiceSettings:
        """Settings from the given values (None = not given), then the environment, then defaults.

        The variable of a setting is its name in capitals after ``RAYKILN_``; lists are separated
        by commas.

        Raises
        ------
        StartupError
            Names the first bad value.
        """
        given = {name: value for name, value in values.items() if value is not None}
        for name in cls.model_fields:
            text = os.environ.get(f"RAYKILN_{name.upper()}")
            if text and name not in given:
                given[name] = text.split(",") if name in _LISTS else text
        try:
            return cls(**given)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(map(str, first["loc"])) or "settings"
            shown = "" if name in _SECRETS else f" (found {first.get('input')!r})"
            raise StartupError(f"{name}: {first['msg']}{shown}") from None

    def retry_pause_s(self, failures: int) -> float:
        """How long a job waits that was lost after `failures` earlier failures."""
        return min(self.retry_delay_max_s, self.retry_delay_s * 2.0 ** min(failures, 60))

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host.strip("[]")).is_loopback
        except ValueError:
            return False

    @property
    def token_limits(self) -> Limits:
        """The limits of tokens that have none of their own."""
        return Limits(
            queued_jobs=self.token_queued_jobs,
            stored_bytes=self.token_stored_bytes,
            queued_samples=self.token_queued_samples,
            samples_per_day=self.token_samples_per_day,
            requests_per_minute=self.token_requests_per_minute,
        )

    @property
    def asks_for_token(self) -> bool:
        """Whether a call without a token is refused."""
        if self.token is not None or self.require_token:
            return True
        return not self.is_loopback and not self.insecure

    def check_exposure(self, has_tokens: bool = False) -> None:
        """Refuse to listen where every call would be refused.

        Parameters
        ----------
        has_tokens
            Whether the database has a token that would be let in.
        """
        if not self.asks_for_token or self.token is not None or has_tokens:
            return
        why = (
            f"host {self.host} can be reached from other machines, so a token is required"
            if not self.require_token
            else "a token is required, and there is none"
        )
        raise StartupError(
            f"{why}: make one with 'raykiln token create', or set RAYKILN_TOKEN "
            "(or allow calls without one by --insecure)"
        )
