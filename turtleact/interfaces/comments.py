"""Finds the comments on the fields of an interface.

In a .msg, .srv or .action file, the comments on a field stand beside the field, on the lines above
it, or both. In a class, the comment stands under ``Attributes:`` in the docstring.

Source: the ROS 2 article "Interface definition", for the comments in files; Google's style guide,
for docstrings.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, cast

import msgspec

from turtleact.errors import TurtleactError
from turtleact.interfaces.definition import part_lines
from turtleact.interfaces.loading import authored_text, interface_source
from turtleact.interfaces.parse import Line, lines_of, member_pattern, split, without_comment
from turtleact.interfaces.types import REGISTRY, Action, Message, Service, definition, parts

if TYPE_CHECKING:
    from turtleact.interfaces.types import Interface

__all__ = ["Comments", "commented_text", "comments", "introduction", "read_comments"]

WIDTH = 80
"""Comments in the text of a class are wrapped to this many characters."""

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
    found = _in_file(whole) if text is None else read_comments(text, whole)
    return _in_docstring(cls) | (found[index].texts() if found else {})


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
    first, *rest = map(_part_text, parts(cls))
    lines = [*_set_off(introduction(cls)), *first]
    for part in rest:
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
def _in_file(type_name: str) -> tuple[Comments, ...]:
    """Return the comments in an interface's file."""
    try:
        return read_comments(interface_source(type_name), type_name)
    except TurtleactError:  # the class was made by hand, or the type is derived
        return ()


class Comments(msgspec.Struct, frozen=True):
    """The comments on one part of an interface, without their ``#``.

    Attributes:
        about: The comment on the whole part: the lines at the top before a blank line, and the
            lines below the last member.
        first: The comment directly above the first member, which may describe the whole part.
            ``first`` is empty if the part has a second comment above its first member, or a comment
            above a later member.
        members: The comments above and after each field and constant, by name. The comment in
            ``first`` is left out.
    """

    about: tuple[str, ...] = ()
    first: tuple[str, ...] = ()
    members: dict[str, tuple[str, ...]] = {}

    def of(self, name: str) -> tuple[str, ...]:
        """Return the comments on a field or constant."""
        return self.members.get(name, ())

    def texts(self) -> dict[str, str]:
        """Return the comments on each field and constant that has any, on one line."""
        lines = dict(self.members)
        for name in tuple(lines)[:1]:
            lines[name] = (*self.first, *lines[name])
        return {name: " ".join(filter(None, each)) for name, each in lines.items() if each}


def read_comments(text: str, type_name: str) -> tuple[Comments, ...]:
    r"""Return the comments in the text of an interface, one entry per part.

    Args:
        text: The text of an interface, which `parse` must accept.
        type_name: The full name of the interface.

    >>> text = "# A place.\nfloat64 x  # in metres"
    >>> [comments] = read_comments(text, "example_msgs/msg/Place")
    >>> comments.first, comments.of("x")
    (('A place.',), ('in metres',))
    """
    sections = split(lines_of(text, type_name), type_name.split("/")[1])
    return tuple(map(part_comments, sections))


class Commented(NamedTuple):
    """The name of a field or constant, with the comment lines above it and after it."""

    name: str
    above: list[str]
    behind: list[str]


def part_comments(lines: list[Line]) -> Comments:
    """Return the comments on one part of an interface."""
    entries, left = commented(lines)
    about, top = set_off(entries[0].above) if entries else ([], [])
    is_lone = bool(top) and not about and not any(any(entry.above) for entry in entries[1:])
    members = {entry.name: trimmed([*entry.above, *entry.behind]) for entry in entries}
    if entries:
        name, _, behind = entries[0]
        members[name] = trimmed(behind if is_lone else [*top, *behind])
    return Comments(trimmed([*about, "", *left]), tuple(top) if is_lone else (), members)


def commented(lines: list[Line]) -> tuple[list[Commented], list[str]]:
    """Return the members of a part with their comments, and the comment below the last member.

    A comment on a line of its own belongs to the member below the comment. However, an indented
    line directly below a trailing comment continues the trailing comment.
    """
    entries: list[Commented] = []
    above: list[str] = []
    is_behind = False
    for line in lines:
        code = without_comment(line.text)
        comment = uncommented(line.text[len(code) :])
        if code.strip():
            match = cast("re.Match[str]", member_pattern.fullmatch(code))
            entries.append(Commented(match["name"], above, [comment] * bool(comment)))
            above, is_behind = [], bool(comment)
        elif is_behind and comment and line.text[0].isspace():
            entries[-1].behind.append(comment)
        else:
            above.append(comment)
            is_behind = False
    return entries, above


def set_off(above: list[str]) -> tuple[list[str], list[str]]:
    """Split the comment above a field or constant.

    Return the lines about the whole message, then the lines about the field or constant.
    """
    blank = max((index for index, line in enumerate(above) if not line), default=-1)
    return (
        (above[:blank], above[blank + 1 :])
        if any(above[: max(blank, 0)])
        else ([], above[blank + 1 :])
    )


def trimmed(lines: list[str]) -> tuple[str, ...]:
    """Remove the blank lines at the beginning and at the end."""
    text = "\n".join(lines).strip("\n")
    return tuple(text.split("\n")) if text else ()


def uncommented(text: str) -> str:
    """Return the text of a comment without the leading ``#``; empty if there is no text."""
    said = text.lstrip("#").expandtabs().rstrip()
    return "".join(c for c in said.removeprefix(" ") if c.isprintable())
