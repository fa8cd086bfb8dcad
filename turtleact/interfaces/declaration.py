"""What the body of a message class declares: its shape, and the defaults msgspec shall use.

Turns annotations and defaults into fields and constants, and puts a default, or what makes one,
into the body for every field, so that no two messages share a list. Knows no metaclass.
"""

from __future__ import annotations

import contextlib
import functools
import keyword
import math
import sys
from typing import TYPE_CHECKING, Any, ClassVar, cast, get_args, get_origin

import msgspec

from turtleact.errors import InvalidInterface, InvalidMessage
from turtleact.interfaces.annotations import read, resolve, scope_of
from turtleact.interfaces.definition import (
    ArrayForm,
    Constant,
    Field,
    constant_name_pattern,
    zero,
)
from turtleact.interfaces.values import converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from types import FrameType

    from turtleact.interfaces.annotations import Reading, Scope
    from turtleact.interfaces.definition import Primitive
    from turtleact.interfaces.types import Message

    Default = Primitive | tuple[Primitive, ...] | None

__all__ = ["Shape", "read_body"]


class Shape(msgspec.Struct, frozen=True):
    """What a message class declares.

    Attributes:
        type_name: Its full name, empty as long as it has none.
        fields: Its fields, in order.
        constants: Its constants, in order.
        nested: For each field the class of its messages, or None.
        bytes_fields: Names of the fields declared as ``bytes``.
    """

    type_name: str = ""
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    nested: tuple[type[Message] | None, ...] = ()
    bytes_fields: frozenset[str] = frozenset()


def read_body(namespace: dict[str, object], frame: FrameType, type_name: str) -> Shape:
    """The shape that a class body declares; gives each field in it a default of its own.

    Args:
        namespace: The body; a default is put in for every field.
        frame: Where the class statement stands.
        type_name: The full name of the class, or an empty string.

    Raises:
        InvalidInterface: names the class and the member that is wrong.
    """
    source = str(namespace["__qualname__"])
    scope = scope_of(frame, namespace)
    members: list[tuple[Field, Reading]] = []
    constants: list[Constant] = []
    meanings: dict[str, object] = {}
    for name, annotation in annotations_of(namespace, source).items():
        with naming(source, name):
            meaning = meanings[name] = resolve(annotation, scope)
            if meaning is ClassVar or get_origin(meaning) is ClassVar:
                constants += read_constant(name, meaning, namespace, scope)
            else:
                reading = read(meaning, scope)
                members.append((read_field(name, reading, namespace), reading))
    # With the objects in place of the text, signatures and hints work for local classes too.
    namespace["__annotations__"] = meanings
    return Shape(
        type_name,
        tuple(field for field, _ in members),
        tuple(constants),
        tuple(reading.nested for _, reading in members),
        frozenset(field.name for field, reading in members if reading.is_bytes),
    )


def annotations_of(namespace: Mapping[str, object], source: str) -> Mapping[str, object]:
    """The annotations in a class body, in order."""
    found = namespace.get("__annotations__")
    if found is None and sys.version_info >= (3, 14):  # pragma: no cover  no older one has it
        import annotationlib

        annotate = annotationlib.get_annotate_from_class_namespace(namespace)
        if annotate is not None:
            with naming(source, "__annotate__"):
                found = annotationlib.call_annotate_function(annotate, annotationlib.Format.VALUE)
    return found or {}  # type: ignore[return-value]  # a class body holds nothing else there


@contextlib.contextmanager
def naming(source: str, name: str) -> Iterator[None]:
    """Adds class and member to what is said about an annotation or default."""
    try:
        yield
    except InvalidInterface as inner:
        raise InvalidInterface(f"{name}: {inner.problem}", source=source) from inner.__cause__


def read_constant(
    name: str, annotation: object, namespace: Mapping[str, object], scope: Scope
) -> list[Constant]:
    """The constant that a ClassVar in capitals declares; other ClassVars are Python's own."""
    if not constant_name_pattern.fullmatch(name):
        return []
    reading = read(next(iter(get_args(annotation)), annotation), scope)
    if name not in namespace:
        raise InvalidInterface("a constant needs a value", source="")
    return [
        Constant(name, reading.field_type, cast("Primitive", as_default(reading, namespace[name])))
    ]


def read_field(name: str, reading: Reading, namespace: dict[str, object]) -> Field:
    """One field; its default in the class body becomes what msgspec can use."""
    default: Default = None
    if name in namespace:
        default = as_default(reading, given_default(namespace[name]))
    ros_name = name[:-1] if name.endswith("_") and keyword.iskeyword(name[:-1]) else name
    field = Field(ros_name, reading.field_type, default)
    namespace[name] = initial(reading, field.default)
    return field


def given_default(given: object) -> object:
    """The default that a class body gives, be it bare or in ``msgspec.field``."""
    if not isinstance(given, FIELD_SPECIFIER):
        return given
    value: Any = given  # msgspec does not export its type
    if value.name is not None or (value.default, value.default_factory) == NOTHING:
        problem = "msgspec.field is for default and default_factory alone"
        raise InvalidInterface(problem, source="")
    return value.default if value.default_factory is msgspec.NODEFAULT else value.default_factory()


def as_default(reading: Reading, value: object) -> Default:
    """A default as a definition holds it."""
    if reading.nested is not None:
        check_nested_default(reading, value)
        return None
    try:
        default = converter(reading.field_type)(value)
    except InvalidMessage as misfit:
        raise InvalidInterface(f"its default{misfit.path}: {misfit.problem}", source="") from None
    values = default if isinstance(default, list | bytes) else [default]
    if any(isinstance(item, float) and not math.isfinite(item) for item in values):
        raise InvalidInterface(f"its default {describe(value)} is not finite", source="")
    return tuple(default) if isinstance(default, list | bytes) else cast("Primitive", default)


def check_nested_default(reading: Reading, value: object) -> None:
    """Lets a default message pass that says no more than no default."""
    if value != zero_message(reading)():
        problem = "ROS gives messages no default: leave it out, each starts with its own zeros"
        raise InvalidInterface(problem, source="")


def initial(reading: Reading, default: Default) -> object:
    """What the class body shall hold for a field: a value, or what makes one for each message."""
    if reading.nested is not None:
        return msgspec.field(default_factory=zero_message(reading))
    value = zero(reading.field_type) if default is None else default
    if not isinstance(value, tuple):
        return value
    if reading.is_bytes:
        return bytes(cast("tuple[int, ...]", value))
    return msgspec.field(default_factory=functools.partial(list, value) if value else list)


def zero_message(reading: Reading) -> Callable[[], object]:
    """What makes the message, or list of messages, that a field starts with."""
    nested = cast("Callable[[], object]", reading.nested)
    if not reading.field_type.is_sequence:
        return nested
    if reading.field_type.form is ArrayForm.FIXED:
        return functools.partial(several, nested, reading.field_type.size)
    return list


def several(make: Callable[[], object], size: int) -> list[object]:
    """A list of new messages."""
    return [make() for _ in range(size)]


#: The type of what ``msgspec.field`` gives, which msgspec does not export.
FIELD_SPECIFIER = type(msgspec.field(default=None))
NOTHING = (msgspec.NODEFAULT, msgspec.NODEFAULT)
