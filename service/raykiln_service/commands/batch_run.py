"""Rendering many scenes without a server: each one in a supervised child process.

Layout of the output folder::

    <name>.exr  <name>.png  <name>.stats.json   of each finished scene, renamed into place whole
    report.json                                 state of every scene, rewritten after each one
    .work/<fingerprint>/                        checkpoint and unfinished outputs of a scene

The fingerprint covers the scene file's bytes, the settings and the engine's version, so that
`resume` neither skips a scene that has changed nor goes on from another render's checkpoint.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from raykiln_service.commands.console import CommandError, ExitCode, one_line
from raykiln_service.files import sync_dir, write_json

State = Literal["pending", "running", "done", "failed", "interrupted"]
OUTPUTS = ("exr", "png", "stats.json")
WORK_FOLDER = ".work"
REPORT = "report.json"
STOP_GRACE_S = 10.0
"""How long a child may take to write its checkpoint once told to stop."""


@dataclass(frozen=True)
class Item:
    """One scene to render."""

    scene: str
    """A scene file, or the name of a bundled scene."""
    file: Path
    """The scene file itself."""
    name: str
    """Outputs are named after this, relative to the output folder."""
    settings: dict[str, Any] = field(default_factory=dict)
    """`RenderSettings` fields."""

    def fingerprint(self, engine_version: str, arguments: list[str]) -> str:
        """Hash of all that decides the outputs and their name, but for side files of the scene."""
        digest = hashlib.sha256(self.file.read_bytes())
        settings = {k: v for k, v in self.settings.items() if k != "threads"}
        digest.update(
            json.dumps([self.name, engine_version, settings, arguments], sort_keys=True).encode()
        )
        return digest.hexdigest()[:32]


@dataclass
class Entry:
    """One scene's line in the report."""

    scene: str
    name: str
    settings: dict[str, Any]
    state: State = "pending"
    fingerprint: str | None = None
    outputs: list[str] = field(default_factory=list)
    seconds: float | None = None
    exit_code: int | None = None
    error: str | None = None
    warnings: list[str] = field(default_factory=list)
    skipped: bool = False
    """Finished by an earlier run."""


Watcher = Callable[[Entry, float], None]
"""Told of each change: the entry, and how much of it is rendered (0..1)."""


class Batch:
    """Renders items into a folder; `run` returns the exit code of the whole."""

    def __init__(
        self,
        items: list[Item],
        folder: Path,
        *,
        resume: bool = False,
        jobs: int = 1,
        view_arguments: list[str] | None = None,
        checkpoint_interval_s: float = 5.0,
        on_change: Watcher | None = None,
    ) -> None:
        from raykiln import __version__

        self._version = __version__
        self._items = items
        self._folder = folder
        self._resume = resume
        self._jobs = jobs
        self._arguments = view_arguments or []
        self._interval_s = checkpoint_interval_s
        self._on_change = on_change or (lambda entry, fraction: None)
        self.entries = [Entry(item.scene, item.name, item.settings) for item in items]
        self._children: set[asyncio.subprocess.Process] = set()
        self._stopping = False
        self._started = time.time()

    def run(self) -> int:
        """Render everything; SIGINT and SIGTERM stop the children, who keep their checkpoints."""
        try:
            return asyncio.run(self._run())
        except* OSError as group:
            error = group.exceptions[0]
        raise CommandError(f"{self._folder}: cannot write: {error}", ExitCode.FAILED)

    async def _run(self) -> int:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stop)
        before = _read_report(self._folder) if self._resume else {}
        slots = asyncio.Semaphore(self._jobs)
        self._write_report()
        async with asyncio.TaskGroup() as group:
            for item, entry in zip(self._items, self.entries, strict=True):
                group.create_task(self._one(item, entry, before.get(item.name), slots))
        self._write_report(finished=True)
        with contextlib.suppress(OSError):
            (self._folder / WORK_FOLDER).rmdir()
        if self._stopping:
            return ExitCode.INTERRUPTED
        failed = any(entry.state != "done" for entry in self.entries)
        return ExitCode.FAILED if failed else ExitCode.DONE

    def _stop(self) -> None:
        self._stopping = True
        for child in self._children:
            _signal(child, signal.SIGTERM)

    async def _one(
        self, item: Item, entry: Entry, earlier: dict[str, Any] | None, slots: asyncio.Semaphore
    ) -> None:
        async with slots:
            if self._stopping:
                return
            try:
                entry.fingerprint = item.fingerprint(self._version, self._arguments)
                if earlier is not None and self._is_finished(entry, earlier):
                    entry.outputs, entry.seconds = earlier["outputs"], earlier["seconds"]
                    entry.state, entry.skipped = "done", True
                else:
                    await self._render(item, entry)
            except OSError as error:
                entry.state, entry.error = "failed", one_line(str(error))
            self._on_change(entry, 1.0)
            self._write_report()

    def _is_finished(self, entry: Entry, earlier: dict[str, Any]) -> bool:
        return (
            earlier.get("state") == "done"
            and earlier.get("fingerprint") == entry.fingerprint
            and bool(earlier.get("outputs"))
            and all((self._folder / name).is_file() for name in earlier["outputs"])
        )

    async def _render(self, item: Item, entry: Entry) -> None:
        assert entry.fingerprint is not None
        work = self._folder / WORK_FOLDER / entry.fingerprint
        checkpoint = work / "checkpoint"
        if not self._resume:
            shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True, exist_ok=True)
        entry.state = "running"
        self._on_change(entry, 0.0)
        start = time.monotonic()
        resuming = checkpoint.exists()
        code = await self._child(item, entry, work)
        if code == ExitCode.FAILED and resuming and not self._stopping:
            # The checkpoint may be what is broken: once more, from the beginning.
            checkpoint.unlink(missing_ok=True)
            entry.error = None
            code = await self._child(item, entry, work)
        entry.seconds = round(time.monotonic() - start, 3)
        entry.exit_code = code
        self._conclude(entry, work)

    def _conclude(self, entry: Entry, work: Path) -> None:
        if entry.exit_code == ExitCode.DONE:
            entry.outputs = self._publish(work, entry.name)
            entry.state, entry.error = "done", None
        elif self._stopping:
            entry.state, entry.error = "interrupted", None
            return
        else:
            entry.state = "failed"
            entry.error = entry.error or _death(entry.exit_code)
        shutil.rmtree(work, ignore_errors=True)

    def _publish(self, work: Path, name: str) -> list[str]:
        """Move a finished scene's files into place, the statistics last."""
        target = self._folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        outputs = []
        for extension in OUTPUTS:
            os.replace(work / f"image.{extension}", f"{target}.{extension}")
            outputs.append(f"{name}.{extension}")
        sync_dir(target.parent)
        return outputs

    async def _child(self, item: Item, entry: Entry, work: Path) -> int:
        """Run one render in a child process; returns its exit code (negative: its signal)."""
        command = [
            *(sys.executable, "-m", "raykiln_service.commands.batch_child", "render"),
            str(item.file.absolute()),
            *("-o", str(work / "image.exr"), "-o", str(work / "image.png")),
            *("--stats", str(work / "image.stats.json")),
            *("--checkpoint", str(work / "checkpoint"), "--resume", "--progress-json"),
            f"--checkpoint-interval={self._interval_s}",
            *("--settings-json", json.dumps(item.settings), *self._arguments),
        ]
        child = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            # Ctrl-C on the terminal reaches only this process, which tells its children.
            start_new_session=True,
            limit=1 << 20,
        )
        self._children.add(child)
        try:
            if self._stopping:
                _signal(child, signal.SIGTERM)
            await self._listen(child, entry)
            return await child.wait()
        finally:
            self._children.discard(child)
            if child.returncode is None:
                _signal(child, signal.SIGKILL)
                await child.wait()

    async def _listen(self, child: asyncio.subprocess.Process, entry: Entry) -> None:
        assert child.stderr is not None
        lines = asyncio.create_task(self._read_lines(child.stderr, entry))
        while not lines.done():
            await asyncio.wait([lines], timeout=0.5)
            if self._stopping and not lines.done():
                await asyncio.wait([lines], timeout=STOP_GRACE_S)
                if not lines.done():
                    _signal(child, signal.SIGKILL)
                    await lines
        lines.result()

    async def _read_lines(self, stream: asyncio.StreamReader, entry: Entry) -> None:
        entry.warnings = []
        while line := await _read_line(stream):
            text = one_line(line.decode(errors="replace"))
            if text.startswith('{"progress":'):
                with contextlib.suppress(ValueError, KeyError):
                    self._on_change(entry, json.loads(text)["progress"]["fraction"])
            elif text.startswith("raykiln: warning: "):
                entry.warnings.append(text.removeprefix("raykiln: warning: "))
            elif text:
                entry.error = text.removeprefix("raykiln: error: ")

    def _write_report(self, finished: bool = False) -> None:
        states = [entry.state for entry in self.entries]
        report = {
            "engine_version": self._version,
            "started_at": _timestamp(self._started),
            "finished_at": _timestamp(time.time()) if finished else None,
            "counts": {state: states.count(state) for state in sorted(set(states))},
            "scenes": [asdict(entry) for entry in self.entries],
        }
        write_json(self._folder / REPORT, report)


async def _read_line(stream: asyncio.StreamReader) -> bytes:
    """The next line; one that is absurdly long is replaced."""
    try:
        return await stream.readline()
    except ValueError:
        return b"(a line that is too long to show)\n"


def _signal(child: asyncio.subprocess.Process, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        child.send_signal(number)


def _death(code: int | None) -> str:
    """Why a child ended that said nothing itself."""
    if code is not None and code < 0:
        return f"the render process was ended by {signal.Signals(-code).name}"
    return f"the render process ended with exit code {code}"


def _timestamp(seconds: float) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))


def _read_report(folder: Path) -> dict[str, dict[str, Any]]:
    """Entries of an earlier run by name; nothing where there is no readable report."""
    try:
        scenes = json.loads((folder / REPORT).read_bytes())["scenes"]
        return {entry["name"]: entry for entry in scenes}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
