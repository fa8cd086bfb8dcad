"""Timeouts by the clock of a graph."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from numbers import Real
from typing import cast

import anyio

from turtleact.clock import Clock
from turtleact.errors import InvalidOption
from turtleact.tasks import Background

__all__ = ["check_timeout", "within"]


def check_timeout(seconds: object) -> None:
    """Raise what a user is to be told of a timeout that is none.

    Raises:
        InvalidOption: if it is neither a number nor None.
    """
    is_number = isinstance(seconds, Real) and not isinstance(seconds, bool)
    if seconds is not None and not (is_number and cast("float", seconds) == seconds):  # not nan
        raise InvalidOption("timeout", f"expected a number of seconds or None, not {seconds!r}")


@asynccontextmanager
async def within(seconds: float | None, clock: Clock) -> AsyncIterator[None]:
    """Cancel the block after some seconds of a clock and go on behind it; never, if None."""
    if seconds is None:
        yield
        return
    with anyio.CancelScope() as scope:
        timer = Background(_cancel_after(seconds, clock, scope), "a timeout")
        try:
            yield
        finally:
            await timer.aclose()


async def _cancel_after(seconds: float, clock: Clock, scope: anyio.CancelScope) -> None:
    await clock.sleep(seconds)
    scope.cancel()
