"""What every command shares: exit codes, the one error line, checks of output paths."""

from __future__ import annotations

import json
import os
import sys
from enum import IntEnum
from pathlib import Path
from typing import Any


class ExitCode(IntEnum):
    """What a command's exit code means."""

    DONE = 0
    FAILED = 1
    """A render or a job failed."""
    USAGE = 2
    """A bad command line, scene or server address."""
    INTERRUPTED = 130


class CommandError(Exception):
    """Ends a command with one error line and an exit code."""

    def __init__(self, message: str, exit_code: int = ExitCode.USAGE) -> None:
        super().__init__(message)
        self.exit_code = int(exit_code)


def usage_error(
    where: str, what: str, *, found: object = None, accepted: str | None = None
) -> CommandError:
    """The error of something wrong on the command line: where, what, found, accepted."""
    text = f"{where}: {what}"
    if found is not None:
        text += f" (found {found})"
    if accepted is not None:
        text += f"; accepted: {accepted}"
    return CommandError(text)


def print_error(message: str) -> None:
    """One line on stderr; nothing for no message (the help was shown instead)."""
    if message:
        print(f"raykiln: error: {one_line(message)}", file=sys.stderr, flush=True)


def print_note(message: str) -> None:
    """One line on stderr that is no error: progress, a path, a hint."""
    print(one_line(message), file=sys.stderr, flush=True)


def print_warnings(warnings: list[str]) -> None:
    """The scene's warnings, a line each, on stderr."""
    for warning in warnings:
        print(f"raykiln: warning: {one_line(warning)}", file=sys.stderr, flush=True)


def print_json(value: Any) -> None:
    """A JSON document on stdout."""
    print(json.dumps(value, indent=2, ensure_ascii=False), flush=True)


def one_line(text: str) -> str:
    """`text` without line breaks or control characters."""
    joined = "; ".join(part.strip() for part in text.splitlines() if part.strip())
    return "".join(c if c.isprintable() else "?" for c in joined)


def count(number: float) -> str:
    """A large number for people: 1.23 k, 45.6 M."""
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if number >= size:
            return f"{number / size:.3g}{unit}"
    return f"{number:.3g}"


def duration(seconds: float | None) -> str:
    """A time span for people: 0.42 s, 12 s, 3 min 05 s, 1 h 02 min."""
    if seconds is None:
        return "unknown"
    if seconds < 10:
        return f"{seconds:.2f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def check_writable(path: Path, option: str) -> None:
    """Raise a usage error now if `path` could not be written later."""
    folder = path.parent
    try:
        path.exists()
    except (OSError, ValueError) as error:
        raise CommandError(f"{option}: not a usable path: {one_line(str(error))}") from None
    if path.is_dir():
        raise usage_error(option, "a folder stands in the way of the file", found=path)
    if path.exists() and not path.is_file():
        # The file is put into its place whole, which would do away with a device.
        raise usage_error(option, "not a regular file", found=path)
    if not folder.is_dir():
        raise usage_error(option, "the folder does not exist", found=folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise usage_error(option, "the folder cannot be written to", found=folder)
    if path.exists() and not os.access(path, os.W_OK):
        raise usage_error(option, "the file cannot be written to", found=path)
