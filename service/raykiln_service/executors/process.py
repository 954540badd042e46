"""A supervised child process that speaks JSON lines over its pipes."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO, Protocol

# A child dies with the *thread* that started it (PR_SET_PDEATHSIG), so all of them are started by
# one thread that lives as long as the process.
_SPAWNER = ThreadPoolExecutor(max_workers=1, thread_name_prefix="raykiln-spawner")
_MAX_LINE = 1 << 16
_TAIL_LINES = 20

# What a child needs of the environment.  Tokens and passwords are not among it.
_PASSED = {"HOME", "LANG", "LANGUAGE", "PATH", "TMPDIR", "TZ", "SSL_CERT_FILE"}
_PASSED_PREFIXES = ("ASAN_", "LC_", "LD_", "MALLOC_", "OIDN_", "OMP_", "PYTHON", "TBB_", "TSAN_")


class Process(Protocol):
    """What is needed of a running process: `subprocess.Popen` is one."""

    pid: int
    stdin: Any
    stdout: Any
    stderr: Any

    def poll(self) -> int | None:
        """Its exit code, negative for a signal; None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code once it has ended; `subprocess.TimeoutExpired` if it does not."""

    def kill(self) -> None:
        """SIGKILL."""


Launch = Callable[[str, Sequence[str]], Process]
"""Starts a module with arguments."""


def child_environment() -> dict[str, str]:
    """The environment of a child: nothing that it does not need."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _PASSED or name.startswith(_PASSED_PREFIXES)
    }
    # Its threads would run before the process can be confined, and are of no use to it.
    return {**kept, "OPENBLAS_NUM_THREADS": "1"}


def spawn(command: Sequence[str], stdin: int | BinaryIO = subprocess.PIPE) -> Process:
    """Start a program from the thread that lives as long as this process."""
    return _SPAWNER.submit(
        subprocess.Popen,
        command,
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        env=child_environment(),
    ).result()


def launch_python(module: str, arguments: Sequence[str]) -> Process:
    """Start a module in a fresh interpreter; its first argument is this process's id."""
    return spawn([sys.executable, "-P", "-m", module, str(os.getpid()), *arguments])


class JsonChild:
    """A running module with messages in both directions.

    Parameters
    ----------
    module
        The module to run; it is given its parent's process id as its first argument.
    arguments
        Further arguments.
    on_line
        Called (in a thread of its own) with each line of the child's error output.
    launch
        How to start it.
    """

    def __init__(
        self,
        module: str,
        arguments: Sequence[str] = (),
        on_line: Callable[[str], None] | None = None,
        launch: Launch = launch_python,
    ) -> None:
        self.messages: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.on_line = on_line
        self.tail: deque[str] = deque(maxlen=_TAIL_LINES)
        self._write_lock = threading.Lock()
        self._process = launch(module, arguments)
        self._readers = [
            threading.Thread(target=target, daemon=True)
            for target in (self._read_messages, self._read_lines)
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def is_alive(self) -> bool:
        """Whether the child still runs."""
        return self._process.poll() is None

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message; a child that is gone does not hear it, and its end is seen elsewhere."""
        data = json.dumps(message).encode() + b"\n"
        with self._write_lock, contextlib.suppress(OSError, ValueError):
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def receive(self, timeout_s: float) -> dict[str, Any] | None:
        """The next message, or {} after `timeout_s`; None once the child's output has ended."""
        try:
            return self.messages.get(timeout=timeout_s)
        except queue.Empty:
            return {}

    def kill(self) -> str:
        """End the child (if it has not ended) and say how it ended."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        return self.reap()

    def reap(self, timeout_s: float = 10.0) -> str:
        """Wait for the end of a child that is ending, and say how it ended."""
        try:
            code = self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            try:
                code = self._process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                return "does not end"
        with self._write_lock, contextlib.suppress(OSError):
            self._process.stdin.close()
        for reader in self._readers:
            # What it said last tells why it ended.
            reader.join(1.0)
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"ended by {signal.Signals(-code).name}"
            return f"ended by signal {-code}"
        return f"exited with code {code}"

    def _read_messages(self) -> None:
        with self._process.stdout as pipe:
            for line in pipe:
                with contextlib.suppress(ValueError):
                    message = json.loads(line)
                    if isinstance(message, dict) and message:
                        self.messages.put(message)
        self.messages.put(None)

    def _read_lines(self) -> None:
        with self._process.stderr as pipe:
            while line := pipe.readline(_MAX_LINE):
                text = line.decode(errors="replace").rstrip()
                self.tail.append(text)
                if self.on_line is not None:
                    self.on_line(text)
