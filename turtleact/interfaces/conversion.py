"""Makes checked copies of messages, and converts dicts and times to messages and back.

``snapshot`` runs for every goal, feedback and result. So each class gets a compiled function, which
copies messages whose values have exactly the expected Python types. The module ``values`` converts
all other values, or reports what is wrong.

Source: builtin_interfaces/msg/Time, for the times.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces.definition import (
    INTEGER_RANGES,
    PRIMITIVES,
    ArrayForm,
    FieldType,
    did_you_mean,
    zero,
)
from turtleact.interfaces.standard.builtin_interfaces.msg import Time
from turtleact.interfaces.types import Message, constructor, fields, nested_classes
from turtleact.interfaces.values import FLOAT32_LIMIT, converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from turtleact.interfaces.definition import Field
    from turtleact.interfaces.values import Convert

__all__ = [
    "SECOND",
    "Layout",
    "Leaf",
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
    copy: Callable[[object], M] = copier(cls)
    error = error_class(root)

    def checked(message: M) -> M:
        try:
            return copy(message)
        except InvalidMessage as inner:
            raise error(root + inner.path, inner.problem) from None

    return checked


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


class Slot(NamedTuple):
    """How to copy the value of one field."""

    field: Field
    attribute: str
    convert: Callable[[object], object]

    def __call__(self, value: object) -> object:
        """Check and copy a value. Add the field's name to any error."""
        try:
            return self.convert(value)
        except InvalidMessage as inner:
            raise InvalidMessage(f".{self.field.name}{inner.path}", inner.problem) from None


@functools.cache
def slots(cls: type[Message], element: Callable[[type[Message]], Convert]) -> dict[str, Slot]:
    """Return a `Slot` for each field of a class, by the field's ROS name.

    Args:
        cls: The class.
        element: Returns the function that copies the messages of a class in a field.
    """
    return {
        field.name: Slot(field, field.attribute, converter(field.type, nested and element(nested)))
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }


class Leaf(NamedTuple):
    """A value of a message other than a single message: a number, a text or a sequence.

    Attributes:
        text: The value as an expression, such as ``m.pose.x``; empty for a message without fields.
        kind: The type of the value.
        nested: The class of the messages in a sequence; None for other values.
        is_bytes: Whether the class declares the field as ``bytes``.
    """

    text: str
    kind: FieldType
    nested: type[Message] | None = None
    is_bytes: bool = False


class Layout:
    """The values in the messages of a class, and functions compiled for such messages.

    Attributes:
        leaves: The values, in the order in which they are sent.
        checks: Expressions that are true if the message ``m``, and each one in it, is of its class.
    """

    def __init__(self, cls: type[Message]) -> None:
        self.leaves: list[Leaf] = []
        self.checks: list[str] = []
        self._names: dict[str, object] = {}
        self._made = self._add(cls, "m")

    def _add(self, cls: type[Message], text: str) -> str:
        """Add the values of a message. Return an expression with ``{}`` that makes the message."""
        self.checks.append(f"type({text}) is {self.hold(cls)}")
        values = []
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True):
            value = f"{text}.{field.attribute}"
            if nested is not None and not field.type.is_sequence:
                values.append(self._add(nested, value))
                continue
            is_bytes = field.name in cls._shape.bytes_fields
            self.leaves.append(Leaf(value, field.type, nested, is_bytes))
            values.append("{}")
        if not values:
            self.leaves.append(Leaf("", FieldType("byte")))
        return f"{self.hold(constructor(cls))}({', '.join(values)})"

    def hold(self, value: object) -> str:
        """Make an object available to the compiled functions, and return its name there."""
        name = f"k{len(self._names)}"
        self._names[name] = value
        return name

    def made(self, values: Iterable[str]) -> str:
        """Return an expression that makes a message of these values."""
        return self._made.format(*values)

    def function(self, arguments: str, *lines: str) -> Callable[..., Any]:
        """Compile a function.

        Running the code is safe: interfaces contribute only identifiers and numbers to the code.
        """
        names: dict[str, Any] = dict(self._names)
        exec("\n ".join([f"def function({arguments}):", *lines]), names)  # noqa: S102
        function: Callable[..., Any] = names["function"]
        return function


@functools.cache
def copier(cls: type[M]) -> Callable[[object], M]:
    """Return the function that checks and copies messages of this class.

    It compares the Python types of the values, and their ranges, in a compiled function. Only if
    one differs, `converted` converts the values or finds the one that does not fit.
    """
    layout = Layout(cls)
    lines, conditions, values = [], [], []
    for number, leaf in enumerate(leaf for leaf in layout.leaves if leaf.text):
        kind, value, given = leaf.kind, f"v{number}", leaf.text
        values.append(value)
        if kind.is_sequence:
            layout.checks.append(f"type({given}) is {'bytes' if leaf.is_bytes else 'list'}")
            conditions.append(f"len({given}) {SIGNS[kind.form]} {kind.size}")
        if leaf.nested is not None:
            lines.append(f"{value} = list(map({layout.hold(copier(leaf.nested))}, {given}))")
        elif kind.is_sequence and not leaf.is_bytes:
            lines.append(f"{value} = [x for x in {given} if {fits(kind.element, 'x')}]")
            conditions.append(f"len({value}) == len({given})")
        else:
            lines.append(f"{value} = {given}")
            conditions += [] if leaf.is_bytes else [fits(kind, value)]
    return layout.function(
        "m",
        "try:",
        f" if {' and '.join(layout.checks)}:",
        *(f"  {line}" for line in lines),
        f"  if {' and '.join(conditions) or True}: return {layout.made(values)}",
        f"except {layout.hold(InvalidMessage)}: pass",
        f"return {layout.hold(functools.partial(converted, cls))}(m)",
    )


SIGNS = {ArrayForm.FIXED: "==", ArrayForm.BOUNDED: "<=", ArrayForm.UNBOUNDED: ">="}
"""How the length of a sequence compares with the size in its type."""


def fits(kind: FieldType, value: str) -> str:
    """Return an expression that is true if a value has exactly the expected type, and fits.

    It is false for text that is not ASCII, because that may contain half a surrogate pair.
    """
    if kind.is_string:
        bound = "" if kind.string_bound is None else f" and len({value}) <= {kind.string_bound}"
        return f"type({value}) is str and {value}.isascii(){bound}"
    if kind.name in INTEGER_RANGES:
        low, high = INTEGER_RANGES[kind.name]
        return f"type({value}) is int and {low} <= {value} <= {high}"
    limit = f" and -{FLOAT32_LIMIT} < {value} < {FLOAT32_LIMIT}" if kind.name == "float32" else ""
    return f"type({value}) is {type(PRIMITIVES[kind.name]).__name__}{limit}"


def converted(cls: type[M], message: Any) -> M:  # noqa: ANN401  # it checks that
    """Convert a message to this class, with values of exactly the expected types."""
    if type(message) is not cls:
        message = adapted(cls, message)
    copies = [slot(getattr(message, slot.attribute)) for slot in slots(cls, copier).values()]
    return constructor(cls)(*copies)


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
        copy: Callable[[object], M] = copier(cls)
        return copy(value)
    if not isinstance(value, Mapping):
        problem = f"expected {example(cls)}, got {describe(value)}"
        raise InvalidMessage("", problem + (_missing_space(value) if value else ""))
    known = slots(cls, filler)
    arguments: dict[str, object] = {}
    for name, item in value.items():
        slot = known.get(name) if isinstance(name, str) else None
        if slot is None:
            raise InvalidMessage("", f"unknown field {describe(name)}{instead(cls, name)}")
        content: Any = slot(item)
        is_bytes = name in cls._shape.bytes_fields
        arguments[slot.attribute] = bytes(content) if is_bytes else content
    return cls(**arguments)


def filler(nested: type[M]) -> Callable[[object], M]:
    """Return the function that makes the messages in a field from mappings."""
    return functools.partial(filled, nested)


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
