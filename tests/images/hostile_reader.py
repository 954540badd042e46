"""Read image files, each in a process of its own; print how each one ended as a JSON line.

Usage: hostile_reader.py MEMORY_LIMIT_BYTES FILE...
"""

from __future__ import annotations

import json
import os
import resource
import sys

from raykiln.errors import ImageError
from raykiln.image import read_exr_layers, read_image


def read(path: str) -> str:
    outcomes = []
    for reader in (read_image, read_exr_layers):
        try:
            reader(path)
            outcomes.append("image")
        except ImageError as error:
            outcomes.append(f"ImageError {error}")
    return " | ".join(outcomes)


def read_in_child(path: str, memory_limit: int) -> str:
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (memory_limit, memory_limit))
        os.write(send, read(path).encode())
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as pipe:
        outcome = pipe.read().decode()
    _, status = os.waitpid(child, 0)
    return outcome if status == 0 else f"crashed with status {status}"


if __name__ == "__main__":
    for name in sys.argv[2:]:
        print(json.dumps([name, read_in_child(name, int(sys.argv[1]))]), flush=True)
