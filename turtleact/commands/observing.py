"""Shows the goals of ``serve`` to other programs, through traces, metrics and log records."""

from __future__ import annotations

import logging
import os
import re
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

REPEAT = 600.0
"""A failure of an exporter is reported again after this time (s)."""

ANSWER = re.compile(r"code: (?P<code>\d+), reason: (?P<reason>.*)")
"""The pattern of the line that an exporter logs when the collector answers with an error."""

NO_ANSWER = re.compile(r"Transient error (.*\[Errno -?\d+\] )?(?P<reason>.*?)[\")]* encountered")
"""The pattern of the line that an exporter logs before it repeats a failed attempt."""


def set_up_logging(log_format: LogFormat | None) -> None:
    """Write log records of level INFO and above to stderr, in the format ``log_format``.

    If ``log_format`` is None, leave Python's logging as it is.
    """
    if log_format is None:
        return
    from turtleact.telemetry.logs import GoalFilter, JsonFormatter, TextFormatter

    class Printable(TextFormatter):
        """A formatter that escapes control characters, which an exception may contain."""

        def format(self, record: logging.LogRecord) -> str:
            """Return a record as text."""
            return printable(super().format(record))

    handler = _ToStderr()
    handler.addFilter(GoalFilter())
    handler.setFormatter(JsonFormatter() if log_format == "json" else Printable())
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    logging.getLogger("uvicorn").setLevel(logging.WARNING)  # it tells of each start and end


class _ToStderr(logging.Handler):
    """Writes log records to the current `sys.stderr`, which the dashboard may have redirected."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        if sys.stderr is None:
            return
        try:
            print(self.format(record), file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)


def json_line(text: str, **members: str) -> str:
    """Make a log record in JSON from a line that ``serve`` itself prints."""
    from turtleact.telemetry.logs import JsonFormatter

    said = {"name": "turtleact.serve", "levelname": "INFO", "msg": text, **members}
    return JsonFormatter().format(logging.makeLogRecord(said))


@asynccontextmanager
async def observing(
    watched: Watched, say: Callable[[str], object]
) -> AsyncIterator[Callable[[Node], None]]:
    """During a block, export traces and serve metrics according to ``watched``.

    Yield a function that the block must call with each node.

    Args:
        watched: What to export and serve.
        say: A function that prints a line for the user.

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
    except ValueError as error:  # the SDK reads some variables when it is imported
        raise TurtleactError(f"OpenTelemetry cannot be set up: {error}") from error
    problems = _ExporterProblems()
    for kind in ("trace", "metric"):
        logging.getLogger(f"{EXPORTER}.{kind}_exporter").addFilter(problems)
    await stack.enter_async_context(exporting("turtleact"))
    starts.append(instrument)


class _ExporterProblems(logging.Filter):
    """Reports each problem of the exporters in clear words, and only once per `REPEAT`.

    Without this filter, the exporters would log the problem at each attempt.
    """

    def __init__(self) -> None:
        super().__init__()
        self._told: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to report the record.

        A record that is reported gets a new message, which says what to do.
        """
        problem = _problem(record) or next(iter(self._told), _unreachable("no answer"))
        if record.created - self._told.get(problem, -REPEAT) < REPEAT:
            return False
        self._told[problem] = record.created
        record.msg, record.args = problem, ()
        record.levelno, record.levelname = logging.WARNING, "WARNING"
        return True


def _unreachable(reason: str) -> str:
    at = os.environ.get("OTEL_EXPORTER_OTLP_ENDPOINT") or "http://localhost:4318"
    return (
        f"spans and measurements do not reach the collector at {at}: {reason}; start it, or set "
        "OTEL_EXPORTER_OTLP_ENDPOINT"
    )


def _problem(record: logging.LogRecord) -> str:
    """Return the problem in an exporter's record, in clear words.

    If the record gives no reason, return an empty string.
    """
    text = record.getMessage()
    if answer := ANSWER.search(text):
        is_metrics = record.name.endswith("metric_exporter")
        what, kind = ("measurements", "METRICS") if is_metrics else ("spans", "TRACES")
        advice = f"OTEL_{kind}_EXPORTER=none sends none"
        if answer["code"].startswith("3"):
            advice = "set OTEL_EXPORTER_OTLP_ENDPOINT to the address that it redirects to"
        return f"the collector takes no {what}: {answer['code']} {answer['reason']}; {advice}"
    if attempt := NO_ANSWER.search(text):
        return _unreachable(attempt["reason"])
    return ""


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
