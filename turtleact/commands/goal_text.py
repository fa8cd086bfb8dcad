"""Where the text of a goal, or another message, comes from: the arguments, stdin, or a file."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["GoalText", "read_text_file"]

MOST = 2**22
"""Bytes that are read of a file or a pipe: no message that is taken is longer."""


class GoalText(NamedTuple):
    """The text of a goal, a request or a message.

    Attributes:
        text: YAML or JSON.
        source: What an error calls it before line and column.
    """

    text: str
    source: str

    @classmethod
    def read(
        cls,
        given: str | None,
        *,
        stdin: bool,
        path: str | None,
        interrupts: Interrupts,
        what: str = "goal",
    ) -> GoalText:
        """The text from the one of the three that was chosen; ``{}`` if none was.

        Args:
            given: What stands among the arguments.
            stdin: Whether stdin is read.
            path: The file that is read.
            interrupts: The signals that end the reading.
            what: What the text is of.

        Raises:
            UsageError: if it cannot be read, is empty, is too long, or is not UTF-8.
            KeyboardInterrupt: if a signal comes while it is waited for.
        """
        if not stdin and path is None:
            text, source = "{}" if given is None else given, what
        else:
            source = "stdin" if path is None else path if path.isprintable() else ascii(path)
            text = _decoded(_read(path, source, interrupts, what), source)
        if not text.strip():  # whoever was to say it has failed
            raise UsageError(f"{source}: is empty; the default {what} is {{}}")
        return cls(text, source)


def read_text_file(path: str, what: str) -> str:
    """The text of a file, such as a configuration, that is read at once.

    Args:
        path: Where the file is.
        what: How an error begins: the option, and the file.

    Raises:
        UsageError: if the file cannot be read, is longer than `MOST` bytes, or is not UTF-8.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(MOST + 1)
        if len(data) > MOST:
            raise UsageError(f"{what}: is longer than {MOST} bytes")
        return data.decode()
    except OSError as error:
        raise UsageError(f"{what}: {error.strerror}") from None
    except ValueError:  # not UTF-8, or a null character in the path
        raise UsageError(f"{what}: it is not UTF-8") from None


def _read(path: str | None, source: str, interrupts: Interrupts, what: str) -> bytes:
    try:
        data = _read_stdin(interrupts) if path is None else _read_file(path, interrupts)
    except OSError as error:
        raise UsageError(f"{source}: cannot be read: {error.strerror}") from None
    if len(data) > MOST:
        raise UsageError(f"{source}: is longer than {MOST} bytes; no {what} is")
    return data


def _decoded(data: bytes, source: str) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{source}: is not UTF-8: byte 0x{data[error.start]:02X} at {error.start}"
        ) from None


def _read_stdin(interrupts: Interrupts) -> bytes:
    if sys.stdin is None:
        raise UsageError("stdin: is closed")
    return interrupts.read(sys.stdin.fileno(), MOST + 1)


def _read_file(path: str, interrupts: Interrupts) -> bytes:
    if not path:
        raise UsageError("--goal-file: the path is empty")
    try:
        # Else a named pipe that nobody writes to would be waited for here.
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError:  # a null byte in the path
        raise UsageError("--goal-file: a path holds no null character") from None
    try:
        return interrupts.read(file, MOST + 1)
    finally:
        os.close(file)
