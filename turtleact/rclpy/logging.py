"""Logging: Python's `logging`, with rclpy's names, format and filters.

rclpy's loggers have a hierarchy of their own, apart from that of `logging.getLogger`. So the
node ``asyncio`` does not log as Python's ``asyncio``, and a program that configures Python's root
logger gets no line twice.

A call site is a place in the source code that logs a message. Filters make a call site log only
once, skip its first message, or stay silent for some seconds after a message. A call site must use
the same options in each call.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from types import FrameType

from turtleact.rclpy.impl.connection import Sender
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import encode, interface_class

__all__ = [
    "Console",
    "LoggingService",
    "LoggingSeverity",
    "RcutilsLogger",
    "Rosout",
    "apply_levels",
    "clear_config",
    "get_logger",
    "get_logger_effective_level",
    "get_logging_directory",
    "get_logging_severity_from_string",
    "logger_named",
    "set_logger_level",
    "shutdown",
]


class LoggingSeverity(IntEnum):
    """The severities of log messages, with the same numbers as in Python's `logging`."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


FIELDS = {
    "severity": "{levelname}",
    "name": "{name}",
    "message": "{message}",
    "function_name": "{funcName}",
    "file_name": "{pathname}",
    "line_number": "{lineno}",
    "time": "{created:.9f}",
    "date_time_with_ms": "{asctime}.{msecs:03.0f}",
}
"""Fields of ``RCUTILS_CONSOLE_OUTPUT_FORMAT``, each with the field of a Python format."""

DEFAULT_FORMAT = "[{severity}] [{time}] [{name}]: {message}"
COLOURS = {
    LoggingSeverity.DEBUG: "\033[32m",
    LoggingSeverity.WARN: "\033[33m",
    LoggingSeverity.ERROR: "\033[31m",
    LoggingSeverity.FATAL: "\033[31m",
}
PLAIN = "\033[0m"

FILTERS = ("once", "skip_first", "throttle_duration_sec")


class Console(logging.Handler):
    """Prints messages on stderr, in the format and colours that the environment asks for."""

    def __init__(self) -> None:
        super().__init__()
        wanted = os.environ.get("RCUTILS_CONSOLE_OUTPUT_FORMAT") or DEFAULT_FORMAT
        plain = wanted.replace("{", "{{").replace("}", "}}")
        text = re.sub(r"\{\{(\w+)\}\}", lambda field: FIELDS.get(field[1], field[0]), plain)
        self.setFormatter(logging.Formatter(text, "%Y-%m-%d %H:%M:%S", "{", validate=False))
        self._to_stdout = os.environ.get("RCUTILS_LOGGING_USE_STDOUT") == "1"
        self._colours = os.environ.get("RCUTILS_COLORIZED_OUTPUT", "")

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message."""
        stream = sys.stdout if self._to_stdout else sys.stderr
        if stream is None:
            return
        with suppress(ValueError, OSError):  # the stream may be closed at the end
            text = self.format(record)
            colour = COLOURS.get(LoggingSeverity(record.levelno))
            if colour and self._is_coloured(stream):
                text = f"{colour}{text}{PLAIN}"
            stream.write(f"{text}\n")
            stream.flush()

    def _is_coloured(self, stream: Anything) -> bool:
        if self._colours in ("0", "1"):
            return self._colours == "1"
        return bool(stream.isatty())


class Rosout(logging.Handler):
    """Publishes the messages of a node's logger, and of the loggers below it, on ``/rosout``.

    Args:
        sender: Sends the encoded messages.
    """

    def __init__(self, sender: Sender) -> None:
        super().__init__()
        self._sender = sender
        self._log: Anything = interface_class("rcl_interfaces/msg/Log")
        self._time: Anything = interface_class("builtin_interfaces/msg/Time")

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a message, unless the node of a lower logger has published it."""
        if record.__dict__.setdefault("publisher", self) is not self:
            return
        nanoseconds = int(record.created * 1e9)
        message = self._log(
            stamp=self._time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000),
            level=record.levelno,
            name=record.name,
            msg=record.getMessage(),
            file=record.pathname,
            function=record.funcName,
            line=record.lineno,
        )
        self._sender.publish(encode(message, self._log))


ROOT = logging.RootLogger(LoggingSeverity.INFO)
MANAGER = logging.Manager(ROOT)
ROOT.manager = MANAGER
ROOT.name = ""
ROOT.addHandler(Console())


def logger_named(name: str) -> logging.Logger:
    """Return the Python logger behind a logger of rclpy; the root logger for an empty name."""
    return MANAGER.getLogger(name) if name else ROOT


class _Site:
    """Stores the options of the first message at a call site, and the state of the filters.

    Args:
        *given: The severity, the name of the logger, and the filters.
    """

    __slots__ = ("filters", "given", "has_logged", "has_skipped", "last")

    def __init__(self, *given: Anything) -> None:
        self.given = given
        self.filters = given[2]
        self.has_logged = False
        self.has_skipped = False
        self.last = 0

    def check(self, *given: Anything) -> None:
        """Raise ValueError if the severity, name or filters differ from those of the first call."""
        words = ("Logger severity", "Logger name", "Logging filter parameters")
        for word, first, now in zip(words, self.given, given, strict=True):
            if now != first:
                raise ValueError(f"{word} cannot be changed between calls.")

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
        self._logger = logger_named(name)
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
        self._logger.setLevel(LoggingSeverity(level))

    def get_effective_level(self) -> LoggingSeverity:
        """Return the level that was set for this logger, or for the nearest logger above it."""
        return LoggingSeverity(self._logger.getEffectiveLevel())

    def is_enabled_for(self, severity: LoggingSeverity | int) -> bool:
        """Whether messages of this severity are logged."""
        return self._logger.isEnabledFor(severity)

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
        logger = self._logger if name is None else logger_named(name)
        _check_filters(kwargs)
        given = severity, logger.name, kwargs
        site = self._sites.setdefault((frame.f_code, frame.f_lasti), _Site(*given))
        site.check(*given)
        if not logger.isEnabledFor(severity) or not site.lets_pass():
            return False
        _write(logger, severity, str(message), frame)
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

    warn = warning

    def error(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity ERROR."""
        return self.log(message, LoggingSeverity.ERROR, **kwargs)

    def fatal(self, message: object, **kwargs: Anything) -> bool:
        """Log a message with severity FATAL."""
        return self.log(message, LoggingSeverity.FATAL, **kwargs)


def _write(logger: logging.Logger, severity: LoggingSeverity, text: str, frame: FrameType) -> None:
    code = frame.f_code
    record = logger.makeRecord(
        logger.name,
        severity,
        code.co_filename,
        frame.f_lineno,
        text,
        (),
        None,
        code.co_name,
    )
    record.levelname = severity.name  # rclpy says WARN and FATAL
    logger.handle(record)


def _check_filters(given: dict[str, Anything]) -> None:
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


def _caller() -> FrameType:
    """Return the frame of the code that called a logger."""
    frame = sys._getframe(2)
    while frame.f_globals.get("__name__") == __name__ and frame.f_back is not None:
        frame = frame.f_back
    return frame


_root_logger = RcutilsLogger()


def get_logger(name: str) -> RcutilsLogger:
    """Return the logger with this name.

    Raises:
        ValueError: if the name is empty.
    """
    if not name:
        raise ValueError("Logger name must not be empty.")
    return _root_logger.get_child(name)


def shutdown() -> None:
    """Do nothing, because every log message is written at once."""


def clear_config() -> None:
    """Reset all loggers to their initial levels."""
    for name in list(MANAGER.loggerDict):
        logger_named(name).setLevel(LoggingSeverity.UNSET)
    ROOT.setLevel(LoggingSeverity.INFO)


def set_logger_level(name: str, level: LoggingSeverity | int, detailed_error: bool = False) -> None:  # noqa: ARG001  # rclpy's signature
    """Set the level of a logger by its name."""
    logger_named(name).setLevel(LoggingSeverity(level))


def get_logger_effective_level(name: str) -> LoggingSeverity:
    """Return the level that a logger has or inherits."""
    return LoggingSeverity(logger_named(name).getEffectiveLevel())


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """Return the severity with this name, which may be in upper or lower case.

    Raises:
        RuntimeError: if there is no such severity.
    """
    try:
        return LoggingSeverity[log_severity.upper()]
    except KeyError:
        raise RuntimeError(f"Logging severity '{log_severity}' does not exist") from None


def get_logging_directory() -> Path:
    """Return the folder in which rclpy would write log files. turtleact writes none."""
    given = os.environ.get("ROS_LOG_DIR")
    if given:
        return Path(given)
    home = os.environ.get("ROS_HOME")
    return (Path(home) if home else Path("~/.ros").expanduser()) / "log"


def apply_levels(levels: Iterable[tuple[str, int]]) -> None:
    """Set the levels of loggers by their names."""
    for name, level in levels:
        logger_named(name).setLevel(level)


class LoggingService:
    """Creates a node's services for log levels.

    Args:
        node: The node that offers the services.
    """

    def __init__(self, node: Anything) -> None:
        name = node.get_name()
        for kind, callback in (("Get", self._get), ("Set", self._set)):
            node.create_service(
                interface_class(f"rcl_interfaces/srv/{kind}LoggerLevels"),
                f"{name}/{kind.lower()}_logger_levels",
                callback,
            )

    def _get(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/LoggerLevel")
        for name in request.names:
            response.levels.append(made(name=name, level=logger_named(name).level))
        return response

    def _set(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetLoggerLevelsResult")
        for wanted in request.levels:
            try:
                logger_named(wanted.name).setLevel(LoggingSeverity(wanted.level))
            except ValueError:
                result = made(successful=False, reason="Failed reason: Invalid logger level.")
            else:
                result = made(successful=True)
            response.results.append(result)
        return response
