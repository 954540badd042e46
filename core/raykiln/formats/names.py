"""Names that are not taken yet."""

from __future__ import annotations

from collections.abc import Container

MAX_LENGTH = 200


def unique_name(wanted: str, taken: Container[str]) -> str:
    """`wanted` (shortened if need be), with a number behind it if it is taken."""
    wanted = wanted[:MAX_LENGTH]
    name, number = wanted, 2
    while name in taken:
        name = f"{wanted}_{number}"
        number += 1
    return name
