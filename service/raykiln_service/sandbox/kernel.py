"""The few system calls that Python has no function for."""

from __future__ import annotations

import contextlib
import ctypes
import os

PR_SET_PDEATHSIG = 1
PR_CAPBSET_DROP = 24
PR_SET_NO_NEW_PRIVS = 38
CLONE_NEWIPC = 0x08000000
CLONE_NEWUSER = 0x10000000
CLONE_NEWNET = 0x40000000

_CAPABILITY_VERSION_3 = 0x20080522
_MAX_CAPABILITIES = 64


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


def syscall(number: int, *arguments: int | ctypes.c_void_p | bytes | None) -> int:
    """Call the kernel by number; `OSError` if it refuses."""
    call = _libc().syscall
    call.restype = ctypes.c_long
    words = [ctypes.c_long(a) if isinstance(a, int) else a for a in arguments]
    return _checked(call(ctypes.c_long(number), *words))


def prctl(option: int, *arguments: int) -> int:
    """prctl(2); `OSError` if the kernel refuses."""
    words = [ctypes.c_ulong(a) for a in (*arguments, 0, 0, 0, 0)[:4]]
    return _checked(_libc().prctl(ctypes.c_int(option), *words))


def forbid_new_privileges() -> None:
    """From now on no program that is started gains rights by its set-uid bit or capabilities."""
    prctl(PR_SET_NO_NEW_PRIVS, 1)


def drop_capabilities() -> None:
    """Give up every special right, also that of root to override permissions."""
    for number in range(_MAX_CAPABILITIES):
        # Numbers that this kernel does not know, and processes that may not drop: nothing is lost.
        with contextlib.suppress(OSError):
            prctl(PR_CAPBSET_DROP, number)
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    nothing = (ctypes.c_uint32 * 6)()
    _checked(_libc().capset(ctypes.byref(header), ctypes.byref(nothing)))


def leave_network() -> None:
    """Move into network and IPC namespaces of its own, in which there is nothing.

    A process without the privilege makes a user namespace for it, where that is allowed.
    """
    unshare = _libc().unshare
    try:
        _checked(unshare(ctypes.c_int(CLONE_NEWNET | CLONE_NEWIPC)))
    except PermissionError:
        user, group = os.geteuid(), os.getegid()
        _checked(unshare(ctypes.c_int(CLONE_NEWUSER | CLONE_NEWNET | CLONE_NEWIPC)))
        for name, text in (
            ("setgroups", "deny"),
            ("uid_map", f"{user} {user} 1"),
            ("gid_map", f"{group} {group} 1"),
        ):
            # Root without capabilities may not map itself; it keeps its rights to files unnamed.
            with contextlib.suppress(OSError), open(f"/proc/self/{name}", "w") as file:
                file.write(text)
