"""Finds the comments on the fields of an interface.

In a .msg, .srv or .action file, the comment on a field stands beside the field or on the lines
directly above it. In a class, the comment stands under ``Attributes:`` in the docstring.

Source: the ROS 2 article "Interface definition", for the comments in files; Google's style guide,
for docstrings.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from functools import cache
from typing import TYPE_CHECKING

from turtleact.errors import TurtleactError
from turtleact.interfaces.definition import part_lines
from turtleact.interfaces.loading import authored_text, interface_source
from turtleact.interfaces.types import PARTS, REGISTRY, Action, Message, Service, definition

if TYPE_CHECKING:
    from turtleact.interfaces.types import Interface

__all__ = ["commented_text", "comments", "introduction"]

WIDTH = 80
"""Comments in the text of a class are wrapped to this many characters."""

field_pattern = re.compile(
    r"\s*[\w/]+(?:<=\d+)?(?:\[[^\]]*\])?\s+(?P<name>[a-z]\w*)(?P<value>[^#]*)(?:#\s*(?P<note>.*))?"
)
attribute_pattern = re.compile(r" {4}(\w+): (.*)")


def comments(cls: type[Message]) -> dict[str, str]:
    """Return the comments on a message's fields, by field name.

    A comment in a file takes precedence over one in a docstring.

    >>> class Move(Message, type_name="example_msgs/msg/Move"):
    ...     '''A move.
    ...
    ...     Attributes:
    ...         speed: How fast to go
    ...             at most (m/s).
    ...     '''
    ...
    ...     speed: float = 1.0
    >>> comments(Move)
    {'speed': 'How fast to go at most (m/s).'}
    """
    whole, _, part = cls.type_name.rpartition("_")
    index = SECTIONS.get(part)
    if index is None or whole.count("/") != 2:
        whole, index = cls.type_name, 0
    text = REGISTRY.texts.get(cls)
    found = _in_file(whole) if text is None else _in_text(text)
    return _in_docstring(cls) | dict(found[index])


SECTIONS = {"Goal": 0, "Result": 1, "Feedback": 2, "Request": 0, "Response": 1}


def introduction(cls: type[Message | Service | Action]) -> str:
    """Return what an interface is for: the first paragraph of its docstring.

    The text is empty if the class has no docstring of its own.
    """
    doc = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
    return " ".join(doc.partition("\n\n")[0].split())


def commented_text(cls: Interface) -> str:
    """Return the text of an interface with its comments.

    If the interface has a file, the text is that of the file. If there is no file, the text is
    generated, with the comments from the docstrings of the classes.

    >>> class Move(Message, type_name="example_msgs/msg/Move"):
    ...     '''A move.
    ...
    ...     Attributes:
    ...         speed: How fast to go (m/s).
    ...     '''
    ...
    ...     speed: float = 1.0
    >>> print(commented_text(Move))
    # A move.
    <BLANKLINE>
    # How fast to go (m/s).
    float64 speed 1.0
    """
    text = authored_text(cls)
    if text:
        return text
    if issubclass(cls, Message):
        return "\n".join(_part_text(cls))
    kind = "action" if issubclass(cls, Action) else "srv"
    parts = [_part_text(getattr(cls, part)) for part in PARTS[kind]]
    lines = [*_set_off(introduction(cls)), *parts[0]]
    for part in parts[1:]:
        lines += ["---", *part]
    return "\n".join(lines)


def _part_text(cls: type[Message]) -> list[str]:
    """Return the lines of one part of an interface, with the comments from its docstring."""
    part, notes = definition(cls), _in_docstring(cls)
    lines = _set_off(introduction(cls))
    names = [*(each.name for each in part.constants), *(each.name for each in part.fields)]
    for name, line in zip(names, part_lines(part), strict=True):
        lines += [*_as_comment(notes.get(name, "")), line]
    return lines


def _set_off(text: str) -> list[str]:
    """Return a text as comment lines and an empty line. An empty text gives no lines."""
    return [*_as_comment(text), ""] if text else []


def _as_comment(text: str) -> list[str]:
    """Wrap a text into lines that begin with ``#``. Double backticks become single ones."""
    plain = text.replace("``", "`")
    return textwrap.wrap(plain, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _in_docstring(cls: type[Message]) -> dict[str, str]:
    doc = inspect.cleandoc(cls.__doc__ or "")
    found: dict[str, str] = {}
    name = ""
    for line in doc.partition("Attributes:\n")[2].splitlines():
        begun = attribute_pattern.fullmatch(line)
        if begun:
            name = begun[1]
            found[name] = begun[2]
        elif not line.startswith(" " * 8):
            break
        else:
            found[name] += f" {line.strip()}"
    return found


@cache
def _in_file(type_name: str) -> tuple[dict[str, str], ...]:
    """Return the comments in an interface's file; see `_in_text`."""
    try:
        return _in_text(interface_source(type_name))
    except TurtleactError:  # the class was made by hand
        return _in_text("")


@cache
def _in_text(text: str) -> tuple[dict[str, str], ...]:
    """Return the comments in the text of an interface, in three dicts: one for each part.

    If the interface has fewer than three parts, the remaining dicts are empty.
    """
    sections = re.split(r"^---\s*$", text, flags=re.MULTILINE)[:3]
    notes = [_in_section(section) for section in sections]
    return (*notes, *({} for _ in range(3 - len(notes))))


def _in_section(section: str) -> dict[str, str]:
    """Return the comment of each field: the one beside the field, or else the lines above it."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in section.splitlines():
        text = line.strip()
        if text.startswith("#"):
            above.append(text.lstrip("#").strip())
            continue
        match = field_pattern.fullmatch(line)
        note = (match["note"] or " ".join(filter(None, above))) if match else ""
        if match and note:
            found[match["name"]] = note
        above = []
    return found
