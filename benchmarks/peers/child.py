"""What the programs that run one renderer share: a job comes as JSON, a result goes as JSON.

A job: `task` ("render", "whole" or "load"), `scene` (its folder), `size`, `depth`, `spp`, `seed`,
`rr` (None: the renderer's own default; -1: never), `sampler`, `threads`, `variant`, `result` (the
JSON to write), `image` (a .npy, or None), `exr` (an .exr, for a whole process).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Job = dict[str, Any]


def job() -> Job:
    """The job named on the command line."""
    loaded: Job = json.loads(Path(sys.argv[-1]).read_text())
    return loaded


def finish(given: Job, result: dict[str, Any]) -> None:
    """Write the result, with the peak memory of this process."""
    Path(given["result"]).write_text(json.dumps({**result, "peak_bytes": peak_bytes()}))


def peak_bytes() -> int:
    """The most memory that this program has had.

    Not `ru_maxrss`, which begins with the size of the process that started this one.
    """
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


class Clock:
    """Seconds by phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the seconds within to a phase."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
