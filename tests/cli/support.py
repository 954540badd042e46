"""What the tests of the command share."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMMAND = [sys.executable, "-m", "raykiln_service.cli"]


@dataclass(frozen=True)
class Ran:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output as JSON."""
        return json.loads(self.out)

    @property
    def error(self) -> str:
        """The error line; there must be exactly one line, and it must be one."""
        (line,) = self.err.splitlines()
        assert line.startswith("raykiln: error: ")
        return line.removeprefix("raykiln: error: ")


Run = Callable[..., Ran]


def raykiln_process(*arguments: object, cwd: Path, **options: Any) -> Ran:
    """Run one command line in a process of its own, without a terminal."""
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)],
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )
    assert "Traceback" not in done.stderr
    return Ran(done.returncode, done.stdout, done.stderr)


BOX: dict[str, Any] = {
    "settings": {"width": 24, "height": 16, "spp": 4},
    "cameras": [
        {"name": "front", "look_at": {"origin": [0, 0, 4], "target": [0, 0, 0]}},
        {"name": "top", "look_at": {"origin": [0, 4, 0.1], "target": [0, 0, 0]}},
    ],
    "materials": {"red": {"type": "diffuse", "reflectance": [0.8, 0.1, 0.1]}},
    "shapes": [{"type": "sphere", "radius": 1.0, "material": "red"}],
    "lights": [{"type": "constant", "radiance": 1.0}],
}


def write_scene(path: Path, **changes: Any) -> Path:
    """Write the small scene of these tests, with some of its parts replaced."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**BOX, **changes}))
    return path
