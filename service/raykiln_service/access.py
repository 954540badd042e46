"""Who asks, what they may do, and how much of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum


class Scope(StrEnum):
    """A right that a token carries.  `admin` holds all the others."""

    READ = "read"
    """Look at one's own jobs, results and uploads."""
    SUBMIT = "submit"
    """Upload, and submit jobs."""
    MANAGE = "manage"
    """Cancel, retry and delete one's own jobs; end one's own uploads."""
    ADMIN = "admin"
    """Everything, and for the jobs of everybody; the queue itself."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The quotas of one token; None = no limit."""

    queued_jobs: int | None = None
    """Jobs that wait or run at a time."""
    stored_bytes: int | None = None
    """Uploads that are kept, and the announced sizes of those under way."""
    queued_samples: int | None = None
    """Pixel samples of the jobs that wait or run."""
    samples_per_day: int | None = None
    """Pixel samples of the jobs submitted in the last 24 hours."""
    requests_per_minute: int | None = None

    def over(self, defaults: Limits) -> Limits:
        """These limits, with the unset ones taken from `defaults`."""
        chosen = {}
        for name in (field.name for field in fields(self)):
            own = getattr(self, name)
            chosen[name] = getattr(defaults, name) if own is None else own
        return Limits(**chosen)


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sent a request.

    Parameters
    ----------
    owner
        Id of the token, by which jobs and uploads are its own; None for the service's own token
        and for calls without one, which own nothing and may see everything.
    """

    owner: str | None
    name: str
    scopes: frozenset[Scope]
    limits: Limits = Limits()

    @property
    def sees_all(self) -> bool:
        """Whether the jobs and uploads of others are visible."""
        return Scope.ADMIN in self.scopes

    def may(self, scope: Scope) -> bool:
        """Whether the caller has a right."""
        return scope in self.scopes or Scope.ADMIN in self.scopes


EVERYTHING = frozenset(Scope)
LOCAL = Caller(None, "local", EVERYTHING)
"""Whoever calls a service that asks for no token."""
STATIC = Caller(None, "RAYKILN_TOKEN", EVERYTHING)
"""Whoever has the service's own token."""
NOBODY = Caller(None, "nobody", frozenset())
"""Whoever asks for a page that is open to all."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a submission comes from."""

    caller: Caller = LOCAL
    key: str | None = None
    """The `Idempotency-Key`, if one came."""
    digest: str = ""
    """Hash of the request, to tell a repeat from another request with the same key."""
    pixel_samples: int = 0
    """What the job takes at most."""
