"""Makes checked copies of messages, and converts dicts and times to messages and back.

``snapshot`` runs for every goal, feedback and result, so it must be fast. This module therefore
generates a function for each message class. That function makes a few comparisons per field,
allocates only the copy, and accepts only values of exactly the expected Python type. The module
``values`` converts all other values, or reports what is wrong.

Source: builtin_interfaces/msg/Time, for the times.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces.definition import (
    BYTE_TYPES,
    INTEGER_RANGES,
    ArrayForm,
    did_you_mean,
    zero,
)
from turtleact.interfaces.standard.builtin_interfaces.msg import Time
from turtleact.interfaces.types import Message, constructor, fields, nested_classes
from turtleact.interfaces.values import FLOAT32_LIMIT, converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import Field, FieldType

__all__ = [
    "SECOND",
    "Source",
    "compiled",
    "error_class",
    "from_dict",
    "name_of",
    "nanoseconds",
    "snapshot",
    "snapshotter",
    "stamp_of",
    "to_dict",
]

M = TypeVar("M", bound=Message)

SECOND: Final = 1_000_000_000
"""The length of a second (ns)."""


def snapshot(message: M) -> M:
    """Return a deep copy of a message, with each value checked against its type.

    Each value in the copy has exactly the field's type: plain ints, floats and lists. A sequence of
    bytes given as ``bytes`` stays ``bytes``; every other sequence becomes a list. Floats may be
    infinite or nan.

    Raises:
        InvalidMessage: if a value does not fit its type; the error has the path of the first such
            value.

    >>> from turtleact.interfaces.standard import Point
    >>> snapshot(Point(x=1, y=2.5))
    Point(x=1.0, y=2.5, z=0.0)
    """
    if not isinstance(message, Message):
        raise InvalidMessage("message", f"expected a message, got {describe(message)}")
    return snapshotter(type(message))(message)


def snapshotter(cls: type[M], *, root: str = "message") -> Callable[[M], M]:
    """Return the function that ``snapshot`` uses for this class.

    If you copy many messages of one class, call ``snapshotter`` once and keep the function that it
    returns. That function also accepts a message of another class with the same type name and
    fields, and converts that message.

    Args:
        cls: The class of the copies.
        root: The first word of the path in errors. If it is ``goal``, the errors are of the class
            ``InvalidGoal``.
    """
    return compiled(cls, root)


def to_dict(message: Message) -> dict[str, object]:
    """Convert a message to a dict of plain values. Nested messages become dicts, too.

    Raises:
        InvalidMessage: if a value in the message does not fit its type.
    """
    return plain(snapshot(message))


def from_dict(cls: type[M], mapping: Mapping[str, object], *, root: str = "message") -> M:
    """Make a message of this class from a mapping of field names to values.

    Missing fields keep their defaults. A nested message may be a mapping or a message.

    Args:
        cls: The class of the message.
        mapping: The values, by the ROS names of the fields.
        root: The first word of the path in errors. If it is ``goal``, the errors are of the class
            ``InvalidGoal``.

    Raises:
        InvalidMessage: if a value does not fit, or a field is unknown; the error has the path of
            the first such value or field.
    """
    try:
        return filled(cls, mapping)
    except InvalidMessage as inner:
        raise error_class(root)(f"{root}{inner.path}", inner.problem) from None


def nanoseconds(stamp: Time) -> int:
    """Convert a ``Time`` message to nanoseconds since the epoch.

    >>> nanoseconds(Time(sec=1, nanosec=2))
    1000000002
    """
    return stamp.sec * SECOND + stamp.nanosec


def stamp_of(time: int) -> Time:
    """Convert nanoseconds since the epoch to a ``Time`` message.

    >>> stamp_of(1_000_000_002)
    Time(sec=1, nanosec=2)
    """
    return Time(*divmod(time, SECOND))


def error_class(root: str) -> type[InvalidMessage]:
    """Return the exception class for errors in a message whose path begins with ``root``."""
    return InvalidGoal if root == "goal" else InvalidMessage


class Source:
    """The source code of a function, built line by line, and the objects that the function uses."""

    def __init__(self, signature: str) -> None:
        self.lines = [f"def function({signature}):"]
        self.names: dict[str, object] = {}
        self.count = 0
        self.depth = 1

    def add(self, line: str) -> None:
        """Add a statement."""
        self.lines.append(" " * self.depth + line)

    def fresh(self, prefix: str = "v") -> str:
        """Return a variable name that is not used yet."""
        self.count += 1
        return f"{prefix}{self.count}"

    def hold(self, value: object) -> str:
        """Make an object available to the generated code, and return its variable name there."""
        name = self.fresh("k")
        self.names[name] = value
        return name

    def function(self) -> Callable[..., object]:
        """Compile the function.

        Running the code is safe: interfaces contribute only identifiers and numbers to the code.
        """
        exec("\n".join(self.lines), self.names)  # noqa: S102
        return self.names["function"]  # type: ignore[return-value]  # the text defines it


@functools.cache
def compiled(cls: type[M], root: str) -> Callable[[M], M]:
    """Return the generated function that checks and copies messages of this class.

    For nested messages, ``root`` is empty, because the function for the outer message adds the
    beginning of the path to an error.
    """
    error = error_class(root)

    def fail(inner: InvalidMessage) -> InvalidMessage:
        return error(root + inner.path, inner.problem)

    source = Source("m")
    source.names |= {"cls": cls, "adapt": functools.partial(adapted, cls), "fail": fail}
    source.names |= {"make": constructor(cls), "InvalidMessage": InvalidMessage}
    source.add("try:")
    source.depth += 1
    source.add("if type(m) is not cls: m = adapt(m)")
    pairs = zip(fields(cls), nested_classes(cls), strict=True)
    values = [add_field(source, field, nested) for field, nested in pairs]
    source.add(f"return make({', '.join(values)})")
    source.depth -= 1
    source.add("except InvalidMessage as inner: raise fail(inner) from None")
    return source.function()  # type: ignore[return-value]  # the text is made to be so


def adapted(cls: type[M], value: object) -> M:
    """Convert a message of another class with the same type name and fields to this class."""
    if not isinstance(value, Message):
        raise InvalidMessage("", f"expected a message ({name_of(cls)}), got {describe(value)}")
    given = type(value)
    if given.type_name != cls.type_name:
        raise InvalidMessage("", f"expected {name_of(cls)}, not {name_of(given)}")
    if fields(given) != fields(cls):
        problem = f"expected {name_of(cls)}, not a message of that name with other fields"
        raise InvalidMessage("", problem)
    return cls(*[getattr(value, field.attribute) for field in fields(cls)])


def name_of(cls: type[Message]) -> str:
    """Return the ROS name of a class, or its Python name if it has no ROS name."""
    return cls.type_name or cls.__qualname__


def placed(field: Field, convert: Callable[[object], object], value: object) -> object:
    """Convert the value of one field with ``convert``. Add the field's name to any error."""
    try:
        return convert(value)
    except InvalidMessage as inner:
        raise InvalidMessage(f".{field.name}{inner.path}", inner.problem) from None


def add_field(source: Source, field: Field, nested: type[Message] | None) -> str:
    """Add code that checks and copies one field, and return the variable of the copy."""
    copy = None if nested is None else compiled(nested, "")
    value = source.fresh()
    convert = source.hold(functools.partial(placed, field, converter(field.type, copy)))
    slow = f"{value} = {convert}({value})"
    source.add(f"{value} = m.{field.attribute}")
    if field.type.is_sequence:
        add_sequence(source, field.type, copy, value, slow)
    elif copy is not None:
        add_guarded(source, f"{value} = {source.hold(copy)}({value})", slow)
    else:
        source.add(f"if {misses(field.type, value)}: {slow}")
    return value


def add_sequence(
    source: Source, field_type: FieldType, copy: object, value: str, slow: str
) -> None:
    """Add code that checks the elements of a sequence and then copies the sequence."""
    word, length = "if", wrong_length(field_type, value)
    if field_type.name in BYTE_TYPES:
        source.add(f"if type({value}) is bytes and not ({length}): pass")
        word = "elif"
    source.add(f"{word} type({value}) is not list or {length}: {slow}")
    source.add("else:")
    source.depth += 1
    if copy is not None:
        add_guarded(source, f"{value} = list(map({source.hold(copy)}, {value}))", slow)
    else:
        source.add(f"for x in {value}:")
        source.add(f" if {misses(field_type.element, 'x')}: {slow}; break")
        source.add(f"else: {value} = {value}.copy()")
    source.depth -= 1


def add_guarded(source: Source, fast: str, slow: str) -> None:
    """Add code that runs ``fast``. If ``fast`` raises InvalidMessage, the code runs ``slow``.

    ``slow`` finds the element that does not fit.
    """
    source.add("try:")
    source.add(f" {fast}")
    source.add(f"except InvalidMessage: {slow}")


def misses(field_type: FieldType, value: str) -> str:
    """Return an expression that is true if a value has the wrong Python type or is out of range.

    The expression is also true for text that is not ASCII, because the text may contain an unpaired
    surrogate.
    """
    name = field_type.name
    if name == "bool":
        return f"{value} is not True and {value} is not False"
    if name == "float64":
        return f"type({value}) is not float"
    if name == "float32":
        return f"type({value}) is not float or not -{FLOAT32_LIMIT!r} < {value} < {FLOAT32_LIMIT!r}"
    if field_type.is_string:
        bound = field_type.string_bound
        longer = "" if bound is None else f" or len({value}) > {bound}"
        return f"type({value}) is not str or not {value}.isascii(){longer}"
    low, high = INTEGER_RANGES[name]
    return f"type({value}) is not int or not {low} <= {value} <= {high}"


def wrong_length(field_type: FieldType, value: str) -> str:
    """Return an expression that is true if a sequence has a length that its type does not allow."""
    if field_type.form is ArrayForm.UNBOUNDED:
        return "False"
    sign = "!=" if field_type.form is ArrayForm.FIXED else ">"
    return f"len({value}) {sign} {field_type.size}"


class Slot(NamedTuple):
    """How to set one field of a message from a mapping."""

    field: Field
    convert: Callable[[object], object]


def plain(message: Message) -> dict[str, object]:
    """Convert a checked message to a dict."""
    result: dict[str, object] = {}
    for field in fields(type(message)):
        value = getattr(message, field.attribute)
        if not field.type.is_nested:
            result[field.name] = value
        elif field.type.is_sequence:
            result[field.name] = [plain(item) for item in value]
        else:
            result[field.name] = plain(value)
    return result


def filled(cls: type[M], value: object) -> M:
    """Make a message from a mapping, or from a message with the same type name and fields."""
    if isinstance(value, Message):
        copy: Callable[[Message], M] = compiled(cls, "")
        return copy(value)
    if not isinstance(value, Mapping):
        problem = f"expected {example(cls)}, got {describe(value)}"
        raise InvalidMessage("", problem + (_missing_space(value) if value else ""))
    known = slots(cls)
    arguments: dict[str, object] = {}
    for name, item in value.items():
        slot = known.get(name) if isinstance(name, str) else None
        if slot is None:
            raise InvalidMessage("", f"unknown field {describe(name)}{instead(cls, name)}")
        content: Any = placed(slot.field, slot.convert, item)
        is_bytes = name in cls._shape.bytes_fields
        arguments[slot.field.attribute] = bytes(content) if is_bytes else content
    return cls(**arguments)


@functools.cache
def slots(cls: type[Message]) -> dict[str, Slot]:
    """Return a `Slot` for each field of a class, by the field's ROS name."""
    return {
        field.name: Slot(
            field,
            converter(field.type, None if nested is None else functools.partial(filled, nested)),
        )
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }


def example(cls: type[Message]) -> str:
    """Describe a valid mapping for this class, for use in an error message."""
    if not fields(cls):
        return "{}, because it has no fields"
    shown = ", ".join(f"{field.name}: {sample(field)}" for field in fields(cls)[:3])
    return f"fields such as {{{shown}}}"


def sample(field: Field) -> str:
    """Return an example of a field's value, for an error."""
    if field.type.is_sequence:
        return "[]"
    if field.type.is_nested:
        return "{}"
    value = zero(field.type) if field.default is None else field.default
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value).lower()


def instead(cls: type[Message], name: object) -> str:
    """Return the end of the error message about an unknown field.

    The text points out a missing space (``x:1`` instead of ``x: 1``), suggests a field with a
    similar name, or lists the fields.
    """
    names = [field.name for field in fields(cls)]
    if not names:
        return ": there are no fields"
    if missing := _missing_space(name):
        return missing
    return did_you_mean(str(name), names) or f": the fields are {', '.join(names)}"


def _missing_space(text: object) -> str:
    """Return a hint that YAML needs a space after a colon, if a text looks like ``field:value``."""
    name, colon, value = str(text).partition(":")
    if not (colon and value and name.isidentifier()) or value.startswith(" "):
        return ""
    return f": a space is missing after the colon of '{name}: {value}'"
