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
    """Write the result."""
    Path(given["result"]).write_text(json.dumps(result))


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
