"""Messages as plain Python values, and back: dicts by ROS's field names, lists, numbers, text.

What a value must be is said in ``values``; this adds what a mapping may get wrong.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from turtleact.errors import InvalidMessage
from turtleact.interfaces.copying import compiled, error_class, snapshot
from turtleact.interfaces.definition import did_you_mean, zero
from turtleact.interfaces.types import Message, fields, nested_classes
from turtleact.interfaces.values import converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import Field

__all__ = ["from_dict", "to_dict"]

M = TypeVar("M", bound=Message)


class Slot(NamedTuple):
    """How one field is filled.

    Attributes:
        attribute: Its name in Python.
        convert: What makes its value of what the mapping holds.
        is_bytes: Whether it is declared as ``bytes``.
    """

    attribute: str
    convert: Callable[[object], object]
    is_bytes: bool


def to_dict(message: Message) -> dict[str, object]:
    """A message as a dict of plain values, nested messages too; ``bytes`` stay ``bytes``.

    Raises:
        InvalidMessage: if a value in the message does not fit its type.
    """
    return plain(snapshot(message))


def from_dict(cls: type[M], mapping: Mapping[str, object], *, root: str = "message") -> M:
    """A message of this class, its fields taken by name from a mapping.

    What is left out keeps its default. A nested message may be a mapping or a message.

    Args:
        cls: The class.
        mapping: Values by ROS's field names.
        root: The first word of the path in errors; ``goal`` makes them ``InvalidGoal``.

    Raises:
        InvalidMessage: with the path of the first value or name that does not fit.
    """
    try:
        return filled(cls, mapping)
    except InvalidMessage as inner:
        raise error_class(root)(f"{root}{inner.path}", inner.problem) from None


def plain(message: Message) -> dict[str, object]:
    """A checked message as a dict."""
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
    """A message made of a mapping, or of a message that says the same."""
    if isinstance(value, Message):
        copy: Callable[[Message], M] = compiled(cls, "")
        return copy(value)
    if not isinstance(value, Mapping):
        raise InvalidMessage("", f"expected {example(cls)}, got {describe(value)}")
    known = slots(cls)
    arguments: dict[str, object] = {}
    for name, item in value.items():
        slot = known.get(name) if isinstance(name, str) else None
        if slot is None:
            raise InvalidMessage("", f"unknown field {describe(name)}{instead(cls, name)}")
        try:
            content = slot.convert(item)
        except InvalidMessage as inner:
            raise InvalidMessage(f".{name}{inner.path}", inner.problem) from None
        arguments[slot.attribute] = bytes(content) if slot.is_bytes else content  # type: ignore[call-overload]  # ints, as declared
    return cls(**arguments)


@functools.cache
def slots(cls: type[Message]) -> dict[str, Slot]:
    """How each field of a class is filled, by its ROS name."""
    return {
        field.name: Slot(
            field.attribute,
            converter(field.type, None if nested is None else functools.partial(filled, nested)),
            field.name in cls._shape.bytes_fields,
        )
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }


def example(cls: type[Message]) -> str:
    """What a mapping for this class looks like, in words."""
    if not fields(cls):
        return "{}, for it has no fields"
    shown = ", ".join(f"{field.name}: {sample(field)}" for field in fields(cls)[:3])
    return f"fields such as {{{shown}}}"


def sample(field: Field) -> str:
    """What may stand for a field in an example."""
    if field.type.is_sequence:
        return "[]"
    if field.type.is_nested:
        return "{}"
    value = zero(field.type)
    return '""' if value == "" else str(value).lower()


def instead(cls: type[Message], name: object) -> str:
    """What is known in place of an unknown field."""
    names = [field.name for field in fields(cls)]
    if not names:
        return ": there are no fields"
    return did_you_mean(str(name), names) or f": the fields are {', '.join(names)}"
