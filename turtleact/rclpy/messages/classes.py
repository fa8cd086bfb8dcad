"""Message, service and action classes as rclpy programs use them.

A class is made on first use, from the definition of turtleact's class of the same name. Its
``__init__`` and its properties are compiled from generated source code. Such code is fast, and a
program may make thousands of messages a second.

Source: ``rosidl_generator_py``, whose behaviour was observed in ROS 2 Kilted.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from operator import attrgetter
from typing import TypeAlias, cast

from turtleact.interfaces import Action, Message, Service
from turtleact.interfaces.class_body import Shape
from turtleact.interfaces.definition import Constant, Field, MessageDefinition
from turtleact.interfaces.loading import find_interface
from turtleact.interfaces.types import definition
from turtleact.rclpy.exceptions import NoTypeSupportImportedException
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.fields import (
    TYPECODES,
    checker,
    initial,
    is_numeric_array,
    is_numeric_sequence,
    sequence_of,
    type_text,
)

__all__ = [
    "MISSING",
    "InterfaceClass",
    "check_for_type_support",
    "check_is_valid_action_type",
    "check_is_valid_msg_type",
    "check_is_valid_srv_type",
    "interface_class",
    "is_interface",
    "maker",
    "shape_of",
    "type_name_of",
]

InterfaceClass: TypeAlias = Anything
"""A class that is made at run time: a message class, or a service or action with its parts."""

MISSING = object()
"""The value of a keyword argument that was left out."""

CHECKS_BY_DEFAULT = os.environ.get("ROS_PYTHON_CHECK_FIELDS") == "1"


class Metaclass(type):
    """The metaclass of message classes. Constants and fields' default values are read-only."""

    def __setattr__(cls, name: str, value: object) -> None:
        """Set an attribute. Raise AttributeError if it is a constant or a field's default value."""
        if name in cls.__dict__.get("_fixed", ()):
            raise AttributeError(f"can't set attribute '{name}'")
        super().__setattr__(name, value)


class MessageBase:
    """The base class of all message classes."""

    __slots__ = ()

    _shape: Shape

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return False
        return all(
            _same(getattr(self, field.attribute), getattr(other, field.attribute))
            for field in self._shape.fields
        )

    __hash__ = None  # type: ignore[assignment]  # messages are mutable

    def __repr__(self) -> str:
        fields = ((each.name, getattr(self, each.attribute)) for each in self._shape.fields)
        values = ", ".join(f"{name}={_shown(value)}" for name, value in fields)
        return f"{type(self).__module__}.{type(self).__name__}({values})"

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the IDL name of each field's type, by the field's name."""
        return {field.attribute: type_text(field.type) for field in cls._shape.fields}


class ServiceMeta(type):
    """The metaclass of service and action classes, which have no instances."""

    type_name: str

    def __call__(cls, *_: object, **__: object) -> Anything:
        """Raise NotImplementedError, as rclpy does."""
        kind = "Action" if hasattr(cls, "Goal") else "Service"
        raise NotImplementedError(f"{kind} classes can not be instantiated")


def is_interface(candidate: object) -> bool:
    """Whether an object is an interface class that was made by this module."""
    return isinstance(candidate, Metaclass | ServiceMeta)


@functools.cache
def interface_class(type_name: str) -> InterfaceClass:
    """Return the class of an interface by its full name. A second call returns the same class.

    Raises:
        UnknownInterface: if there is no such interface. The error suggests the most similar
            name.
        InvalidInterface: if the file that defines the interface is malformed.
    """
    found = find_interface(type_name)
    if issubclass(found, Message):
        return _message_class(definition(found))
    if issubclass(found, Service):
        return _whole_class(found, _parts(found.type_name, ("Request", "Response", "Event")))
    members = _parts(found.type_name, ("Goal", "Result", "Feedback"))
    members["Impl"] = type("Impl", (), _implied(found.type_name))
    return _whole_class(found, members)


def _parts(type_name: str, names: tuple[str, ...]) -> dict[str, object]:
    return {name: interface_class(f"{type_name}_{name}") for name in names}


def _implied(action: str) -> dict[str, object]:
    return {
        "SendGoalService": interface_class(f"{action}_SendGoal"),
        "GetResultService": interface_class(f"{action}_GetResult"),
        "FeedbackMessage": interface_class(f"{action}_FeedbackMessage"),
        "CancelGoalService": interface_class("action_msgs/srv/CancelGoal"),
        "GoalStatusMessage": interface_class("action_msgs/msg/GoalStatusArray"),
    }


def _whole_class(found: type[Service | Action], members: dict[str, object]) -> InterfaceClass:
    package, kind, name = found.type_name.split("/")
    body = {"__module__": f"{package}.{kind}", "type_name": found.type_name, **members}
    return ServiceMeta(name, (), body)


def type_name_of(interface: Anything) -> str:
    """Return the full name of a class's interface, such as ``std_msgs/msg/String``."""
    if isinstance(interface, ServiceMeta):
        return interface.type_name
    return shape_of(interface).type_name


def shape_of(message_class: Anything) -> Shape:
    """Return the declaration of a message class: its name, fields and constants."""
    shape: Shape = message_class._shape
    return shape


@functools.cache
def maker(message_class: Anything) -> Callable[..., object]:
    """Return a function that makes a message from decoded values in the order of the fields.

    turtleact's decoder calls this function in place of a message class. The function therefore has
    an attribute ``_shape``, as a message class has. In ``_shape``, such functions replace
    the classes of nested messages.
    """
    shape = shape_of(message_class)
    names: dict[str, object] = {"new": message_class.__new__, "cls": message_class}
    arguments = [f"a{index}" for index in range(len(shape.fields))]
    lines = [f"def make({', '.join(arguments)}):", " m = new(cls)", " m._check_fields = False"]
    for argument, field in zip(arguments, shape.fields, strict=True):
        value = argument
        if convert := _decoded(field):
            names[f"convert_{argument}"] = convert
            value = f"convert_{argument}({argument})"
        lines.append(f" m._{field.attribute} = {value}")
    lines.append(" return m")
    exec("\n".join(lines), names)  # noqa: S102  # identifiers only
    make = cast("Anything", names["make"])
    nested = tuple(None if each is None else maker(each) for each in shape.nested)
    make._shape = Shape(shape.type_name, shape.fields, shape.constants, nested)
    return cast("Callable[..., object]", make)


def _decoded(field: Field) -> Callable[[Anything], object] | None:
    """Return a function that converts a field's decoded values; None if no conversion is needed."""
    if is_numeric_array(field.type):
        import numpy as np

        dtype = np.dtype(TYPECODES[field.type.name])
        return lambda value: np.frombuffer(value, dtype=dtype)
    if field.type.name == "byte":
        return _bytes_of if field.type.is_sequence else _byte_of
    return None


def _byte_of(value: int) -> bytes:
    return bytes([value])


def _bytes_of(values: list[int]) -> list[bytes]:
    return [bytes([value]) for value in values]


def _message_class(said: MessageDefinition) -> InterfaceClass:
    package, kind, name = said.type_name.split("/")
    nested = tuple(
        interface_class(field.type.name) if field.type.is_nested else None for field in said.fields
    )
    constants = {constant.name: _constant(constant) for constant in said.constants}
    defaults = {
        f"{field.attribute.upper()}__DEFAULT": initial(field, None)()
        for field in said.fields
        if field.default is not None
    }
    body: dict[str, object] = {
        "__module__": f"{package}.{kind}",
        "__doc__": f"Message class '{name}'.",
        "__slots__": [*(f"_{field.attribute}" for field in said.fields), "_check_fields"],
        "__init__": _initialiser(said.fields, nested),
        "_shape": Shape(said.type_name, said.fields, said.constants, nested),
        "_fixed": frozenset({*constants, *defaults, "_fixed"}),
        **constants,
        **defaults,
    }
    for field, inside in zip(said.fields, nested, strict=True):
        body[field.attribute] = _property(field, inside)
    return Metaclass(name, (MessageBase,), body)


def _constant(constant: Constant) -> object:
    is_byte = constant.type.name == "byte"
    return bytes([int(constant.value)]) if is_byte else constant.value


def _initialiser(fields: tuple[Field, ...], nested: tuple[type | None, ...]) -> Callable[..., None]:
    """Return the ``__init__`` of a message class."""
    names: dict[str, object] = {
        "missing": MISSING,
        "checks": CHECKS_BY_DEFAULT,
        "refuse": _refuse_unknown,
    }
    keywords = [f"{field.attribute}=missing" for field in fields]
    lines = [
        f"def __init__(self, *, {', '.join([*keywords, 'check_fields=checks'])}, **unknown):",
        " self._check_fields = check_fields",
        " if unknown and check_fields: refuse(unknown)",
    ]
    for field, inside in zip(fields, nested, strict=True):
        name = field.attribute
        names[f"make_{name}"] = initial(field, inside)
        lines.append(f" if {name} is missing: self._{name} = make_{name}()")
        is_converted = is_numeric_sequence(field.type) or is_numeric_array(field.type)
        if is_converted:
            lines.append(f" else: self.{name} = {name}")
        else:
            lines.append(f" elif check_fields: self.{name} = {name}")
            lines.append(f" else: self._{name} = {name}")
    exec("\n".join(lines), names)  # noqa: S102  # identifiers only
    return cast("Callable[..., None]", names["__init__"])


def _refuse_unknown(unknown: dict[str, object]) -> None:
    raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(sorted(unknown))}")


def _property(field: Field, nested: type | None) -> property:
    """Return the property of a field. Setting it converts sequences of numbers to arrays."""
    slot = f"_{field.attribute}"
    names: dict[str, object] = {"check": checker(field, nested)}
    value = "value"
    if is_numeric_sequence(field.type) or is_numeric_array(field.type):
        names["convert"] = sequence_of(field.type)
        value = "convert(value)"
    lines = [
        "def set_value(self, value):",
        " if self._check_fields: check(value)",
        f" self.{slot} = {value}",
    ]
    exec("\n".join(lines), names)  # noqa: S102  # identifiers only
    return property(attrgetter(slot), cast("Callable[..., None]", names["set_value"]))


def _same(one: Anything, other: Anything) -> bool:
    if hasattr(one, "dtype") or hasattr(other, "dtype"):
        return len(one) == len(other) and all(a == b for a, b in zip(one, other, strict=True))
    return bool(one == other)


def _shown(value: Anything) -> str:
    if hasattr(value, "typecode") or hasattr(value, "dtype"):
        return repr(value.tolist())
    return repr(value)


HINT = (
    " This might be a ROS 1 message type but it should be a ROS 2 message type."
    " Make sure to source your ROS 2 workspace after your ROS 1 workspace."
)


def check_for_type_support(msg_or_srv_type: Anything) -> None:
    """Check that an object is the class of a message, service or action.

    Raises:
        AttributeError: if the object is not the class of a message, service or action.
        NoTypeSupportImportedException: if the class is from the genuine ROS, and ROS has not loaded
            its type support.
    """
    if is_interface(msg_or_srv_type):
        return
    metaclass: Anything = type(msg_or_srv_type)
    support = vars(metaclass).get("_TYPE_SUPPORT", HINT)
    if support is HINT:
        raise AttributeError(f"{msg_or_srv_type!r} has no type support.{HINT}")
    if support is None:
        raise NoTypeSupportImportedException


def _check(interface: Anything, parts: tuple[str, ...], noun: str) -> None:
    check_for_type_support(interface)
    if not all(hasattr(interface, part) for part in parts):
        raise RuntimeError(
            f"The {noun} type provided is not valid ({interface})"
            f"{' this may be a message' if parts else ' this may be a service or action'}"
        )


def check_is_valid_msg_type(msg_type: Anything) -> None:
    """Check that a class is a message class. Raise RuntimeError for a service or action."""
    _check(msg_type, (), "message")
    if hasattr(msg_type, "type_name"):
        raise RuntimeError(
            f"The message type provided is not valid ({msg_type}) this may be a service or action"
        )


def check_is_valid_srv_type(srv_type: Anything) -> None:
    """Check that a class is a service class. Raise RuntimeError for a message or action."""
    _check(srv_type, ("Request", "Response"), "service")


def check_is_valid_action_type(action_type: Anything) -> None:
    """Check that a class is an action class. Raise RuntimeError for a message or service."""
    _check(action_type, ("Goal", "Result", "Feedback"), "action")
