"""The process that finds out which layers of the sandbox hold on this machine."""

from __future__ import annotations

from raykiln_service.executors.childside import Channel
from raykiln_service.sandbox import Confinement, confine


def main() -> None:
    """Confine this process as a render child would, and tell how far that went."""
    channel = Channel(listen=False)
    writable = tuple(channel.first()["writable"])
    limits = Confinement((), writable, memory_bytes=1 << 30, file_bytes=1 << 30)
    channel.send(type="layers", layers=confine(limits))


if __name__ == "__main__":
    main()
