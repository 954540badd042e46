"""The child's end of the pipes, and the limits that a child puts on itself."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import queue
import resource
import signal
import sys
import threading
from typing import Any, BinaryIO

_PR_SET_PDEATHSIG = 1


class Channel:
    """Messages from and to the supervisor.

    Whatever else prints to standard output lands in the error output, so it cannot be taken for
    a message.  When the supervisor goes away, the process ends at once.
    """

    def __init__(self) -> None:
        _die_with(int(sys.argv[1]))
        self.inbox: queue.Queue[dict[str, Any]] = queue.Queue()
        self._stops: dict[str, str] = {}
        self._lock = threading.Lock()
        self._out: BinaryIO = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
        threading.Thread(target=self._listen, daemon=True).start()

    def send(self, **message: Any) -> None:
        """Send a message."""
        data = json.dumps(message, default=str).encode() + b"\n"
        with self._lock:
            self._out.write(data)
            self._out.flush()

    def stop_reason(self, token: str) -> str | None:
        """Why the supervisor asked for the end of the task with this token, if it did."""
        return self._stops.get(token)

    def _listen(self) -> None:
        # Not by sys.stdin: its lock, held while waiting, would abort a Python that exits.
        rest = b""
        while piece := os.read(0, 1 << 16):
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                message = json.loads(line)
                if message["type"] == "stop":
                    self._stops[message["token"]] = message["reason"]
                else:
                    self.inbox.put(message)
        os._exit(0)


def _die_with(parent: int) -> None:
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


def be_modest(nice: int) -> None:
    """Let the service go first: for the processor, and when memory runs out."""
    with contextlib.suppress(OSError):
        os.nice(nice)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("500")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def limit_memory(address_space_bytes: int) -> None:
    """Make allocations past the limit fail in this process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = (
        address_space_bytes if hard == resource.RLIM_INFINITY else min(address_space_bytes, hard)
    )
    if soft == resource.RLIM_INFINITY or limit < soft:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def describe(error: BaseException, base_dir: str) -> dict[str, Any]:
    """An error of `raykiln` as the fields of a problem, without the paths of this machine."""

    def clean(value: object) -> str | None:
        if value is None:
            return None
        text = str(value).replace(base_dir.rstrip("/") + "/", "")
        return text.replace(base_dir, ".") if base_dir != "/" else text

    fields = {name: clean(getattr(error, name, None)) for name in _FIELDS}
    detail = clean(getattr(error, "message", None) or str(error) or type(error).__name__)
    return {"detail": detail, **{k: v for k, v in fields.items() if v is not None}}


_FIELDS = ("file", "pointer", "found", "accepted")
