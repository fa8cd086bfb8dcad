"""Parses the text of a .msg, .srv or .action file into a definition.

Each line declares a field or a constant. A field has a type, a name and perhaps a default; a
constant has a type, a name and a value. ``#`` starts a comment. `parse` ignores it; `read_comments`
finds the comments on each member: those beside it, those on the lines above it, or both. A line
``---`` separates the parts of a service or action. Each error gives the file, line and column, and
shows a caret below the column. This module reads only the text; the module ``classes`` checks
whether the messages that a definition uses exist.

Source: the ROS 2 article "Interface definition", and ``rosidl_adapter/parser.py``.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
from typing import TYPE_CHECKING, NamedTuple, NoReturn, cast

import msgspec

from turtleact.errors import InvalidInterface, InvalidMessage
from turtleact.interfaces.definition import (
    INTEGER_RANGES,
    PRIMITIVES,
    ArrayForm,
    CompoundDefinition,
    Constant,
    Field,
    FieldType,
    MessageDefinition,
    check_type_name,
    did_you_mean,
)
from turtleact.interfaces.values import converter

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import Definition, Primitive

__all__ = ["Comments", "Line", "parse", "parse_member", "read_comments", "without_comment"]

#: The name suffixes of each kind's parts.
PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}

#: Type names from other notations, and their names in ROS 2.
FOREIGN = {
    "int": "int32",
    "float": "float32",
    "double": "float64",
    "boolean": "bool",
    "str": "string",
    "time": "builtin_interfaces/Time",
    "duration": "builtin_interfaces/Duration",
}

#: A new message contains its fixed arrays, so one line of text must not demand gigabytes.
LONGEST_ARRAY = 1_000_000

member_pattern = re.compile(
    r"\s*(?P<type>\S+)(?:\s+(?P<name>[^\s=]+)\s*(?P<sign>=?)\s*(?P<value>.*?))?\s*"
)
type_pattern = re.compile(
    r"(?P<name>[A-Za-z][A-Za-z0-9_/]*)(?:<=(?P<string>\d{1,19}))?"
    r"(?:\[(?P<bound><=)?(?P<size>\d{0,19})\])?"
)
nested_pattern = re.compile(
    r"(?:(?P<package>[a-z](?:_?[a-z0-9])*)/(?:msg/)?)?(?P<name>[A-Z][A-Za-z0-9]*)"
)
quoted = r"""(?:"(?:\\"|[^"])*"|'(?:\\'|[^'])*')"""
item_pattern = re.compile(rf"\s*({quoted}|[^,\"'\s][^,]*?)\s*(?:,|$)")
comment_pattern = re.compile(rf"(?:(?<=[\s=\[,]){quoted}|[^#])*")


class Line(msgspec.Struct, frozen=True):
    """One line of the text, with its line number and the name of its source."""

    source: str
    number: int
    text: str

    def refuse(self, problem: str, column: int = 0) -> NoReturn:
        """Raise an error that points at a column of the line. The first column is 0."""
        raise InvalidInterface(
            problem, source=self.source, line=self.number, column=column + 1, text=self.text
        )


def parse(text: str, type_name: str, *, source: str = "") -> Definition:
    """Parse the text of an interface.

    The kind in ``type_name`` says whether the text is that of a message, a service or an action.

    Args:
        text: The text of a .msg, .srv or .action file.
        type_name: The full name, ``package/kind/Name``.
        source: The file to name in errors. If left out, errors show the type name.

    Raises:
        InvalidInterface: if the text is malformed. The error shows line, column and a caret.

    >>> parse("int32 order 5", "example_msgs/msg/Order").fields[0].default
    5
    """
    check_type_name(type_name)
    package, kind, _ = type_name.split("/")
    source = source or type_name
    lines = lines_of(text, source)
    names = [f"{type_name}{suffix}" for suffix in PARTS[kind]]
    sections = split(lines, kind)
    parts = [
        parse_part(section, name, package) for section, name in zip(sections, names, strict=True)
    ]
    return parts[0] if kind == "msg" else CompoundDefinition(type_name, tuple(parts))


_HAS = {
    1: "a message has only 1",
    2: "a service has 2 (request, response)",
    3: "an action has 3 (goal, result, feedback)",
}
"""Error texts, by the number of parts that an interface of some kind has."""


def lines_of(text: str, source: str) -> list[Line]:
    """Return the lines of a text."""
    texts = re.split("\r\n|\n|\r", text.removeprefix("\ufeff"))
    return [Line(source, number, line) for number, line in enumerate(texts, 1)]


def split(lines: list[Line], kind: str) -> list[list[Line]]:
    """Split the lines of an interface into its parts, which are separated by ``---``."""
    count = len(PARTS[kind])
    sections: list[list[Line]] = [[]]
    for line in lines:
        if without_comment(line.text).rstrip() != "---":
            sections[-1].append(line)
        elif len(sections) == count:
            line.refuse(f"this '---' begins part {count + 1}, but {_HAS[count]}")
        else:
            sections.append([])
    if len(sections) < count:
        found = "1 part" if len(sections) == 1 else f"{len(sections)} parts"
        marks = "a line '---' between each two of them, also if one is empty"
        lines[-1].refuse(f"the file has {found}, but {_HAS[count]}: write {marks}")
    return sections


def parse_part(lines: list[Line], type_name: str, package: str) -> MessageDefinition:
    """Parse the fields and constants of one part."""
    members: dict[str, Field | Constant] = {}
    for line in lines:
        text = without_comment(line.text)
        if not text.strip():
            continue
        member, column = parse_member(line, text, package)
        if member.name in members:
            line.refuse(f"'{member.name}' is declared twice", column)
        members[member.name] = member
    return MessageDefinition(
        type_name,
        tuple(m for m in members.values() if isinstance(m, Field)),
        tuple(m for m in members.values() if isinstance(m, Constant)),
    )


def parse_member(line: Line, text: str, package: str) -> tuple[Field | Constant, int]:
    """Return the field or constant that a line declares, and the column of its name."""
    match = member_pattern.fullmatch(text)
    if match is None or match["name"] is None:
        line.refuse("expected a type and a name", len(text.rstrip()))
    field_type = parse_type(line, match["type"], match.start("type"), package)
    column, value = match.start("name"), match["value"]
    try:
        if match["sign"]:
            constant = parse_value(line, field_type, value, match.start("value"))
            return Constant(match["name"], field_type, cast("Primitive", constant)), column
        default = parse_value(line, field_type, value, match.start("value")) if value else None
        return Field(match["name"], field_type, default), column
    except InvalidInterface as inner:
        if inner.line:
            raise
        line.refuse(inner.problem, column)


def parse_type(line: Line, text: str, column: int, package: str) -> FieldType:
    """Parse the type at the beginning of a line."""
    match = type_pattern.fullmatch(text)
    if match is None:
        line.refuse(f"'{text}' is not a type: write int32, int32[5], int32[<=5] or int32[]", column)
    name = full_name(line, match["name"], column, package)
    bound = int(match["string"]) if match["string"] else None
    if bound is not None and name not in ("string", "wstring"):
        line.refuse("only a string has a bound of its own", match.start("string") - 2 + column)
    form, size = ArrayForm.SINGLE, 0
    if match["size"] is not None:
        size = int(match["size"] or 0)
        form = ArrayForm.FIXED if size else ArrayForm.UNBOUNDED
        if match["bound"]:
            form = ArrayForm.BOUNDED
    if bound == 0 or (size == 0 and (match["size"] or match["bound"])):
        line.refuse("a bound or a length is at least 1", column)
    if form is ArrayForm.FIXED and size > LONGEST_ARRAY:
        line.refuse(f"a fixed array has at most {LONGEST_ARRAY} elements here", column)
    return FieldType(name, bound, form, size)


def full_name(line: Line, name: str, column: int, package: str) -> str:
    """Return the name of a primitive type unchanged, or the full name of a message."""
    if name in PRIMITIVES:
        return name
    match = nested_pattern.fullmatch(name)
    if match is None:
        hint = f", did you mean '{FOREIGN[name]}'?" if name in FOREIGN else ""
        line.refuse(f"unknown type '{name}'{hint or did_you_mean(name, PRIMITIVES)}", column)
    return f"{match['package'] or package}/msg/{match['name']}"


def parse_value(
    line: Line, field_type: FieldType, text: str, column: int
) -> Primitive | tuple[Primitive, ...]:
    """Parse the default of a field, or the value of a constant."""
    if field_type.is_nested:
        line.refuse(f"a message ({field_type}) cannot have a default", column)
    if not text and not field_type.is_string:
        line.refuse("expected a value after '='", column)
    if field_type.is_string and text[:1] in ("'", '"') and not re.fullmatch(quoted, text):
        line.refuse("a quote is opened but not closed", column)
    value = (
        parse_list(line, text, field_type.element, column=column)
        if field_type.is_sequence
        else literal(text, field_type)
    )
    try:
        checked = converter(field_type)(value)
    except InvalidMessage as misfit:
        where = f"element {misfit.path}: " if misfit.path else ""
        line.refuse(f"{where}{misfit.problem}", column)
    values = checked if isinstance(checked, list) else [checked]
    if any(isinstance(item, float) and not math.isfinite(item) for item in values):
        line.refuse(f"{text} is not finite", column)
    return tuple(checked) if isinstance(checked, list) else cast("Primitive", checked)


def parse_list(line: Line, text: str, element: FieldType, *, column: int) -> list[object]:
    """Parse a default in brackets, and return its elements."""
    if not (text.startswith("[") and text.endswith("]")):
        line.refuse("the default of a list must be in brackets, as in [1, 2]", column)
    inner = text[1:-1].strip()
    if not inner:
        return []
    items = []
    position = 0
    while position <= len(inner):
        match = item_pattern.match(inner, position)
        if match is None:
            line.refuse("expected values separated by commas", column)
        items.append(literal(match[1], element))
        position = match.end() if match[0].endswith(",") else len(inner) + 1
    return items


def literal(text: str, field_type: FieldType) -> object:
    """Convert a word to a value for this type. Return the word itself if it cannot be converted."""
    name = field_type.name
    if field_type.is_string:
        return unquoted(text)
    if name == "bool":
        return {"true": True, "1": True, "false": False, "0": False}.get(text.lower(), text)
    for read in NUMBERS[name]:
        with contextlib.suppress(ValueError):
            return read(text)
    return text


#: How a number is parsed, as in ``rosidl_adapter``: ``007`` is 7 and ``0x10`` is 16.
NUMBERS: dict[str, tuple[Callable[[str], object], ...]] = {
    **dict.fromkeys(INTEGER_RANGES, (int, functools.partial(int, base=0))),
    "float32": (float,),
    "float64": (float,),
}


def unquoted(text: str) -> str:
    """Remove the quotes around a text, if there are any.

    Inside the quotes, a backslash escapes only the quote character.
    """
    if not re.fullmatch(quoted, text):
        return text
    quote = text[0]
    return text[1:-1].replace(f"\\{quote}", quote)


def without_comment(text: str) -> str:
    """Remove the comment from a line. A ``#`` inside quotes does not begin a comment."""
    match = comment_pattern.match(text) if "#" in text else None
    return text if match is None else match[0]


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
