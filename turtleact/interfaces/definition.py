"""The parsed form of a .msg, .srv or .action, before it becomes a class.

Definitions are frozen and compared by value. Two declarations of one interface are equal, even if
one comes from a file and the other from a class. This module neither parses text nor makes Python
classes.

Source: the ROS 2 article "Interface definition", and ``rosidl_adapter/parser.py``.
"""

from __future__ import annotations

import enum
import keyword
import re
from typing import TYPE_CHECKING, TypeAlias

import msgspec

from turtleact.errors import InvalidInterface

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "BYTE_TYPES",
    "INTEGER_RANGES",
    "PRIMITIVES",
    "ArrayForm",
    "CompoundDefinition",
    "Constant",
    "Definition",
    "Field",
    "FieldType",
    "MessageDefinition",
    "Primitive",
    "check_type_name",
    "constant_name_pattern",
    "definition_text",
    "did_you_mean",
    "is_bytes",
    "names_like",
    "nearest",
    "part_lines",
    "parts_of",
    "type_name_pattern",
    "zero",
]

type_name_pattern = re.compile(
    r"(?P<package>[a-z](?:_?[a-z0-9])*)/(?P<kind>msg|srv|action)"
    r"/(?P<name>[A-Z][A-Za-z0-9]*(?:_[A-Z][A-Za-z0-9]*)*)"
)
field_name_pattern = re.compile(r"[a-z](?:_?[a-z0-9])*")
constant_name_pattern = re.compile(r"[A-Z](?:_?[A-Z0-9])*")

#: The smallest and largest value of each integer type; ``char`` is a uint8 in ROS 2.
INTEGER_RANGES = {
    "byte": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
}

#: Element types whose sequences may also be ``bytes`` in Python.
BYTE_TYPES = frozenset({"byte", "char", "uint8"})

#: How many names an error lists if none of them resembles the unknown name.
MOST_SHOWN = 10

Primitive: TypeAlias = bool | int | float | str

#: Every primitive type and its zero value.
PRIMITIVES: dict[str, Primitive] = {
    "bool": False,
    **dict.fromkeys(INTEGER_RANGES, 0),
    "float32": 0.0,
    "float64": 0.0,
    "string": "",
    "wstring": "",
}


class ArrayForm(enum.Enum):
    """Whether a field holds one element or a sequence.

    The value of each member is the suffix of the element type in a .msg file, such as ``[]``.
    """

    SINGLE = ""
    FIXED = "[{size}]"
    BOUNDED = "[<={size}]"
    UNBOUNDED = "[]"


class FieldType(msgspec.Struct, frozen=True):
    """The type of a field or constant. ``str`` returns the type in .msg syntax.

    Attributes:
        name: A primitive (``int32``) or the full name of a message (``geometry_msgs/msg/Point``).
        string_bound: The maximum length of a bounded string, or None.
        form: Whether the field holds a single element or a sequence, and which kind of sequence.
        size: The length of a fixed array, or the maximum length of a bounded one; otherwise 0.
    """

    name: str
    string_bound: int | None = None
    form: ArrayForm = ArrayForm.SINGLE
    size: int = 0

    def __str__(self) -> str:
        bound = "" if self.string_bound is None else f"<={self.string_bound}"
        return f"{self.name}{bound}{self.form.value.format(size=self.size)}"

    @property
    def is_nested(self) -> bool:
        """Whether the field holds a message or a sequence of messages."""
        return self.name not in PRIMITIVES

    @property
    def is_sequence(self) -> bool:
        """Whether the field holds a sequence."""
        return self.form is not ArrayForm.SINGLE

    @property
    def is_string(self) -> bool:
        """Whether the field holds a text or a sequence of texts."""
        return self.name in ("string", "wstring")

    @property
    def element(self) -> FieldType:
        """The type of one element, or the whole type if the field is not a sequence."""
        return FieldType(self.name, self.string_bound)


def zero(field_type: FieldType) -> Primitive | tuple[Primitive, ...] | None:
    """Return the initial value of a field that has this type and no default in the interface.

    For a field of messages, the result is None: the fields of each message have their own initial
    values.
    """
    if field_type.is_nested:
        return None
    element = PRIMITIVES[field_type.name]
    if not field_type.is_sequence:
        return element
    return (element,) * field_type.size if field_type.form is ArrayForm.FIXED else ()


def is_bytes(field_type: FieldType) -> bool:
    """Whether a class generated from a definition stores a field of this type as ``bytes``.

    This is true only for a uint8 array of fixed length.
    """
    return field_type.name == "uint8" and field_type.form is ArrayForm.FIXED


class Field(msgspec.Struct, frozen=True):
    """One field of a message.

    Attributes:
        name: The field's name in ROS, as in a .msg.
        type: The field's type.
        default: The default in the interface; None if there is none, or if it equals `zero` of the
            type.
    """

    name: str
    type: FieldType
    default: Primitive | tuple[Primitive, ...] | None = None

    def __post_init__(self) -> None:
        if not field_name_pattern.fullmatch(self.name):
            problem = (
                f"'{self.name}' is not a valid field name: use lower case, digits and single "
                "underscores, from a letter to a letter or digit"
            )
            raise InvalidInterface(problem, source=self.name)
        # Compare by repr, because == does not tell 0.0 from -0.0, or 0 from False.
        if self.default is not None and repr(self.default) == repr(zero(self.type)):
            msgspec.structs.force_setattr(self, "default", None)

    @property
    def attribute(self) -> str:
        """The field's name in Python; a keyword gets an underscore at its end (``from_``)."""
        return f"{self.name}_" if keyword.iskeyword(self.name) else self.name


class Constant(msgspec.Struct, frozen=True):
    """A named value of an interface. Constants are never sent."""

    name: str
    type: FieldType
    value: Primitive

    def __post_init__(self) -> None:
        if not constant_name_pattern.fullmatch(self.name):
            problem = (
                f"'{self.name}' is not a valid constant name: use capitals, digits and single "
                "underscores, from a letter to a letter or digit"
            )
            raise InvalidInterface(problem, source=self.name)
        if self.type.is_nested or self.type.is_sequence:
            problem = f"a constant is a number, a bool or a string, not {self.type}"
            raise InvalidInterface(problem, source=self.name)


class MessageDefinition(msgspec.Struct, frozen=True):
    """A .msg, or one part of a .srv or .action."""

    type_name: str
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()

    def __post_init__(self) -> None:
        check_type_name(self.type_name)
        seen: set[str] = set()
        members: tuple[Field | Constant, ...] = (*self.fields, *self.constants)
        for member in members:
            if member.name in seen:
                raise InvalidInterface(f"'{member.name}' is declared twice", source=self.type_name)
            seen.add(member.name)


class CompoundDefinition(msgspec.Struct, frozen=True):
    """A .srv or .action.

    Attributes:
        type_name: The full name.
        parts: The messages: request and response, or goal, result and feedback.
    """

    type_name: str
    parts: tuple[MessageDefinition, ...]


Definition: TypeAlias = MessageDefinition | CompoundDefinition


def definition_text(definition: Definition) -> str:
    """Return a definition as the text of a .msg, .srv or .action, without a final line break.

    Raises:
        InvalidInterface: if a default cannot be written in such a text, for example because it has
            a line break.
    """
    first, *rest = parts_of(definition)
    lines = part_lines(first)
    for part in rest:
        lines += ["---", *part_lines(part)]
    return "\n".join(lines)


def parts_of(definition: Definition) -> tuple[MessageDefinition, ...]:
    """Return the definitions of the messages in an interface, in the order of its text."""
    return (definition,) if isinstance(definition, MessageDefinition) else definition.parts


def check_type_name(type_name: str, *, kinds: tuple[str, ...] = ("msg", "srv", "action")) -> None:
    """Check that a text is the full name of an interface of one of these kinds.

    Raises:
        InvalidInterface: if the text is not such a name; the error shows an example.
    """
    match = type_name_pattern.fullmatch(type_name)
    if match is None or match["kind"] not in kinds:
        example = f"package_name/{kinds[-1]}/InterfaceName"
        problem = f"'{type_name}' is not a full interface name: write it as {example}"
        raise InvalidInterface(problem, source=type_name)


def part_lines(part: MessageDefinition) -> list[str]:
    """Return the lines of one part of an interface: its constants, then its fields."""
    package = part.type_name.partition("/")[0]
    lines = [f"{c.type} {c.name}={literal(c.value)}" for c in part.constants]
    for field in part.fields:
        said = str(field.type).removeprefix(f"{package}/msg/").replace("/msg/", "/")
        default = "" if field.default is None else f" {literal(field.default)}"
        lines.append(f"{said} {field.name}{default}")
    return lines


def literal(value: Primitive | tuple[Primitive, ...]) -> str:
    """Return a value as it is written in the text of an interface."""
    if isinstance(value, tuple):
        return f"[{', '.join(literal(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if not isinstance(value, str):
        return repr(value)
    quote = "'" if '"' in value else '"'
    if set(value) & {"\n", "\r"} or (quote in value and "\\" in value) or value.endswith("\\"):
        problem = f"the default {value!r} cannot be written in the text of an interface"
        raise InvalidInterface(problem, source="text")
    shielded = value.replace(quote, f"\\{quote}")
    return f"{quote}{shielded}{quote}"


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the known word that is most similar to ``word``; empty if none is similar."""
    import difflib  # only errors need it

    words = list(known)
    folded = {each.casefold(): each for each in words}
    found = difflib.get_close_matches(word, words, n=1)
    return found[0] if found else folded.get(word.casefold(), "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of an error that suggests a known word; empty if no known word is similar.

    >>> did_you_mean("float46", PRIMITIVES)
    ", did you mean 'float64'?"
    """
    suggestion = nearest(word, known)
    return f", did you mean '{suggestion}'?" if suggestion else ""


def names_like(name: str, known: Iterable[str]) -> str:
    """Return a hint for an error about an unknown name: the nearest name, or a list of names."""
    names = sorted(set(known))
    shown = ", ".join([*names[:MOST_SHOWN], *(["…"] if len(names) > MOST_SHOWN else [])])
    return did_you_mean(name, names) or f" (there are: {shown or 'none'})"
