"""The service's errors: one small tree, in which the HTTP status belongs to the class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class ServiceError(Exception):
    """Base of every error that the service raises on purpose.

    Parameters
    ----------
    detail
        What went wrong this time, in one sentence.
    pointer, found, accepted
        Where in the request or the scene, what stands there, what could stand there instead.
    file
        The file of an asset in which it was found.
    limit
        Name of the limit that is reached.
    headers
        Further headers of the reply.
    """

    status = 500
    slug = "internal-error"
    title = "Something inside the service went wrong"

    def __init__(
        self,
        detail: str = "",
        *,
        pointer: str | None = None,
        found: str | None = None,
        accepted: str | None = None,
        file: str | None = None,
        limit: str | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        self.detail = detail or self.title
        self.pointer = pointer
        self.found = found
        self.accepted = accepted
        self.file = file
        self.limit = limit
        self.headers = dict(headers or {})
        super().__init__(self.detail)

    def problem(self) -> dict[str, Any]:
        """The `application/problem+json` document (RFC 9457)."""
        document: dict[str, Any] = {
            "type": f"urn:raykiln:problem:{self.slug}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
        }
        for name in ("limit", "file", "pointer", "found", "accepted"):
            if (value := getattr(self, name)) is not None:
                document[name] = value
        return document


class StartupError(ServiceError):
    """The service cannot start: a used port, a locked or unwritable data folder, no token."""

    slug = "cannot-start"
    title = "The service cannot start"


class MalformedRequestError(ServiceError):
    status = 400
    slug = "malformed-request"
    title = "The request could not be read"


class UnauthorizedError(ServiceError):
    status = 401
    slug = "unauthorized"
    title = "A valid bearer token is required"

    def __init__(self, detail: str = "") -> None:
        challenge = 'Bearer realm="raykiln"'
        if detail:
            challenge += ', error="invalid_token"'
        super().__init__(detail, headers={"WWW-Authenticate": challenge})


class ForbiddenError(ServiceError):
    status = 403
    slug = "forbidden"
    title = "This request is not allowed"


class ScopeError(ForbiddenError):
    slug = "insufficient-scope"
    title = "The token does not allow this"

    def __init__(self, scope: str) -> None:
        super().__init__(
            f"this call needs a token with the scope {scope!r}",
            accepted=scope,
            headers={
                "WWW-Authenticate": (
                    f'Bearer realm="raykiln", error="insufficient_scope", scope="{scope}"'
                )
            },
        )


class NotFoundError(ServiceError):
    status = 404
    slug = "not-found"
    title = "There is no such thing"


class MethodNotAllowedError(ServiceError):
    status = 405
    slug = "method-not-allowed"
    title = "This method is not allowed here"


class RequestTimeoutError(ServiceError):
    status = 408
    slug = "request-timeout"
    title = "The request took too long to arrive"


class ConflictError(ServiceError):
    status = 409
    slug = "conflict"
    title = "The job's state does not allow this"


class IdempotencyInFlightError(ConflictError):
    slug = "idempotency-in-flight"
    title = "The same request is being worked on"


class UploadConflictError(ConflictError):
    slug = "upload-conflict"
    title = "The upload does not go on at this place"


class GoneError(ServiceError):
    status = 410
    slug = "gone"
    title = "This has been removed"


class ProtocolVersionError(ServiceError):
    status = 412
    slug = "upload-protocol"
    title = "The version of the upload protocol is not spoken here"


class TooLargeError(ServiceError):
    status = 413
    slug = "too-large"
    title = "The request is larger than the service accepts"


class MediaTypeError(ServiceError):
    status = 415
    slug = "unsupported-media-type"
    title = "This kind of content is not accepted here"


class InvalidRequestError(ServiceError):
    status = 422
    slug = "invalid-request"
    title = "The request is not valid"


class InvalidSettingsError(InvalidRequestError):
    slug = "invalid-settings"
    title = "The render settings are not valid"


class InvalidSceneError(InvalidRequestError):
    slug = "invalid-scene"
    title = "The scene cannot be rendered"


class InvalidAssetError(InvalidRequestError):
    slug = "invalid-asset"
    title = "The asset cannot be used"


class IdempotencyMismatchError(InvalidRequestError):
    slug = "idempotency-mismatch"
    title = "The idempotency key was used with another request"


class QueueFullError(ServiceError):
    status = 429
    slug = "queue-full"
    title = "The queue is full"


class QuotaError(ServiceError):
    status = 429
    slug = "quota-exceeded"
    title = "A limit of this token is reached"


class ChecksumError(ServiceError):
    # tus 1.0 has this status for bytes that do not match their checksum.
    status = 460
    slug = "checksum-mismatch"
    title = "The bytes do not match their checksum"


class UnavailableError(ServiceError):
    status = 503
    slug = "unavailable"
    title = "The service cannot take this request now"


class StorageFullError(ServiceError):
    status = 507
    slug = "storage-full"
    title = "There is no space left in the data folder"


class LeaseLostError(ServiceError):
    """The attempt that wants to commit no longer owns its job; its result must be dropped."""

    status = 409
    slug = "lease-lost"
    title = "Another attempt owns this job now"


_BY_STATUS: dict[int, type[ServiceError]] = {
    kind.status: kind
    for kind in (
        MalformedRequestError,
        UnauthorizedError,
        ForbiddenError,
        NotFoundError,
        MethodNotAllowedError,
        RequestTimeoutError,
        ConflictError,
        GoneError,
        TooLargeError,
        MediaTypeError,
        InvalidRequestError,
        UnavailableError,
    )
}


def error_of_status(status: int, detail: str, headers: Mapping[str, str] | None) -> ServiceError:
    """The error of the tree for a status that the HTTP framework raised."""
    kind = _BY_STATUS.get(status)
    if kind is None or kind is UnauthorizedError:
        error = ServiceError(detail, headers=headers)
        error.status = status
        error.slug = f"http-{status}"
        error.title = detail
        return error
    return kind(detail, headers=headers)
