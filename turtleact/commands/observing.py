"""What ``serve`` shows of its goals to other programs: traces, metrics, and log records."""

from __future__ import annotations

import logging
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from typing import TYPE_CHECKING

from turtleact.commands.output import printable
from turtleact.errors import InvalidOption, TurtleactError
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.commands.settings import LogFormat, Watched
    from turtleact.node import Node

__all__ = ["json_line", "observing", "set_up_logging"]


EXPORTER = "opentelemetry.exporter.otlp.proto.http"

REPEAT = 60.0
"""A failure of an exporter is told again after this time (s)."""


def set_up_logging(log_format: LogFormat | None) -> None:
    """Write log records to stderr in a format, from level INFO up; None leaves logging alone."""
    if log_format is None:
        return
    from turtleact.telemetry.logs import GoalFilter, JsonFormatter, TextFormatter

    class Printable(TextFormatter):
        """Escapes control characters, which an exception may hold."""

        def format(self, record: logging.LogRecord) -> str:
            """Write a record."""
            return printable(super().format(record))

    handler = _ToStderr()
    handler.addFilter(GoalFilter())
    handler.setFormatter(JsonFormatter() if log_format == "json" else Printable())
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    logging.getLogger("uvicorn").setLevel(logging.WARNING)  # it tells of each start and end


class _ToStderr(logging.Handler):
    """Writes to what stderr is at that moment, since the dashboard redirects it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        if sys.stderr is None:
            return
        try:
            print(self.format(record), file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)


def json_line(text: str, **members: str) -> str:
    """A line of ``serve`` itself as a log record in JSON."""
    from turtleact.telemetry.logs import JsonFormatter

    said = {"name": "turtleact.serve", "levelname": "INFO", "msg": text, **members}
    return JsonFormatter().format(logging.makeLogRecord(said))


@asynccontextmanager
async def observing(
    watched: Watched, say: Callable[[str], object]
) -> AsyncIterator[Callable[[Node], None]]:
    """Export traces and serve metrics, as asked; gives the function to call with each node.

    Args:
        watched: What is asked for.
        say: Tells the user something.

    Raises:
        TurtleactError: if a package is missing, or the port cannot be opened.
    """
    starts: list[Callable[[Node], None]] = []

    def start(node: Node) -> None:
        for each in starts:
            each(node)

    async with AsyncExitStack() as stack:
        if watched.otel:
            await _export(stack, starts)
        if watched.metrics is not None:
            url = await _serve_metrics(stack, starts, *watched.metrics)
            say(f"metrics at {url}")
        yield start


async def _export(stack: AsyncExitStack, starts: list[Callable[[Node], None]]) -> None:
    try:
        from turtleact.telemetry import instrument
        from turtleact.telemetry.exporting import exporting
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] != "opentelemetry":
            raise
        raise TurtleactError(
            "--otel needs the extra otel-export: "
            "pip install 'opentelemetry-exporter-otlp-proto-http>=1.30,<2'"
        ) from None
    for kind in ("trace", "metric"):
        logging.getLogger(f"{EXPORTER}.{kind}_exporter").addFilter(_Seldom())
    await stack.enter_async_context(exporting("turtleact"))
    starts.append(instrument)


class _Seldom(logging.Filter):
    """Lets a record pass at most once a minute: an exporter warns at each of its attempts."""

    def __init__(self) -> None:
        super().__init__()
        self._told: dict[int, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is told."""
        last = self._told.get(record.levelno, -REPEAT)
        if record.created - last < REPEAT:
            return False
        self._told[record.levelno] = record.created
        return True


async def _serve_metrics(
    stack: AsyncExitStack, starts: list[Callable[[Node], None]], host: str, port: int
) -> str:
    from turtleact.telemetry import GoalMetrics
    from turtleact.web.metrics import open_metrics

    metrics = GoalMetrics()
    starts.append(metrics.watch)
    try:
        url = await stack.enter_async_context(open_metrics(metrics.text, host, port))
    except InvalidOption as error:
        raise TurtleactError(f"--metrics: {error.problem}") from None
    lag = Background(metrics.watch_loop(), "measuring the event loop")
    await stack.enter_async_context(aclosing(lag))
    return url
