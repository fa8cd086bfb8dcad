"""Loggers: their severities, their filters, and their output.

A call site is a place in the source code that logs a message. Filters make a call site log only
once, skip its first message, or stay silent for some seconds after a message. A call site must use
the same options in each call.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import FrameType
from typing import TypeAlias

import msgspec

from turtleact.rclpy.impl.connection import Sender
from turtleact.rclpy.impl.logging_severity import LoggingSeverity
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.messages.codec import encode

__all__ = ["LOG", "RcutilsLogger", "Record", "Rosout", "rosout_of"]

UNNAMED = ""
DEFAULT_FORMAT = "[{severity}] [{time}] [{name}]: {message}"
COLOURS = {
    LoggingSeverity.DEBUG: "\033[32m",
    LoggingSeverity.WARN: "\033[33m",
    LoggingSeverity.ERROR: "\033[31m",
    LoggingSeverity.FATAL: "\033[31m",
}
PLAIN = "\033[0m"

FILTERS = ("once", "skip_first", "throttle_duration_sec")


class Record(msgspec.Struct, frozen=True):
    """One message of a log.

    Attributes:
        severity: The severity of the message.
        name: The name of the logger.
        text: The message.
        stamp: When the message was logged (ns since 1970).
        file: The file of the call site.
        function: The function of the call site.
        line: The line of the call site.
    """

    severity: LoggingSeverity
    name: str
    text: str
    stamp: int
    file: str
    function: str
    line: int


Rosout: TypeAlias = Callable[[Record], object]
"""A function that publishes a record on ``/rosout``."""


def rosout_of(sender: Sender) -> Rosout:
    """Return a function that publishes records on ``/rosout``."""
    log: Anything = interface_class("rcl_interfaces/msg/Log")
    stamp: Anything = interface_class("builtin_interfaces/msg/Time")

    def publish(record: Record) -> None:
        seconds, rest = divmod(record.stamp, 1_000_000_000)
        message = log(
            stamp=stamp(sec=seconds, nanosec=rest),
            level=int(record.severity),
            name=record.name,
            msg=record.text,
            file=record.file,
            function=record.function,
            line=record.line,
        )
        sender.publish(encode(message, log))

    return publish


class _Log:
    """Holds the levels of all loggers, and writes their messages.

    Attributes:
        rosouts: Functions that publish records, by the names of the nodes' loggers.
    """

    def __init__(self) -> None:
        self.rosouts: dict[str, Rosout] = {}
        self._levels: dict[str, int] = {UNNAMED: LoggingSeverity.INFO}
        self._effective: dict[str, int] = {}
        self._lock = threading.Lock()
        self._format = os.environ.get("RCUTILS_CONSOLE_OUTPUT_FORMAT") or DEFAULT_FORMAT
        self._to_stdout = os.environ.get("RCUTILS_LOGGING_USE_STDOUT") == "1"
        self._colours = os.environ.get("RCUTILS_COLORIZED_OUTPUT", "")

    def set_level(self, name: str, level: int) -> None:
        """Set the level of a logger.

        Loggers below it inherit the level, unless they have a level of their own. With UNSET, the
        logger inherits its level again.
        """
        with self._lock:
            self._levels[name] = level
            self._effective = {}

    def level(self, name: str) -> int:
        """Return the level that was set for a logger, or UNSET if the logger inherits its level."""
        return self._levels.get(name, 0)

    def effective_level(self, name: str) -> int:
        """Return the level that was set for the logger, or else for the nearest logger above it."""
        level = self._effective.get(name)
        if level is None:
            level = next((each for each in map(self.level, _above(name)) if each), 0)
            self._effective[name] = level
        return level

    def reset(self) -> None:
        """Reset all loggers to their initial levels."""
        with self._lock:
            self._levels = {UNNAMED: LoggingSeverity.INFO}
            self._effective = {}

    def write(self, record: Record) -> None:
        """Print a record, and publish it if its logger belongs to a node."""
        text = self._formatted(record)
        stream = sys.stdout if self._to_stdout else sys.stderr
        if stream is not None:
            with self._lock, suppress(ValueError, OSError):  # the stream may be closed at the end
                stream.write(f"{self._coloured(record.severity, text, stream)}\n")
                stream.flush()
        for name in _above(record.name):
            if name in self.rosouts:
                self.rosouts[name](record)
                return

    def _formatted(self, record: Record) -> str:
        seconds, rest = divmod(record.stamp, 1_000_000_000)
        if self._format == DEFAULT_FORMAT:
            stamp = f"{seconds}.{rest:09d}"
            return f"[{record.severity.name}] [{stamp}] [{record.name}]: {record.text}"
        values = {
            "severity": record.severity.name,
            "name": record.name,
            "message": record.text,
            "function_name": record.function,
            "file_name": record.file,
            "line_number": str(record.line),
            "time": f"{seconds}.{rest:09d}",
            "time_as_nanoseconds": str(record.stamp),
            "date_time_with_ms": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds))
            + f".{rest // 1_000_000:03d}",
        }
        return re.sub(r"\{(\w+)\}", lambda match: values.get(match[1], match[0]), self._format)

    def _coloured(self, severity: LoggingSeverity, text: str, stream: Anything) -> str:
        if self._colours == "0" or severity not in COLOURS:
            return text
        if self._colours != "1" and not stream.isatty():
            return text
        return f"{COLOURS[severity]}{text}{PLAIN}"


#: The log of the process; rclpy's loggers are global too.
LOG = _Log()


class _Site:
    """Stores the options of the first message at a call site, and the state of the filters."""

    __slots__ = ("filters", "has_logged", "has_skipped", "last", "name", "severity")

    def __init__(self, severity: LoggingSeverity, name: str, filters: dict[str, Anything]) -> None:
        self.severity = severity
        self.name = name
        self.filters = filters
        self.has_logged = False
        self.has_skipped = False
        self.last = 0

    def check(self, severity: LoggingSeverity, name: str, filters: dict[str, Anything]) -> None:
        """Raise ValueError if the options differ from those of the first message."""
        if severity != self.severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        if name != self.name:
            raise ValueError("Logger name cannot be changed between calls.")
        if filters.keys() != self.filters.keys():
            raise ValueError("Requested logging filters cannot be changed between calls.")
        if any(
            filters[name] is not self.filters[name] and filters[name] != self.filters[name]
            for name in filters
        ):
            raise ValueError("Logging filter parameters cannot be changed between calls.")

    def lets_pass(self) -> bool:
        """Whether the filters let a message pass."""
        passes = not self.filters.get("throttle_duration_sec") or self._is_due()
        if passes and self.filters.get("skip_first"):
            passes, self.has_skipped = self.has_skipped, True
        if passes and self.filters.get("once"):
            passes, self.has_logged = not self.has_logged, True
        return passes

    def _is_due(self) -> bool:
        clock = self.filters.get("throttle_time_source_type")
        now: int = time.monotonic_ns() if clock is None else clock.now().nanoseconds
        wait = self.filters["throttle_duration_sec"] * 1_000_000_000
        if now >= self.last + wait:
            self.last = now
            return True
        return False


class RcutilsLogger:
    """A logger. The names of loggers are hierarchical: ``a`` is the parent of ``a.b``.

    Args:
        name: The name of the logger; empty for the root logger.
    """

    def __init__(self, name: str = "") -> None:
        self.name = name
        self._sites: dict[tuple[Anything, int], _Site] = {}

    def get_child(self, name: str) -> RcutilsLogger:
        """Return the logger ``name`` below this logger.

        Raises:
            ValueError: if the name is empty.
        """
        if not name:
            raise ValueError("Child logger name must not be empty.")
        full = f"{self.name}.{name}" if self.name else name
        return type(self)(full)

    def set_level(self, level: LoggingSeverity | int) -> None:
        """Log only messages that are at least this severe."""
        LOG.set_level(self.name, LoggingSeverity(level))

    def get_effective_level(self) -> LoggingSeverity:
        """Return the level that was set for this logger, or for the nearest logger above it."""
        return LoggingSeverity(LOG.effective_level(self.name))

    def is_enabled_for(self, severity: LoggingSeverity | int) -> bool:
        """Whether messages of this severity are logged."""
        return LOG.effective_level(self.name) <= severity

    def log(
        self,
        message: object,
        severity: LoggingSeverity | int,
        name: str | None = None,
        **kwargs: Anything,
    ) -> bool:
        """Log a message.

        Args:
            message: The text, or an object that is converted to text.
            severity: The severity of the message.
            name: The name of another logger to use instead of this one.
            **kwargs: The filters: ``once`` (bool), ``skip_first`` (bool), ``throttle_duration_sec``
                (s), and ``throttle_time_source_type`` (a clock).

        Returns:
            True if the message was logged; False if its severity was too low, or if a filter
            dropped the message.

        Raises:
            RuntimeError: if ``severity`` is not in `LoggingSeverity`.
            TypeError: if a filter is unknown, or if there is a clock without
                ``throttle_duration_sec``.
            ValueError: if the same call site used other options before.
        """
        try:
            severity = LoggingSeverity(severity)
        except ValueError as error:
            raise RuntimeError(f"{severity!r} is no severity") from error
        frame = _caller()
        full = self.name if name is None else name
        filters = _filters(kwargs) if kwargs else kwargs
        key = (frame.f_code, frame.f_lasti)
        site = self._sites.get(key)
        if site is None:
            site = self._sites[key] = _Site(severity, full, filters)
        else:
            site.check(severity, full, filters)
        if LOG.effective_level(full) > severity or not site.lets_pass():
            return False
        code = frame.f_code
        record = Record(
            severity,
            full,
            str(message),
            time.time_ns(),
            code.co_filename,
            code.co_name,
            frame.f_lineno,
        )
        LOG.write(record)
        return True

    def debug(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity DEBUG."""
        return self.log(message, LoggingSeverity.DEBUG, **kwargs)

    def info(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity INFO."""
        return self.log(message, LoggingSeverity.INFO, **kwargs)

    def warning(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity WARN."""
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def warn(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity WARN. This method does the same as `warning`."""
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def error(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity ERROR."""
        return self.log(message, LoggingSeverity.ERROR, **kwargs)

    def fatal(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity FATAL."""
        return self.log(message, LoggingSeverity.FATAL, **kwargs)


def _filters(given: dict[str, Anything]) -> dict[str, Anything]:
    for name in given:
        if name not in (*FILTERS, "throttle_time_source_type"):
            raise TypeError(
                f"parameter '{name}' is not one of the recognized logging options: "
                f"{', '.join(FILTERS)}, throttle_time_source_type"
            )
    if "throttle_time_source_type" in given and "throttle_duration_sec" not in given:
        raise TypeError(
            'required parameter "throttle_duration_sec" not specified for logging filter "throttle"'
        )
    return given


def _above(name: str) -> Iterator[str]:
    """Yield the name of a logger, then the names of the loggers above it, up to the root."""
    while name:
        yield name
        name = name.rpartition(".")[0]
    yield UNNAMED


def _caller() -> FrameType:
    """Return the frame of the code that called a logger."""
    frame = sys._getframe(2)
    while frame.f_globals.get("__name__") == __name__ and frame.f_back is not None:
        frame = frame.f_back
    return frame
