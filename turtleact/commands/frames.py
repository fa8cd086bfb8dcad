"""How often a terminal is drawn on, and how large a frame may be.

15 times a second by the wall at most, and never for more than a fifth of the processor's time, but
for the first frame, which imports what it takes; what is shown knows nothing of it.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

import anyio

from turtleact import render

if TYPE_CHECKING:
    from turtleact.commands.terminal import Region

__all__ = ["Compose", "animate", "draw", "keep_drawing"]

PERIOD: Final = 1 / 15
"""Wall seconds from frame to frame, at least."""

SHARE: Final = 0.2
"""The part of the processor's time that drawing may take; what others take meanwhile is not its."""

FULL: Final = 2
"""Lines of a frame that fill the window, beside one that may: they become two if it shrinks."""


class Compose(Protocol):
    """Makes the picture as it is now."""

    def __call__(self, *, width: int, height: int) -> render.Picture:
        """For so many columns and lines."""


def draw(region: Region, compose: Compose) -> None:
    """Draw a frame, unless the terminal has yet to take the one before."""
    if not region.is_ready():
        return
    columns, rows = region.size()
    width, height = columns - 1, max(rows - 1 - FULL, 1)
    content = compose(width=width, height=height)
    region.draw(render.lines(content, width=width, height=height))


async def animate(region: Region, compose: Compose) -> None:
    """Draw a frame now and then, until it is canceled; the terminal is held meanwhile."""
    with region.held():
        await keep_drawing(region, compose)


async def keep_drawing(region: Region, compose: Compose) -> None:
    """The same of a terminal that is held."""
    draw(region, compose)
    await anyio.sleep(PERIOD)
    while True:
        began = time.thread_time()
        draw(region, compose)
        spent = time.thread_time() - began
        await anyio.sleep(max(PERIOD, spent / SHARE) - spent)
