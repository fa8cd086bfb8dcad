"""Turns renderables of the library rich into lines of text, and plain values into one line."""

from __future__ import annotations

import re
from io import StringIO
from typing import Final, TypeAlias

from rich.console import Console, RenderableType
from rich.text import Text

from turtleact.goals.state import GoalStatus

__all__ = ["STYLES", "Picture", "cut", "inline", "lines", "printable", "shortened"]

Picture: TypeAlias = RenderableType
"""Anything that rich can draw."""

STYLES: Final = {
    GoalStatus.ACCEPTED: "blue",
    GoalStatus.EXECUTING: "cyan",
    GoalStatus.CANCELING: "yellow",
    GoalStatus.SUCCEEDED: "green",
    GoalStatus.CANCELED: "yellow",
    GoalStatus.ABORTED: "red",
}

LONGEST_LIST: Final = 8
"""If a list has more elements than this, only its first and last elements are shown."""

LONGEST_TEXT: Final = 400
"""Longer texts are cut to this many characters; no window is wide enough for more."""


def lines(content: Picture, *, width: int, height: int) -> list[str]:
    """Render a picture for this terminal: at most ``height`` lines of at most ``width`` columns.

    Lines have no trailing blanks, because these would wrap onto an extra line if the user made the
    terminal narrower. The environment variables TERM, COLORTERM and NO_COLOR determine the colours.
    """
    console = Console(
        file=StringIO(), width=width, height=height, force_terminal=True, highlight=False
    )
    with console.capture() as capture:
        console.print(content, end="")
    text = re.sub(r" +((?:\x1b\[[0-9;]*m)*)$", r"\1", capture.get(), flags=re.MULTILINE)
    return text.rstrip("\n").split("\n")[:height]


def cut(text: str, style: str = "") -> Text:
    """Return a line of text that is cut off at the window's edge."""
    return Text(text, style, no_wrap=True, overflow="ellipsis")


def shortened(text: str, columns: int) -> str:
    """Return a text, cut off if it is longer than ``columns``."""
    return text if len(text) <= columns else f"{text[: max(columns - 1, 0)]}…"


def inline(value: object) -> str:
    """Return a plain value as text on one line. The middle of a long list is left out."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_braced(item)}" for name, item in value.items()) or "{}"
    if isinstance(value, list | tuple | bytes):
        items = [_braced(item) for item in value]
        if len(items) > LONGEST_LIST:
            half = LONGEST_LIST // 2
            items[half:-half] = [f"… {len(items) - LONGEST_LIST} more …"]
        return f"[{', '.join(items)}]"
    if isinstance(value, float):
        return f"{value:.3f}".rstrip("0").removesuffix(".") if abs(value) < 1e6 else f"{value:g}"
    return printable(str(value))


def printable(text: str) -> str:
    """Replace control characters, which must not reach the terminal, and cut off a long text."""
    return "".join(c if c.isprintable() else "·" for c in text[:LONGEST_TEXT])


def _braced(value: object) -> str:
    return f"({inline(value)})" if isinstance(value, dict) else inline(value)
