"""Prints the output of commands: text on stdout, and notes on stderr.

Another node can put any characters into its names and messages, and control characters could change
the user's terminal. So text that may come from another node is escaped before it is printed on a
terminal.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NoReturn, TextIO

from turtleact.errors import UsageError

__all__ = [
    "ELSEWHERE",
    "abandon",
    "counted",
    "duration",
    "leave",
    "note",
    "printable",
    "say",
    "say_lines",
    "say_message",
    "say_names",
    "say_table",
    "write_file",
]

ELSEWHERE = (
    "source the ROS workspace that has the interface, give --interfaces DIR, or change to the "
    "folder of its package"
)
"""The advice for an unknown interface."""


def say(text: str) -> None:
    """Print a text on stdout and flush stdout. No line break is added."""
    print(text, end="", flush=True)


def say_message(text: str) -> None:
    """Print the text of a message. On a terminal, control characters are escaped."""
    is_terminal = sys.stdout is not None and sys.stdout.isatty()
    say(printable(text) if is_terminal else text)


def say_names(text: str) -> None:
    """Print text with names from the graph, and escape its control characters."""
    say(printable(text))


def say_lines(lines: Iterable[str]) -> None:
    """Print lines with names from the graph, and escape their control characters."""
    say_names("".join(f"{line}\n" for line in lines))


def say_table(rows: Iterable[Sequence[str]], widths: list[int] | None = None) -> None:
    """Print rows of names in columns.

    Args:
        rows: The rows, at least one.
        widths: The minimum widths of the columns. This function increases the widths in place if
            ``rows`` need more space. To print one table in parts, pass the same list for each part.
    """
    rows = list(rows)
    widths = [0] * len(rows[0]) if widths is None else widths
    columns = zip(*rows, strict=True)
    widths[:] = [max(w, *map(len, column)) for w, column in zip(widths, columns, strict=True)]
    say_lines("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 goal`` or ``2 goals``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def duration(seconds: float) -> str:
    """Return a duration as text, such as ``12.3 s``, ``5 min 3 s`` or ``2 h 7 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def note(text: str) -> None:
    """Print a line on stderr. If stderr is closed, do nothing."""
    if sys.stderr is None:
        return
    try:
        print(f"turtleact: {printable(text)}", file=sys.stderr, flush=True)
    except OSError:
        abandon(sys.stderr)


def leave(status: int) -> NoReturn:
    """Flush stdout and stderr, and end the process at once, without any other clean-up."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    os._exit(status)


def write_file(path: Path, text: str) -> None:
    """Write a file, and create the folders that it needs.

    Raises:
        UsageError: if the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from None


def printable(text: str) -> str:
    """Escape the control characters of a text, except line breaks, for a terminal."""
    if text.replace("\n", "").isprintable():  # most texts are, and some are long
        return text
    return "".join(c if c.isprintable() or c == "\n" else _escaped(c) for c in text)


def abandon(stream: TextIO) -> None:
    """Redirect a stream to `os.devnull`, so that Python can flush it without an error at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
