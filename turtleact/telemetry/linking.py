"""Gives goals traces of their own. This module works without OpenTelemetry."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["NEW_TRACES", "new_traces"]

NEW_TRACES: ContextVar[bool] = ContextVar("NEW_TRACES", default=False)
"""Whether the goals that are sent now get traces of their own."""


@contextmanager
def new_traces() -> Iterator[None]:
    """Give each goal that is sent in a ``with`` block its own trace, linked to the current trace.

    Use this for goals that you detach. Without this block, the server's span is a child of the
    client's span, which suits a client that waits for the goal's end.
    """
    token = NEW_TRACES.set(True)
    try:
        yield
    finally:
        NEW_TRACES.reset(token)
