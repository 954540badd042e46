"""How much of the machine a render child may take."""

from __future__ import annotations

import contextlib
import os
import resource
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

# What a process holds besides its job: the interpreter, libraries, and a stack for each thread.
OWN_BYTES = (256 << 20) + (16 << 20) * (os.cpu_count() or 1)
# Nothing that is rendered is as large; what a scene might make endless ends here.
MAX_FILE_BYTES = 32 << 30
_LEAST_JOB_BYTES = 512 << 20
_JOBS_SHARE, _WARM_SHARE = 0.75, 0.125
_CGROUP_FILES = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)
_PAGE_BYTES = resource.getpagesize()

Sandbox = Literal["auto", "require", "off"]


def machine_memory_bytes() -> int:
    """Memory of the machine, or of the container if that has less."""
    found = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        found.append(int(Path("/proc/meminfo").read_text().split()[1]) << 10)
    for name in _CGROUP_FILES:
        with contextlib.suppress(OSError, ValueError):
            found.append(int(Path(name).read_text()))
    return min(found, default=8 << 30)


def default_job_memory(slots: int) -> int:
    """What a job may take if nobody said: its slot's share of three quarters of the machine."""
    return max(_LEAST_JOB_BYTES, int(machine_memory_bytes() * _JOBS_SHARE) // slots)


def default_warm_memory() -> int:
    """What idle children may hold if nobody said: an eighth of the machine."""
    return int(machine_memory_bytes() * _WARM_SHARE)


@dataclass(frozen=True, slots=True)
class Limits:
    """What render children may take.  Sizes are bytes, times seconds."""

    memory_bytes: int = field(default_factory=lambda: default_job_memory(1))
    """Of one job, besides `OWN_BYTES`."""
    silence_s: float = 120.0
    """A child that renders and says nothing for so long has hung; ten times that while it loads
    or writes, where it has nothing to say."""
    warm_scenes: int = 4
    """Idle children that are kept for the scene that they have loaded."""
    warm_memory_bytes: int = field(default_factory=default_warm_memory)
    """Memory that idle children may hold together."""
    sandbox: Sandbox = "auto"


def private_bytes(pid: int) -> int:
    """Memory that a process holds for itself alone; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/statm").read_text().split()
    except OSError:
        return 0
    return (int(fields[1]) - int(fields[2])) * _PAGE_BYTES
