"""Children forked from a process that has everything loaded (`zygote.py`)."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Any

from raykiln_service.executors.process import Process, spawn
from raykiln_service.executors.zygote import MAX_MESSAGE

_ZYGOTE = "raykiln_service.executors.zygote"
_PRELOADED = (
    "raykiln._image",
    "raykiln._oiio",
    "raykiln.image",
    "raykiln_service.executors.child",
    "raykiln_service.executors.check",
    "raykiln_service.executors.probe",
)
_START_TIMEOUT_S = 60.0


class Forked:
    """A child of the zygote, with the face of a `subprocess.Popen`."""

    def __init__(self, pid: int, handle: int | None) -> None:
        self.pid = pid
        self.stdin: Any = None
        self.stdout: Any = None
        self.stderr: Any = None
        self._handle = handle
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._code = 0

    def poll(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._code if self._ended.is_set() else None

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code once it has ended."""
        if not self._ended.wait(timeout):
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return self._code

    def kill(self) -> None:
        """SIGKILL; never to another process that got the same number."""
        with self._lock:
            if self._ended.is_set():
                return
            if self._handle is None:
                os.kill(self.pid, signal.SIGKILL)
            else:
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)

    def ended(self, code: int) -> None:
        """Note its end."""
        with self._lock:
            self._code = code
            self._ended.set()
            if self._handle is not None:
                os.close(self._handle)
                self._handle = None


class Nursery:
    """Starts children; its zygote starts with the first, and again should it ever die."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._litter: _Litter | None = None
        self._closed = False

    def start(self, module: str, arguments: Sequence[str] = ()) -> Process:
        """Start a module in a process of its own; its first argument is its parent's id.

        Raises
        ------
        OSError
            It cannot be started.
        """
        with self._lock:
            if self._closed:
                raise OSError(0, "no more processes are started")
            if self._litter is None or not self._litter.is_alive():
                self._litter = _Litter()
            litter = self._litter
        return litter.start(module, arguments)

    def close(self) -> None:
        """End all children."""
        with self._lock:
            self._closed = True
            if self._litter is not None:
                self._litter.close()


class _Litter:
    """One zygote and its children."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, "-P", "-m", _ZYGOTE, str(os.getpid()), *_PRELOADED]
            self._zygote = spawn(command, stdin=theirs.fileno())
        self._control = ours
        self._numbers = itertools.count()
        self._send_lock = threading.Lock()
        self._lock = threading.Lock()
        self._gone = False
        self._waiting: dict[int, queue.SimpleQueue[Forked | None]] = {}
        self._children: dict[int, Forked] = {}
        self._complaint = b""
        for target in (self._listen, self._read_complaint):
            threading.Thread(target=target, daemon=True).start()

    def is_alive(self) -> bool:
        return not self._gone

    def start(self, module: str, arguments: Sequence[str]) -> Process:
        answer: queue.SimpleQueue[Forked | None] = queue.SimpleQueue()
        number = next(self._numbers)
        with self._lock:
            self._waiting[number] = answer
            if self._gone:
                answer.put(None)
        request = {"id": number, "module": module, "arguments": list(arguments)}
        with contextlib.ExitStack() as stack:
            pipes = [os.pipe2(os.O_CLOEXEC) for _ in range(3)]
            for end in itertools.chain(*pipes):
                stack.callback(os.close, end)
            (in_r, in_w), (out_r, out_w), (err_r, err_w) = pipes
            with self._send_lock, contextlib.suppress(OSError):
                data = json.dumps(request).encode()
                socket.send_fds(self._control, [data], [in_r, out_w, err_w])
            try:
                child = answer.get(timeout=_START_TIMEOUT_S)
            except queue.Empty:
                child = None
            if child is None:
                said = self._complaint.decode(errors="replace").strip()
                raise OSError(0, f"no process could be started: {said.rpartition(chr(10))[2]}")
            child.stdin = os.fdopen(os.dup(in_w), "wb")
            child.stdout = os.fdopen(os.dup(out_r), "rb")
            child.stderr = os.fdopen(os.dup(err_r), "rb")
        return child

    def close(self) -> None:
        # The children die with it.
        with contextlib.suppress(OSError):
            self._zygote.kill()
        self._zygote.wait(10.0)

    def _listen(self) -> None:
        with self._control:
            while True:
                try:
                    data, handles, _, _ = socket.recv_fds(self._control, MAX_MESSAGE, 1)
                except OSError:
                    break
                if not data:
                    break
                message = json.loads(data)
                if "exit" in message:
                    self._children.pop(message["exit"]).ended(message["code"])
                else:
                    child = Forked(message["pid"], handles[0] if handles else None)
                    self._children[child.pid] = child
                    with self._lock:
                        self._waiting.pop(message["id"]).put(child)
        with self._lock:
            self._gone = True
            for waiting in self._waiting.values():
                waiting.put(None)
        for child in self._children.values():
            child.ended(-signal.SIGKILL)
        self._zygote.wait(10.0)

    def _read_complaint(self) -> None:
        with self._zygote.stdout, self._zygote.stderr as pipe:
            while piece := pipe.read1(1 << 16):
                self._complaint = (self._complaint + piece)[-4096:]
