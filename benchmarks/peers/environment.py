"""The peers' own virtual environment, and what machine and versions the numbers belong to."""

from __future__ import annotations

import ctypes.util
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

PEERS = ["mitsuba==3.9.1", "pyluxcore==2.11.2", "bpy==4.5.15"]
TOOLS = ["numpy<3", "matplotlib>=3.9"]
# What the peers load and PyPI does not carry.
SYSTEM_PACKAGES = [
    "libllvm19", "libxrender1", "libxi6", "libxkbcommon0", "libsm6", "libgl1", "libxfixes3",
]  # fmt: skip
QUIET_LOAD = 0.5


class UnavailableError(Exception):
    """Something that the benchmark needs is not there, and how to get it."""


def peers_python(work: Path) -> Path:
    """The interpreter of the peers' environment; made at the first call."""
    venv = work / "venv"
    python = venv / "bin" / "python"
    wanted = "\n".join([*PEERS, *TOOLS])
    stamp = venv / "installed.txt"
    if stamp.is_file() and stamp.read_text() == wanted:
        return python
    base = _python_311()
    say(f"making the peers' environment in {venv} (about 1.5 GB)")
    shutil.rmtree(venv, ignore_errors=True)
    subprocess.run([base, "-m", "venv", str(venv)], check=True)
    pip = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, *PEERS, *TOOLS], check=True)
    stamp.write_text(wanted)
    return python


def _python_311() -> str:
    for name in (sys.executable, "python3.11"):
        found = shutil.which(name)
        if found is None:
            continue
        version = subprocess.run([found, "-V"], capture_output=True, text=True, check=True).stdout
        if version.startswith("Python 3.11."):
            return found
    raise UnavailableError(
        "Blender's module (Cycles) comes for Python 3.11 only: install python3.11"
    )


def require_system_packages() -> None:
    """Install the missing ones where apt-get can; else say what is missing."""
    if shutil.which("dpkg-query") is None:
        if ctypes.util.find_library("LLVM-19") is None:
            raise UnavailableError("Mitsuba's llvm variant needs LLVM 19 (libLLVM.so.19)")
        return
    missing = [name for name in SYSTEM_PACKAGES if not _installed(name)]
    if not missing:
        return
    if os.geteuid() != 0:
        raise UnavailableError(f"missing system packages: apt-get install {' '.join(missing)}")
    say(f"installing system packages: {' '.join(missing)}")
    install = ["apt-get", "install", "-qy", "--no-install-recommends", *missing]
    subprocess.run(["apt-get", "update", "-q"], check=True, capture_output=True)
    subprocess.run(install, check=True, capture_output=True)


def _installed(package: str) -> bool:
    query = ["dpkg-query", "-Wf", "${db:Status-Status}", package]
    return subprocess.run(query, check=False, capture_output=True, text=True).stdout == "installed"


def machine() -> dict[str, object]:
    """What the numbers depend on."""
    model = "unknown"
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text().splitlines()
        model = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), model)
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load_average": list(os.getloadavg()),
    }


def load_warning(load: float) -> str | None:
    """A sentence if other programs may have taken part of the machine."""
    if load <= QUIET_LOAD:
        return None
    return f"the load average was {load:.2f} before the first run: these numbers are disturbed"


def say(text: str) -> None:
    """A line of progress."""
    print(f"==> {text}", file=sys.stderr, flush=True)
