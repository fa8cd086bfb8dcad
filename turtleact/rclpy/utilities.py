"""Functions for the default context, the command line and the middleware."""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence

from turtleact.rclpy.context import Context
from turtleact.rclpy.impl.arguments import without_ros_arguments

__all__ = [
    "get_available_rmw_implementations",
    "get_default_context",
    "get_rmw_implementation_identifier",
    "ok",
    "remove_ros_args",
    "shutdown",
    "timeout_sec_to_nsec",
    "try_shutdown",
]

RMW = "rmw_zenoh_cpp"
"""The middleware with the protocol that turtleact speaks."""

LONGEST = 2**63 // 1_000_000_000 // 2
"""Timeouts longer than this (s) count as no timeout."""


class _Default:
    """Holds the default context."""

    def __init__(self) -> None:
        self.context: Context | None = None
        self.lock = threading.Lock()


DEFAULT = _Default()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """Return the default context, which is used if no context is given.

    Args:
        shutting_down: Whether the context is about to be shut down. If true, the next call returns
            a new context.
    """
    with DEFAULT.lock:
        context = DEFAULT.context
        if context is None:
            context = DEFAULT.context = Context()
        if shutting_down:
            DEFAULT.context = None
        return context


def ok(*, context: Context | None = None) -> bool:
    """Whether a context, or the default one, is initialised and not shut down."""
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None) -> None:
    """Shut down a context, or the default one. `Context.shutdown` lists the errors."""
    (get_default_context(shutting_down=True) if context is None else context).shutdown()


def try_shutdown(*, context: Context | None = None) -> None:
    """Shut down a context, or the default one, unless it is already shut down."""
    given = get_default_context() if context is None else context
    if context is None and given.handle is not None:  # it may also have been shut down by a signal
        get_default_context(shutting_down=True)
    given.try_shutdown()


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """Return ``args``, by default ``sys.argv``, without the part from ``--ros-args`` to ``--``."""
    return without_ros_arguments(list(sys.argv if args is None else args))


def timeout_sec_to_nsec(timeout_sec: float | None) -> int:
    """Return a timeout in nanoseconds; -1 if it is None, negative or above `LONGEST`."""
    if timeout_sec is None or timeout_sec < 0 or timeout_sec > LONGEST:
        return -1
    return int(float(timeout_sec) * 1_000_000_000)


def get_rmw_implementation_identifier() -> str:
    """Return the name of the middleware."""
    return RMW


def get_available_rmw_implementations() -> set[str]:
    """Return the names of the middlewares that can be chosen."""
    return {RMW}
