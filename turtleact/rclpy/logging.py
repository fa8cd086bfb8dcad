"""Logging: loggers by name, and their levels."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from turtleact.rclpy.impl.rcutils_logger import (
    LoggingSeverity,
    RcutilsLogger,
    logger_named,
    reset_levels,
)

__all__ = [
    "LoggingSeverity",
    "apply_levels",
    "clear_config",
    "get_logger",
    "get_logger_effective_level",
    "get_logger_level",
    "get_logging_directory",
    "get_logging_severity_from_string",
    "initialize",
    "set_logger_level",
    "shutdown",
]

_root_logger = RcutilsLogger()


def get_logger(name: str) -> RcutilsLogger:
    """Return the logger with this name.

    Raises:
        ValueError: if the name is empty.
    """
    if not name:
        raise ValueError("Logger name must not be empty.")
    return _root_logger.get_child(name)


def initialize() -> None:
    """Do nothing, because logging needs no preparation."""


def shutdown() -> None:
    """Do nothing, because every log message is written at once."""


def clear_config() -> None:
    """Reset all loggers to their initial levels."""
    reset_levels()


def set_logger_level(name: str, level: LoggingSeverity | int, detailed_error: bool = False) -> None:  # noqa: ARG001  # rclpy's signature
    """Set the level of a logger by its name."""
    logger_named(name).setLevel(LoggingSeverity(level))


def get_logger_level(name: str) -> LoggingSeverity:
    """Return the level of the logger itself; UNSET if it inherits its level."""
    return LoggingSeverity(logger_named(name).level)


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
