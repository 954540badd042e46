"""Where deliveries may go: which URLs, and which addresses behind their names.

A name is looked up once for each delivery, every address that it has is checked, and the
connection goes to a checked address; so a name that points elsewhere a moment later gains nothing.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

MAX_URL = 2000
_DEFAULT_PORTS = {"http": 80, "https": 443}
_FIRST_FREE_PORT = 1024
_PRINTABLE = re.compile(r"[\x21-\x7e]+")
_NAME = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)(\.(?!-)[A-Za-z0-9_-]{1,63}(?<!-))*\.?")
# A last label that is a number makes resolvers read the whole as an IPv4 address in other forms.
_NUMBER = re.compile(r"(0[xX][0-9A-Fa-f]*|[0-9]+)")
_INNER_NAMES = ("localhost", "local", "internal", "home.arpa")
# IPv6 ranges that carry an IPv4 address to somewhere else.
_CARRIERS = [
    ipaddress.ip_network(text)
    for text in ("::/96", "64:ff9b::/96", "64:ff9b:1::/48", "2001::/32", "2002::/16")
]
# What tells a cloud's machines who they are; not all of it lies in reserved ranges.
_METADATA = frozenset(
    ipaddress.ip_address(text)
    for text in ("169.254.169.254", "100.100.100.200", "168.63.129.16", "fd00:ec2::254")
)


class ForbiddenTargetError(Exception):
    """No delivery goes to this URL or address."""


@dataclass(frozen=True, slots=True)
class Target:
    """A URL in its parts."""

    scheme: str
    host: str
    """As in a certificate: a name in lower case, or an address without brackets."""
    port: int
    path: str
    """With the query."""

    @property
    def authority(self) -> str:
        """Host and port as the header `Host` has them; also what names a receiver."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == _DEFAULT_PORTS[self.scheme] else f"{host}:{self.port}"

    @property
    def shown(self) -> str:
        """The URL without its query, which may be a secret."""
        return f"{self.scheme}://{self.authority}{self.path.partition('?')[0]}"


def parse_url(url: str, *, allow_private: bool = False) -> Target:
    """The parts of a URL; `ForbiddenTargetError` says why nothing may be sent there.

    Parameters
    ----------
    allow_private
        Whether private and loopback addresses, and any port, are allowed.
    """
    if len(url) > MAX_URL or not _PRINTABLE.fullmatch(url) or "\\" in url:
        raise ForbiddenTargetError(f"a URL is 1 to {MAX_URL} printable ASCII characters")
    try:
        parts = urlsplit(url)
        port = parts.port
        host = (parts.hostname or "").lower()
    except ValueError as error:
        raise ForbiddenTargetError(f"this is no URL: {error}") from None
    if parts.scheme not in _DEFAULT_PORTS:
        raise ForbiddenTargetError("the URL has to begin with https:// or http://")
    if parts.username is not None or parts.password is not None:
        raise ForbiddenTargetError("the URL must not hold a user name or a password")
    if parts.fragment:
        raise ForbiddenTargetError("the URL must not have a fragment")
    port = _DEFAULT_PORTS[parts.scheme] if port is None else port
    _check_host(host, allow_private)
    if not allow_private and port not in _DEFAULT_PORTS.values() and port < _FIRST_FREE_PORT:
        raise ForbiddenTargetError(f"port {port} is not 80, 443 or at least {_FIRST_FREE_PORT}")
    if port == 0:
        raise ForbiddenTargetError("there is no port 0")
    query = f"?{parts.query}" if parts.query else ""
    return Target(parts.scheme, host, port, (parts.path or "/") + query)


def _check_host(host: str, allow_private: bool) -> None:
    literal = _literal(host)
    if literal is not None:
        check_address(literal, allow_private=allow_private)
        return
    if not _NAME.fullmatch(host) or len(host) > 253:
        raise ForbiddenTargetError("the URL has no valid host")
    labels = host.rstrip(".").split(".")
    if _NUMBER.fullmatch(labels[-1]):
        raise ForbiddenTargetError("an IPv4 address is four decimal numbers, as in 203.0.113.7")
    name = host.rstrip(".")
    is_inner = any(name == inner or name.endswith(f".{inner}") for inner in _INNER_NAMES)
    if is_inner and not allow_private:
        raise ForbiddenTargetError(f"{name[:100]} is a name of a private network")


def _literal(host: str) -> Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def check_address(address: Address, *, allow_private: bool = False) -> None:
    """`ForbiddenTargetError` if nothing may be sent to an address."""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            check_address(address.ipv4_mapped, allow_private=allow_private)
            return
        is_carrier = any(address in network for network in _CARRIERS)
        if address.scope_id is not None or (is_carrier and not address.is_loopback):
            raise ForbiddenTargetError(f"{address} leads to other networks")
    never = (
        address in _METADATA
        or address.is_multicast
        or address.is_unspecified
        or address.is_link_local
        or (address.is_reserved and not address.is_loopback)
    )
    if never or not (allow_private or address.is_global):
        raise ForbiddenTargetError(f"{address} is not an address of the public internet")


def resolve(target: Target, *, allow_private: bool = False) -> list[str]:
    """The addresses of a target's host, all of them checked, in the resolver's order.

    Raises
    ------
    ForbiddenTargetError
        One of them must not be reached.
    OSError
        The name has none.
    """
    literal = _literal(target.host)
    if literal is not None:
        check_address(literal, allow_private=allow_private)
        return [str(literal)]
    found = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_STREAM)
    names = list(dict.fromkeys(str(entry[4][0]) for entry in found))
    for name in names:
        check_address(ipaddress.ip_address(name), allow_private=allow_private)
    return names
