"""Child processes: one job each, with its wall time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Result = dict[str, Any]
TIMEOUT_S = 1800.0


class ChildFailedError(Exception):
    """A renderer's process ended without a result; the text holds its last words."""


@dataclass(frozen=True)
class Children:
    """Starts the programs that run one renderer each."""

    work: Path
    peers_python: Path

    def run(self, engine: str, job: dict[str, Any]) -> Result:
        """Run one job; the result also has `wall_s`, from the start of the process to its end."""
        path, result = self.work / "job.json", self.work / "result.json"
        result.unlink(missing_ok=True)
        path.write_text(json.dumps({**_DEFAULTS, **job, "result": str(result)}))
        program = Path(__file__).with_name(f"run_{engine}.py")
        wall_s, status = self._spawn([self._python(engine), str(program), str(path)])
        if status != 0 or not result.is_file():
            log = (self.work / "child.log").read_text(errors="replace")[-2000:]
            raise ChildFailedError(f"{engine} ended with status {status}:\n{log}")
        outcome: Result = json.loads(result.read_text())
        return {**outcome, "wall_s": wall_s}

    def _python(self, engine: str) -> str:
        return sys.executable if engine in ("raykiln", "replay") else str(self.peers_python)

    def _spawn(self, command: list[str]) -> tuple[float, int]:
        # A home of their own: what the peers cache (compiled kernels) stays in the work folder.
        home = self.work / "home"
        home.mkdir(exist_ok=True)
        variables = {**os.environ, "HOME": str(home)}
        # What pip installs comes with its bytecode; an editable install makes its own.
        variables.pop("PYTHONDONTWRITEBYTECODE", None)
        with (self.work / "child.log").open("wb") as log:
            start = time.perf_counter()
            child = subprocess.Popen(command, stdout=log, stderr=log, env=variables)
            # Waiting with a time limit would look only every 50 ms.
            limit = threading.Timer(TIMEOUT_S, child.kill)
            limit.start()
            try:
                child.wait()
            except BaseException:
                child.kill()
                child.wait()
                raise
            finally:
                limit.cancel()
            wall_s = time.perf_counter() - start
        if wall_s >= TIMEOUT_S:
            raise ChildFailedError(f"no result within {TIMEOUT_S:.0f} s: {command}")
        return wall_s, child.returncode

    def import_s(self, engine: str) -> float:
        """Seconds to import a renderer in a fresh interpreter, without those of the interpreter."""
        statement = {
            "raykiln": "import raykiln",
            "mitsuba": "import mitsuba; mitsuba.set_variant('llvm_ad_rgb')",
            "cycles": "import bpy",
            "luxcore": "import pyluxcore",
        }[engine]
        python = self._python(engine)
        empty = min(self._spawn([python, "-c", "pass"])[0] for _ in range(3))
        return self._spawn([python, "-c", statement])[0] - empty


_DEFAULTS = {
    "task": "render",
    "seed": 0,
    "rr": -1,
    "sampler": None,
    "watertight": False,
    "variant": None,
    "threads": 2,
    "image": None,
    "exr": None,
}


def image_of(path: Path) -> NDArray[np.float32]:
    """The pixels (height, width, 3) that a child wrote."""
    image: NDArray[np.float32] = np.load(path)
    return image
