"""Names that are not taken yet."""

from __future__ import annotations

from collections.abc import Collection

MAX_LENGTH = 200


def unique_name(wanted: str, taken: Collection[str]) -> str:
    """`wanted` (shortened if need be), with a number behind it if it is taken."""
    wanted = wanted[:MAX_LENGTH]
    # So many names are taken at most, which keeps the search short among equal names.
    name, number = wanted, len(taken) + 1
    while name in taken:
        name = f"{wanted}_{number}"
        number += 1
    return name
