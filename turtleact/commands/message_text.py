"""Messages as text: what the user writes, and how a message is printed.

A message is written on the command line, or read from stdin or a file. ``topic pub`` and ``service
call`` print it as rclpy's ``repr`` does; an array of fixed length is shown as numpy shows it, but
always on one line.

Source: recordings of ROS 2 Jazzy; rosidl_generator_py ``resource/_msg.py.em`` for the notation.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.errors import UsageError
from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.text import block, listed
from turtleact.interfaces.types import fields

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.interfaces import Message
    from turtleact.interfaces.definition import Field

__all__ = ["GoalText", "python_text", "read_text_file", "yaml_lines"]

MOST = 2**22
"""How many bytes of a file or a pipe are read; no valid message is longer."""


class GoalText(NamedTuple):
    """The text of a goal, a request or a message.

    Attributes:
        text: YAML or JSON.
        source: The name of the text in errors, before line and column.
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
        """Read the text from an argument, from stdin or from a file; ``{}`` if none was given.

        Args:
            given: The argument.
            stdin: Whether to read stdin.
            path: The file to read.
            interrupts: The signals, which end the reading.
            what: What the text is: "goal", "request" or "message".

        Raises:
            UsageError: if the text cannot be read, is empty, is too long, or is not UTF-8.
            KeyboardInterrupt: if a signal comes during the reading.
        """
        if not stdin and path is None:
            text, source = "{}" if given is None else given, what
        else:
            source = "stdin" if path is None else path if path.isprintable() else ascii(path)
            text = _decoded(_read(path, source, interrupts, what), source)
        if not text.strip():  # the program that should have written it failed
            raise UsageError(f"{source}: is empty; the default {what} is {{}}")
        return cls(text, source)


def read_text_file(path: str, what: str) -> str:
    """Read a file, such as a configuration, and return its text.

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


READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""How a file is opened, on POSIX and on Windows."""


def _read_file(path: str, interrupts: Interrupts) -> bytes:
    if not path:
        raise UsageError("--goal-file: the path is empty")
    try:
        # Otherwise opening a named pipe would wait for a writer.
        file = os.open(path, READING)
    except ValueError:  # a null byte in the path
        raise UsageError("--goal-file: a path cannot contain a null character") from None
    try:
        return interrupts.read(file, MOST + 1)
    finally:
        os.close(file)


SILENT = frozenset({"float64", "int64", "bool"})
"""The types that numpy does not print."""

DTYPES = {"byte": "uint8", "char": "uint8"}
"""Types that have another name in numpy."""


def python_text(message: Message) -> str:
    """A message as rclpy's ``repr`` prints it.

    >>> from turtleact.interfaces.standard import Time
    >>> python_text(Time(sec=1))
    'builtin_interfaces.msg.Time(sec=1, nanosec=0)'
    """
    cls = type(message)
    values = ", ".join(
        f"{field.name}={_value(field, getattr(message, field.attribute))}" for field in fields(cls)
    )
    return f"{cls.type_name.replace('/', '.')}({values})"


def _value(field: Field, value: object) -> str:
    kind = field.type
    if kind.is_nested:
        if not kind.is_sequence:
            return python_text(value)  # type: ignore[arg-type]  # a message, as declared
        return f"[{', '.join(map(python_text, value))}]"  # type: ignore[call-overload]  # likewise
    if kind.is_sequence:
        items = f"[{', '.join(map(repr, value))}]"  # type: ignore[call-overload]  # likewise
        if kind.form is not ArrayForm.FIXED or kind.is_string:
            return items
        name = DTYPES.get(kind.name, kind.name)
        return f"array({items})" if name in SILENT else f"array({items}, dtype={name})"
    return repr(value)


def yaml_lines(value: object) -> list[str]:
    """A plain value as lines of block YAML; a scalar as Python prints it, as ros2 does."""
    if isinstance(value, dict) and value:
        return block(value)
    if isinstance(value, list | bytes) and value:
        return [line for item in value for line in listed(item)]
    return [str(list(value) if isinstance(value, bytes) else value)]
