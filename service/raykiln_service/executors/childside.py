"""What every child process does: its end of the pipes, and the limits it puts on itself."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import resource
import signal
import sys
import threading
from typing import Any, BinaryIO

from raykiln_service.sandbox import Confinement, confine, missing_layers
from raykiln_service.sandbox.kernel import PR_SET_PDEATHSIG, prctl

OUT_OF_MEMORY = "out-of-memory"
_FIELDS = ("file", "pointer", "found", "accepted")


class Channel:
    """Messages from and to the supervisor.

    Whatever else prints to standard output lands in the error output, so it cannot be taken for
    a message.  When the supervisor goes away, the process ends at once.

    Parameters
    ----------
    listen
        Take messages from now on, in a thread of its own; False = after `listen`.
    """

    def __init__(self, *, listen: bool = True) -> None:
        self._parent = int(sys.argv[1])
        die_with(self._parent)
        self.inbox: queue.Queue[dict[str, Any]] = queue.Queue()
        self._stops: dict[str, str] = {}
        self._lock = threading.Lock()
        self._out: BinaryIO = os.fdopen(os.dup(1), "wb")
        self._rest = b""
        os.dup2(2, 1)
        if listen:
            self.listen()

    def listen(self) -> None:
        """Take messages from now on, in a thread of its own."""
        threading.Thread(target=self._listen, daemon=True).start()

    def first(self) -> dict[str, Any]:
        """The first message, while there is only one thread; call it before `listen`."""
        while b"\n" not in self._rest:
            self._rest += self._read()
        line, _, self._rest = self._rest.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def send(self, **message: Any) -> None:
        """Send a message."""
        data = json.dumps(message, default=str).encode() + b"\n"
        with self._lock:
            self._out.write(data)
            self._out.flush()

    def stop_reason(self, token: str) -> str | None:
        """Why the supervisor asked for the end of the task with this token, if it did."""
        return self._stops.get(token)

    def confine(self, message: dict[str, Any]) -> None:
        """Confine the process as a first message says; it ends if that cannot be done wholly."""
        wanted = message["confine"]
        limits = Confinement.of(wanted["limits"])
        report = confine(limits, only_limits=wanted["sandbox"] == "off")
        # A new set of rights makes the kernel forget whom the process is to follow.
        die_with(self._parent)
        if wanted["sandbox"] == "require" and (missing := missing_layers(report)):
            text = "; ".join(f"{name}: {why}" for name, why in missing.items())
            raise SystemExit(f"the process cannot be confined: {text}")

    def _listen(self) -> None:
        # Not by sys.stdin: its lock, held while waiting, would abort a Python that exits.
        while True:
            *lines, self._rest = self._rest.split(b"\n")
            for line in lines:
                message = json.loads(line)
                if message["type"] == "stop":
                    self._stops[message["token"]] = message["reason"]
                else:
                    self.inbox.put(message)
            self._rest += self._read()

    def _read(self) -> bytes:
        piece = os.read(0, 1 << 16)
        if not piece:
            os._exit(0)
        return piece


def die_with(parent: int) -> None:
    """Have the kernel end this process with its parent."""
    with contextlib.suppress(OSError, AttributeError):
        prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
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


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether an allocation that failed is behind an error."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        text = str(error)
        if isinstance(error, MemoryError) or "not enough memory" in text or "bad_alloc" in text:
            return True
        error = error.__cause__ or error.__context__
    return False


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
