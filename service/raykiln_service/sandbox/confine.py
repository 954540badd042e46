"""All layers together, and a report of which of them hold."""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from raykiln_service.sandbox import kernel, landlock, seccomp

LAYERS = ("privileges", "limits", "network", "files", "system_calls")
_OFF = "off: "
_MAX_OPEN_FILES = 4096
_MAX_THREADS_IN_NAMESPACE = 2048
# Address space is cheap, and thread stacks and arenas take plenty that is never touched.
_ADDRESS_SPACE_FACTOR, _ADDRESS_SPACE_EXTRA = 4, 16 << 30

# What a library may look up about the machine, and no secrets of it.
_SYSTEM_FILES = (
    "/dev/null",
    "/dev/urandom",
    "/dev/zero",
    "/etc/ld.so.cache",
    "/etc/localtime",
    "/proc/cpuinfo",
    "/proc/filesystems",
    "/proc/meminfo",
    "/proc/self",
    "/proc/stat",
    "/proc/sys/kernel/osrelease",
    "/proc/sys/vm",
    "/sys/devices/system",
    "/sys/fs/cgroup",
    "/sys/kernel/mm",
)
_LIBRARIES = ("/usr", "/lib", "/lib64", "/opt")


@dataclass(frozen=True, slots=True)
class Confinement:
    """What a process keeps."""

    readable: tuple[str, ...]
    """Files and folders of the scene."""
    writable: tuple[str, ...]
    """Folders of its own."""
    memory_bytes: int
    """With what the interpreter, libraries and stacks take."""
    file_bytes: int
    """Largest file it may write."""

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for JSON; `of` takes them back."""
        return asdict(self)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Confinement:
        """From the values of `as_dict`."""
        paths = {name: tuple(values[name]) for name in ("readable", "writable")}
        return cls(**{**values, **paths})


def confine(to: Confinement, *, only_limits: bool = False) -> dict[str, str]:
    """Confine this process for good; call it from its only thread.

    Parameters
    ----------
    only_limits
        Limit memory and files, and leave the rest open.

    Returns
    -------
    For each of `LAYERS` what holds, or ``off: `` and why not.
    """
    report = {"limits": _report(lambda: _limit(to))}
    if only_limits or not sys.platform.startswith("linux"):
        why = f"{_OFF}not asked for" if only_limits else f"{_OFF}needs Linux"
        return {name: report.get(name, why) for name in LAYERS}
    private = _report(kernel.leave_network, "namespace")
    if not private.startswith(_OFF):
        with contextlib.suppress(OSError, ValueError):
            _lower(resource.RLIMIT_NPROC, _MAX_THREADS_IN_NAMESPACE)
    report["privileges"] = _report(_give_up_privileges, "no new privileges, no capabilities")
    report["files"] = _report(lambda: _restrict_files(to))
    report["system_calls"] = _report(seccomp.install, "seccomp")
    by_filter = not report["system_calls"].startswith(_OFF)
    if by_filter:
        private = "seccomp" if private.startswith(_OFF) else f"{private}, seccomp"
    report["network"] = private
    return {name: report[name] for name in LAYERS}


def missing_layers(report: Mapping[str, str]) -> dict[str, str]:
    """The layers of a report that do not hold, and why."""
    return {n: text.removeprefix(_OFF) for n, text in report.items() if text.startswith(_OFF)}


def system_folders(private: tuple[str, ...] = ()) -> list[Path]:
    """Where Python and the libraries lie; what holds one of the `private` folders is left out."""
    secret = [Path(p).resolve() for p in private]
    return [p for p in _code_folders() if not any(s.is_relative_to(p) for s in secret)]


@cache
def _code_folders() -> tuple[Path, ...]:
    found = {Path(p).resolve() for p in (*sys.path, sys.prefix, sys.base_prefix, *_LIBRARIES) if p}
    for folder in tuple(found):
        # A compiled module may be a link to where it was built.
        with contextlib.suppress(OSError):
            found |= {so.resolve() for so in (folder / "raykiln").iterdir() if so.suffix == ".so"}
    return tuple(sorted(found))


def _report(layer: Callable[[], str | None], name: str = "") -> str:
    try:
        return layer() or name
    except (OSError, AttributeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return f"{_OFF}{reason}"


def _limit(to: Confinement) -> str:
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_DATA, to.memory_bytes)
    _lower(resource.RLIMIT_AS, _ADDRESS_SPACE_FACTOR * to.memory_bytes + _ADDRESS_SPACE_EXTRA)
    _lower(resource.RLIMIT_FSIZE, to.file_bytes)
    _lower(resource.RLIMIT_NOFILE, _MAX_OPEN_FILES)
    return "memory, address space, file size, open files, no core"


def _lower(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
    resource.setrlimit(kind, (limit, limit))


def _give_up_privileges() -> None:
    kernel.forbid_new_privileges()
    kernel.drop_capabilities()


def _restrict_files(to: Confinement) -> str:
    threads = len(os.listdir("/proc/self/task"))
    if threads != 1:
        # Landlock holds for one thread and those that it starts.
        raise OSError(0, f"{threads} threads were running already")
    private = to.writable
    readable = [Path(p) for p in (*_SYSTEM_FILES, *to.readable)]
    readable += system_folders(private)
    found = landlock.restrict(readable, [Path(p) for p in to.writable])
    return f"landlock {found}"
