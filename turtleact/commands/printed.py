"""What is printed while a display stands on the terminal: lines for its log."""

from __future__ import annotations

import io
import re
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from typing import Final, NamedTuple

__all__ = ["Line", "Log"]

MOST: Final = 200
"""So many lines are kept."""


class Line(NamedTuple):
    """A line as it is shown, and as it is left standing."""

    short: str
    full: str


class Log(io.TextIOBase):
    """The newest lines, as a stream that can be printed to; from any thread."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[Line] = deque(maxlen=MOST)
        self._begun = ""

    def add(self, line: str, short: str | None = None) -> None:
        """Add a line."""
        self._lines.append(Line(line if short is None else short, line))

    def lines(self) -> list[Line]:
        """The lines, the newest last."""
        return list(self._lines)

    def write(self, text: str) -> int:
        """Take the lines that are whole; one that differs from the last in numbers replaces it.

        A turtle at the wall is warned of 62 times a second.
        """
        *whole, self._begun = (self._begun + text).split("\n")
        for line in whole:
            if self._lines and _words(self._lines[-1].full) == _words(line):
                self._lines.pop()
            self.add(line)
        return len(text)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """A block in which what this process prints comes here, unless stderr goes elsewhere."""
        is_shown = sys.stderr is None or sys.stderr.isatty()
        with redirect_stdout(self), redirect_stderr(self) if is_shown else nullcontext():
            yield


def _words(line: str) -> str:
    return re.sub(r"[-\d.]+", "", line)
