"""Goals that get traces of their own. A module of its own, since it needs no OpenTelemetry."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["NEW_TRACES", "new_traces"]

NEW_TRACES: ContextVar[bool] = ContextVar("NEW_TRACES", default=False)
"""Whether goals sent now get traces of their own."""


@contextmanager
def new_traces() -> Iterator[None]:
    """A block in which each goal that is sent gets a trace of its own, linked to the current one.

    Use it for goals that you detach. Otherwise the server's span is a child of the client's, which
    suits a client that waits for the end.
    """
    token = NEW_TRACES.set(True)
    try:
        yield
    finally:
        NEW_TRACES.reset(token)
