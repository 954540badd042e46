"""Checksums in headers: `Repr-Digest` and `Content-Digest` (RFC 9530), and those of tus."""

from __future__ import annotations

import base64
import binascii
import re

from raykiln_service.errors import MalformedRequestError
from raykiln_service.uploads import CHECKSUMS, Checksum

_SHA256 = re.compile(r"(?:^|,)\s*sha-256\s*=\s*:([A-Za-z0-9+/=]*):", re.IGNORECASE)
_HEX = re.compile(r"[0-9a-f]{64}")


def sha256_of_digest(header: str | None, name: str) -> str | None:
    """The SHA-256 in hex that a digest header gives; None if it gives only other hashes."""
    found = None if header is None else _SHA256.search(header)
    if found is None:
        if "sha-256" in (header or "").lower():
            # Passed over in silence, bytes would count as checked that nobody has checked.
            raise MalformedRequestError(
                f"{name}: not a SHA-256", found=header, accepted="sha-256=:BASE64:"
            )
        return None
    digest = decoded(found[1], name)
    if len(digest) != 32:
        raise MalformedRequestError(f"{name}: not a SHA-256", accepted="sha-256=:BASE64:")
    return digest.hex()


def sha256_in_hex(text: str, where: str) -> str:
    """A SHA-256 given in hex, with or without `sha256:` before it."""
    digest = text.strip().lower().removeprefix("sha256:")
    if _HEX.fullmatch(digest) is None:
        raise MalformedRequestError(
            f"{where}: not a SHA-256", found=text[:100], accepted="64 digits in hex"
        )
    return digest


def piece_checksum(header: str | None) -> Checksum | None:
    """What tus's `Upload-Checksum` says."""
    if header is None:
        return None
    algorithm, _, text = header.strip().partition(" ")
    if algorithm not in CHECKSUMS:
        raise MalformedRequestError(
            "Upload-Checksum: no such algorithm",
            found=algorithm[:100],
            accepted=", ".join(CHECKSUMS),
        )
    return Checksum(algorithm, decoded(text, "Upload-Checksum"))


def decoded(text: str, where: str) -> bytes:
    """Bytes from Base64; `MalformedRequestError` names the header."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise MalformedRequestError(f"{where}: not Base64", found=text[:100]) from None
