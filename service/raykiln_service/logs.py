"""The service's own log (structlog) and the log file of each job."""

from __future__ import annotations

import logging
import sys
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import structlog

_MAX_JOB_LOG_BYTES = 1 << 20
_MAX_LINE = 2000
# Without the values of variables, which may be tokens and whole requests.
_TRACEBACKS = structlog.tracebacks.ExceptionDictTransformer(show_locals=False)


def configure(log_format: str) -> None:
    """Log to standard error: JSON lines, or text on a terminal."""
    json_lines = log_format == "json" or (log_format == "auto" and not sys.stderr.isatty())
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    renderer: list[Any] = (
        [structlog.processors.ExceptionRenderer(_TRACEBACKS), structlog.processors.JSONRenderer()]
        if json_lines
        else [structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)]
    )
    structlog.configure(
        processors=[*shared, *renderer],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )


def get_logger(**context: Any) -> Any:
    """A logger that adds `context` to each line."""
    return structlog.get_logger().bind(**context)


class JobLog:
    """A job's log file: one line an event, of limited size, from any thread."""

    def __init__(self, path: Path, attempt: int) -> None:
        self._path = path
        self._attempt = attempt
        self._lock = threading.Lock()

    def write(self, line: str) -> None:
        """Append a line; a log that cannot be written does not stop the job."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        text = f"{now} attempt {self._attempt}: {line[:_MAX_LINE]}\n"
        try:
            with self._lock, self._path.open("a", encoding="utf-8") as file:
                if file.tell() < _MAX_JOB_LOG_BYTES:
                    file.write(text)
        except OSError as error:
            get_logger().warning("job log not written", path=self._path.name, error=str(error))
