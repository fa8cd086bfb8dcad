"""Waiting for what is being ended."""

from __future__ import annotations

from collections.abc import Callable

import anyio

from turtleact.tasks.base import Signal

__all__ = ["wait_while"]


async def wait_while(is_busy: Callable[[], object], changed: Signal, patience: float) -> None:
    """Wait, shielded, until something is over; ``patience`` seconds at most.

    What is over already costs next to nothing: thousands may be closed together.

    Args:
        is_busy: Whether it is not over yet.
        changed: Fires whenever it may be.
        patience: How long it is waited for (s).
    """
    if is_busy():
        with anyio.move_on_after(patience, shield=True):
            while is_busy():
                await changed.wait()
