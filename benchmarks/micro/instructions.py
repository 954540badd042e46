"""Count the instructions of fixed workloads under callgrind, and compare with the last counts.

Counts repeat to a fraction of a percent on a busy machine, where times do not. Valgrind knows no
AVX-512, so everything runs as on a processor with AVX2.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

COUNTS = Path(__file__).parent / "instructions.json"
TOLERANCE = 0.02
_REGION = "raykiln_counted_region"


def names_of(program: Path) -> list[str]:
    """The workloads that the program offers."""
    listed = subprocess.run([program, "--list"], capture_output=True, text=True, check=True)
    return listed.stdout.split()


def count(program: Path, name: str) -> int:
    """Instructions of one workload; RuntimeError if callgrind gives none."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "counts"
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}"]
        command += ["--collect-atstart=no", f"--toggle-collect={_REGION}", str(program), name]
        environment = {**os.environ, "RAYKILN_ISA": "avx2"}
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
        found = (
            re.search(r"^(?:totals|summary): (\d+)", out.read_text(), re.M)
            if out.exists()
            else None
        )
    if done.returncode != 0 or found is None or int(found[1]) == 0:
        raise RuntimeError(f"{name}: callgrind counted nothing\n{done.stderr[-2000:]}")
    return int(found[1])


def count_all(program: Path, names: list[str], jobs: int) -> dict[str, int]:
    """The counts of all workloads, by name."""
    with ThreadPoolExecutor(jobs) as pool:
        return dict(zip(names, pool.map(lambda name: count(program, name), names), strict=True))


def compiler() -> str:
    """The version that counts depend on most."""
    shown = subprocess.run(["c++", "--version"], capture_output=True, text=True, check=True)
    return shown.stdout.splitlines()[0]


def compare(before: dict[str, int], now: dict[str, int]) -> list[str]:
    """Print the table; returns the workloads that need more than TOLERANCE above before."""
    worse = []
    for name, counted in now.items():
        if name not in before:
            print(f"{name:40} {counted:14,}   new")
            continue
        change = counted / before[name] - 1
        mark = "  WORSE" if change > TOLERANCE else "  better" if change < -TOLERANCE else ""
        print(f"{name:40} {counted:14,} {change:+8.2%}{mark}")
        if change > TOLERANCE:
            worse.append(name)
    return worse


def main() -> int:
    """Exit code 1 if something got worse, 2 if nothing could be counted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path, help="raykiln_instructions, built with optimisation")
    parser.add_argument("--only", default="", metavar="REGEX", help="workloads to count")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    parser.add_argument("--update", action="store_true", help=f"write {COUNTS.name}")
    arguments = parser.parse_args()
    if shutil.which("valgrind") is None:
        print("instructions.py: error: valgrind is not installed", file=sys.stderr)
        return 2
    names = [n for n in names_of(arguments.program) if re.search(arguments.only, n)]
    if not names:
        print(f"instructions.py: error: no workload matches {arguments.only}", file=sys.stderr)
        return 2
    stored: dict[str, Any] = json.loads(COUNTS.read_text()) if COUNTS.exists() else {"counts": {}}
    try:
        now = count_all(arguments.program.resolve(), names, arguments.jobs)
    except RuntimeError as error:
        print(f"instructions.py: error: {error}", file=sys.stderr)
        return 2
    if stored["counts"] and stored["compiler"] != compiler():
        print(f"note: the stored counts are of {stored['compiler']}, these of {compiler()}")
    worse = compare(stored["counts"], now)
    if arguments.update:
        counts = {**stored["counts"], **now} if arguments.only else now
        COUNTS.write_text(json.dumps({"compiler": compiler(), "counts": counts}, indent=2) + "\n")
        return 0
    if worse:
        print(f"{len(worse)} workloads need over {TOLERANCE:.0%} more instructions")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
