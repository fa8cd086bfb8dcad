"""``bag view``: show a bag in a browser, until a signal comes."""

from __future__ import annotations

import asyncio
import os
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from turtleact.commands import runner
from turtleact.commands.output import note, say
from turtleact.web.bag_view import open_bag_view

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["run"]


def run(path: Path, port: int, interrupts: Interrupts, *, is_opened: bool) -> int:
    """Serve the page, and return the exit status.

    Raises:
        BagError: if there is no bag.
        InvalidOption: if the port cannot be bound.
    """

    async def show() -> int:
        with interrupts.listening(asyncio.get_running_loop()):
            async with open_bag_view(path, port=port) as shown:
                say(f"{shown.url}\n")
                note("Ctrl-C ends it")
                if is_opened and has_display():
                    await asyncio.to_thread(webbrowser.open, shown.url)
                await interrupts.wait(1)
        return 0

    return runner.run(show(), interrupts)


def has_display() -> bool:
    """Whether a browser would open a window, instead of taking the terminal."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
