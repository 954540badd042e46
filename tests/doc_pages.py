"""Reading the documentation's pages, and running their examples."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

# What the pages call the service by; the tests give it a port of its own.
DOCUMENTED_SERVER = "http://127.0.0.1:8000"
# These set up the checkout itself or need a container engine; CI runs them as steps of their own.
_SET_UP = re.compile(r"(\./dev|\. \.venv|bash \.ci/run)\b")


class Block(NamedTuple):
    """A fenced block of a page; `line` is that of its fence."""

    language: str
    text: str
    line: int
    above: str

    @property
    def is_run(self) -> bool:
        """Whether this is an example to run: `<!-- not run: why -->` above it says no."""
        return self.language in {"python", "console"} and not self.above.startswith(
            "<!-- not run: "
        )

    @property
    def file_name(self) -> str | None:
        """The file that the text above tells the reader to save a JSON block as."""
        named = re.search(r"[Ss]ave this as `([\w.-]+)`", self.above)
        return named[1] if named else None


def blocks_of(text: str) -> list[Block]:
    """The fenced blocks of a page."""
    lines = text.splitlines()
    fences = [i for i, line in enumerate(lines) if line.startswith("```")]
    blocks = []
    for start, end in zip(fences[::2], fences[1::2], strict=True):
        above = next((line for line in reversed(lines[:start]) if line), "")
        body = "".join(f"{line}\n" for line in lines[start + 1 : end])
        blocks.append(Block(lines[start][3:].strip(), body, start + 1, above))
    return blocks


def without_blocks(text: str) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors_of(text: str) -> set[str]:
    """The anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ +(.+?) *$", without_blocks(text), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


def run_examples(text: str, folder: Path, server: str | None = None) -> None:
    """Run a page's examples in order, in `folder`; an `AssertionError` shows what went wrong.

    Neighbours of one language run as one script, so that what the first defines the next may use.
    """
    if server is not None:
        text = text.replace(DOCUMENTED_SERVER, server)
    blocks = [block for block in blocks_of(text) if block.is_run or block.file_name]
    for language, group in groupby(blocks, key=lambda block: block.language):
        if language == "json":
            for block in group:
                (folder / str(block.file_name)).write_text(block.text)
        else:
            _run(language, list(group), folder)


def _run(language: str, blocks: list[Block], folder: Path) -> None:
    script = ""
    for block in blocks:
        # Line numbers of messages are those of the page.
        script += "\n" * (block.line - script.count("\n"))
        script += block.text if language == "python" else _commands_of(block)
    start = [sys.executable, "-c"] if language == "python" else ["bash", "-exo", "pipefail", "-c"]
    scripts = sysconfig.get_path("scripts")
    done = subprocess.run(
        [*start, script],
        cwd=folder,
        env={**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"


def _commands_of(block: Block) -> str:
    lines = [line[2:] if line.startswith("$ ") else "" for line in block.text.splitlines()]
    return "".join("\n" if _SET_UP.match(line) else f"{line}\n" for line in lines)


@contextmanager
def service(data_dir: Path) -> Iterator[str]:
    """A service on a free port; gives its address."""
    command = [sys.executable, "-m", "raykiln_service.cli", "serve", "--port", "0"]
    log = data_dir.parent / "service.log"
    with log.open("w") as output:
        process = subprocess.Popen(
            [*command, "--data-dir", str(data_dir)], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        yield _address(process, log)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=60)


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    while process.poll() is None:
        found = re.search(r"serving on (http://[\d.:]+)", log.read_text())
        if found:
            return found[1]
        time.sleep(0.05)
    raise AssertionError(f"the service did not start: {log.read_text()}")
