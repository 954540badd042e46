"""The process that children are forked from: it has everything loaded, and has read no scene.

It runs one thread and nothing but this file, so a fork of it is a sound process, ready within
milliseconds.  Requests come over the socket that is its standard input: `{"id", "module",
"arguments"}` with three descriptors; answers are `{"id", "pid"}`, with a descriptor of the
process where the kernel has those, and later `{"exit", "code"}`.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import sys
import traceback
from typing import Any, NoReturn

from raykiln_service.executors.childside import die_with

MAX_MESSAGE = 1 << 16
_PR_SET_NAME = 15


def main() -> None:
    """Fork children until the supervisor goes away."""
    die_with(int(sys.argv[1]))
    control = socket.socket(fileno=os.dup(0))
    for module in sys.argv[2:]:
        importlib.import_module(module)
    wake, wake_writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.set_wakeup_fd(wake_writer)
    signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.collect()
    # Pages that the collector does not touch stay shared with the children.
    gc.freeze()
    while True:
        ready, _, _ = select.select([control.fileno(), wake], [], [])
        if wake in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(wake, 4096)
            _tell_of_the_dead(control)
        if control.fileno() in ready:
            data, descriptors, _, _ = socket.recv_fds(control, MAX_MESSAGE, 3)
            if not data:
                return
            _fork(control, json.loads(data), descriptors, [wake, wake_writer])


def _tell_of_the_dead(control: socket.socket) -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        answer = {"exit": pid, "code": os.waitstatus_to_exitcode(status)}
        control.send(json.dumps(answer).encode())


def _fork(
    control: socket.socket, request: dict[str, Any], pipes: list[int], own: list[int]
) -> None:
    parent = os.getpid()
    pid = os.fork()
    if pid == 0:
        _become(request["module"], [str(parent), *request["arguments"]], pipes, [control, *own])
    for pipe in pipes:
        os.close(pipe)
    handles = []
    with contextlib.suppress(OSError, AttributeError):
        handles.append(os.pidfd_open(pid))
    answer = {"id": request["id"], "pid": pid}
    socket.send_fds(control, [json.dumps(answer).encode()], handles)
    for handle in handles:
        os.close(handle)


def _become(
    module: str, arguments: list[str], pipes: list[int], others: list[socket.socket | int]
) -> NoReturn:
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.setsid()
        for target, pipe in enumerate(pipes):
            os.dup2(pipe, target)
            os.close(pipe)
        for other in others:
            other.close() if isinstance(other, socket.socket) else os.close(other)
        gc.unfreeze()
        name = b"raykiln-" + module.rpartition(".")[2].encode()
        ctypes.CDLL(None).prctl(_PR_SET_NAME, name[:15], 0, 0, 0)
        sys.argv[:] = [module, *arguments]
        known = sys.modules.get(module)
        if known is not None:
            known.main()
        else:
            runpy.run_module(module, run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
