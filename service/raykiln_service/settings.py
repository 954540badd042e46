"""The settings of the service, with their defaults."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, SecretStr, ValidationError

from raykiln_service.errors import StartupError

_GIB = 1 << 30


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
    """Bearer token that every call must carry."""
    insecure: bool = False
    """Allow an address that is not loopback without a token."""
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
    request_timeout_s: Annotated[float, Field(gt=0)] = 30.0
    """Time for a request to arrive; long bodies get more, by their length."""
    check_timeout_s: Annotated[float, Field(gt=0)] = 120.0
    """Longest check of a submitted scene."""
    check_memory_bytes: Annotated[int, Field(ge=1 << 28)] = 16 * _GIB
    """Address space of a scene check."""
    max_queued: Annotated[int, Field(ge=1)] = 100_000
    """Jobs that may wait; more are answered with 429."""
    max_attempts: Annotated[int, Field(ge=1, le=100)] = 3
    """Attempts of a job that crashes its render process."""
    lease_s: Annotated[float, Field(gt=0)] = 30.0
    """After this time without a heartbeat an attempt counts as lost."""
    heartbeat_s: Annotated[float, Field(gt=0)] = 2.0
    """Time between heartbeats of a running attempt."""
    checkpoint_interval_s: Annotated[float, Field(ge=0)] = 5.0
    """Render time between checkpoints (they are written at pass ends)."""
    log_format: Literal["auto", "json", "console"] = "auto"
    """How the log looks; auto = console on a terminal, JSON lines otherwise."""

    @classmethod
    def create(cls, **values: Any) -> ServiceSettings:
        """Settings from the given values (None = not given), then `RAYKILN_TOKEN`, then defaults.

        Raises
        ------
        StartupError
            Names the first bad value.
        """
        given = {name: value for name, value in values.items() if value is not None}
        if "token" not in given and os.environ.get("RAYKILN_TOKEN"):
            given["token"] = os.environ["RAYKILN_TOKEN"]
        try:
            return cls(**given)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(map(str, first["loc"])) or "settings"
            shown = "" if name == "token" else f" (found {first.get('input')!r})"
            raise StartupError(f"{name}: {first['msg']}{shown}") from None

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host.strip("[]")).is_loopback
        except ValueError:
            return False

    def check_exposure(self) -> None:
        """Refuse to listen for others without a token."""
        if self.is_loopback or self.token is not None or self.insecure:
            return
        raise StartupError(
            f"host {self.host} can be reached from other machines, so a token is required: "
            "set RAYKILN_TOKEN (or allow it with --insecure)"
        )
