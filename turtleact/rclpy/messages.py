"""Message, service and action classes as rclpy programs use them, and their bytes.

A class is made on first use, from the definition of turtleact's class of the same name. It is a
`turtleact.Message` of the same fields, so turtleact's codecs and checks work for it. What differs
is what a program sees of it: the ``repr``, the names of slots and types, arrays for numbers, and
``bytes`` for a byte. Only the fields that need such a conversion have a property. All other fields
are set and read as fast as those of turtleact's own messages.

Source: ``rosidl_generator_py``, whose behaviour was observed in ROS 2 Kilted.
"""

from __future__ import annotations

import array
import functools
import os
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any, Final, TypeAlias, cast

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.interfaces import Action, Message, Service, snapshotter, type_hash
from turtleact.interfaces.cdr import BYTE_ORDERS, FORMATS, HEADER, MISREAD, UNFIT, decoder, encoder
from turtleact.interfaces.class_body import Shape
from turtleact.interfaces.definition import ArrayForm, Field, FieldType, MessageDefinition, zero
from turtleact.interfaces.loading import find_interface
from turtleact.interfaces.types import MessageMeta, definition, fields
from turtleact.interfaces.values import converter
from turtleact.rclpy.exceptions import NoTypeSupportImportedException
from turtleact.rclpy.impl.typing import Anything

__all__ = [
    "InterfaceClass",
    "check_for_type_support",
    "check_is_valid_action_type",
    "check_is_valid_msg_type",
    "check_is_valid_srv_type",
    "decode",
    "deserialize_message",
    "encode",
    "hash_of",
    "interface_class",
    "serialize_message",
    "type_name_of",
]

Convert: TypeAlias = Callable[[object], object]

InterfaceClass: TypeAlias = Anything
"""A class that is made at run time: a message class, or a service or action with its parts."""

TYPECODES: Final = {name: code for name, code in FORMATS.items() if name not in ("bool", "byte")}
"""The type code of the array for each number type. Sequences of other types are lists."""

IDL_NAMES: Final = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
"""The types that have another name in IDL."""


class RosMeta(MessageMeta):
    """The metaclass of message classes. It makes a class from its body without reading the body."""

    def __new__(
        mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **_: str
    ) -> RosMeta:
        """Make a message class."""
        return msgspec.StructMeta.__new__(mcls, name, bases, namespace)


class RosMessage(Message, metaclass=RosMeta):
    """The base class of all message classes."""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return False
        return all(
            _same(getattr(self, field.attribute), getattr(other, field.attribute))
            for field in fields(type(self))
        )

    __hash__ = None  # type: ignore[assignment]  # messages are mutable

    def __repr__(self) -> str:
        values = ", ".join(
            f"{field.name}={_shown(getattr(self, field.attribute))}" for field in fields(type(self))
        )
        return f"{type(self).__module__}.{type(self).__name__}({values})"

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the IDL name of each field's type, by the field's name."""
        return {field.attribute: _idl_name(field.type) for field in fields(cls)}


class ServiceMeta(type):
    """The metaclass of service and action classes, which have no instances."""

    def __call__(cls, *_: object, **__: object) -> Anything:
        """Raise NotImplementedError, as rclpy does."""
        kind = "Action" if hasattr(cls, "Goal") else "Service"
        raise NotImplementedError(f"{kind} classes can not be instantiated")


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


def _message_class(said: MessageDefinition) -> InterfaceClass:
    package, kind, name = said.type_name.split("/")
    nested = tuple(
        interface_class(field.type.name) if field.type.is_nested else None for field in said.fields
    )
    pairs = list(zip(said.fields, nested, strict=True))
    body: dict[str, object] = {
        "__module__": f"{package}.{kind}",
        "__doc__": f"Message class '{name}'.",
        "_shape": Shape(said.type_name, said.fields, said.constants, nested),
        "__annotations__": {field.attribute: object for field in said.fields},
    }
    for constant in said.constants:
        body[constant.name] = _converted(constant.type, constant.value)
    for field, inside in pairs:
        body[field.attribute] = _initial(field, inside)
        if field.default is not None:
            default = _converted(field.type, field.default)
            body[f"{field.attribute.upper()}__DEFAULT"] = default
    setters = {field.attribute: _converter(field, inside) for field, inside in pairs}
    with_setter = [attribute for attribute, convert in setters.items() if convert is not None]
    if with_setter:
        body["__post_init__"] = _setting_again(with_setter)
    made: Anything = RosMeta(name, (RosMessage,), body)
    made.__slots__ = tuple(f"_{attribute}" for attribute in setters)
    for attribute, convert in setters.items():
        slot = vars(made)[attribute]
        setattr(made, f"_{attribute}", slot)
        if convert is not None:
            setattr(made, attribute, _property(slot, attrgetter(f"_{attribute}"), convert))
    return made


def _initial(field: Field, nested: type | None) -> object:
    """Return the initial value of a field as msgspec takes it."""
    size = field.type.size if field.type.form is ArrayForm.FIXED else 0
    if nested is not None:
        if not field.type.is_sequence:
            return msgspec.field(default_factory=nested)
        return msgspec.field(default_factory=lambda: [nested() for _ in range(size)])
    value = zero(field.type) if field.default is None else field.default
    if isinstance(value, tuple):
        return msgspec.field(default_factory=partial(list, value))
    return value


def _converter(field: Field, nested: type[Message] | None) -> Convert | None:
    """Return the function that each value of a field passes through; None if there is none.

    If ``ROS_PYTHON_CHECK_FIELDS`` is 1, every field has such a function, which checks the value.
    """
    convert = _conversion(field.type)
    if os.environ.get("ROS_PYTHON_CHECK_FIELDS") != "1":
        return convert
    copy = None if nested is None else cast("Convert", snapshotter(nested))
    check = converter(field.type, copy)

    def checked(value: object) -> object:
        try:
            check(value)
        except InvalidMessage as error:
            raise AssertionError(f"The '{field.name}' field does not fit: {error}") from error
        return value if convert is None else convert(value)

    return checked


def _conversion(field_type: FieldType) -> Convert | None:
    """Return the function that makes what a program sees; None if that is the value itself."""
    if field_type.name == "byte":
        return _as_list_of_bytes if field_type.is_sequence else _as_bytes
    if field_type.name not in TYPECODES or not field_type.is_sequence:
        return None
    make = _as_numpy if field_type.form is ArrayForm.FIXED else _as_array
    return partial(make, TYPECODES[field_type.name])


def _converted(field_type: FieldType, value: object) -> object:
    """Return a constant or a default value as a program sees it."""
    convert = _conversion(field_type)
    value = list(value) if isinstance(value, tuple) else value
    return value if convert is None else convert(value)


def _as_array(code: str, value: Anything) -> object:
    if type(value) is array.array and value.typecode == code:
        return value
    return array.array(code, value)


def _as_numpy(code: str, value: Anything) -> object:
    import numpy as np  # slow to import, and many programs need it in no message

    return np.asarray(value, np.dtype(code))


def _as_bytes(value: object) -> object:
    return bytes([value]) if isinstance(value, int) else value


def _as_list_of_bytes(values: Anything) -> object:
    return [_as_bytes(value) for value in values]


def _setting_again(attributes: list[str]) -> Callable[[object], None]:
    """Return the method that msgspec calls for a new message, to convert what it was given."""

    def set_again(self: object) -> None:
        for attribute in attributes:
            setattr(self, attribute, getattr(self, attribute))

    return set_again


def _property(slot: Anything, get: Callable[[object], object], convert: Convert) -> property:
    """Return a property that converts what is set, in place of a slot of a message class."""

    def set_value(self: object, value: object) -> None:
        slot.__set__(self, convert(value))

    return property(get, set_value)


def _same(one: Anything, other: Anything) -> bool:
    if hasattr(one, "dtype") or hasattr(other, "dtype"):
        return len(one) == len(other) and all(a == b for a, b in zip(one, other, strict=True))
    return bool(one == other)


def _shown(value: Anything) -> str:
    if hasattr(value, "typecode") or hasattr(value, "dtype"):
        return repr(value.tolist())
    return repr(value)


def _idl_name(field_type: FieldType) -> str:
    name = field_type.name.replace("/msg/", "/")
    element = IDL_NAMES.get(name, name)
    if field_type.string_bound is not None:
        element = f"{element}<{field_type.string_bound}>"
    if field_type.form is ArrayForm.FIXED:
        return f"{element}[{field_type.size}]"
    if field_type.form is ArrayForm.BOUNDED:
        return f"sequence<{element}, {field_type.size}>"
    return f"sequence<{element}>" if field_type.is_sequence else element


def type_name_of(interface: Anything) -> str:
    """Return the full name of a class's interface, such as ``std_msgs/msg/String``."""
    type_name: str = interface.type_name
    return type_name


@functools.cache
def hash_of(type_name: str) -> str:
    """Return the type hash of an interface."""
    return type_hash(find_interface(type_name))


def encode(message: Anything, message_class: Anything) -> bytes:
    """Encode a message.

    Raises:
        TypeError: if the message is of another class, or a value does not fit its field.
    """
    if type(message) is not message_class:
        raise TypeError(
            f"Expected {message_class.__module__}.{message_class.__name__}, got {type(message)}"
        )
    write: Callable[[object], bytes] = encoder(cast("Anything", message_class))
    try:
        return write(message)
    except UNFIT:
        # The message has a value that has to be converted, such as a byte, or one that is wrong.
        ours = cast("type[Message]", find_interface(message_class.type_name))
    try:
        return encoder(ours)(snapshotter(ours)(message))
    except InvalidMessage as error:
        raise TypeError(str(error)) from error


def decode(data: bytes, message_class: Anything) -> Anything:
    """Decode a message.

    Raises:
        InvalidMessage: if the bytes are not a message of ``message_class``.
    """
    order = BYTE_ORDERS.get(data[:2])
    if order is None or len(data) < len(HEADER):
        raise InvalidMessage("message", f"not plain CDR: its header is {data[:4].hex()}")
    try:
        return decoder(message_class, order, "array")(data)
    except MISREAD as error:
        raise InvalidMessage("message", f"not a {message_class.type_name}") from error


def serialize_message(message: Anything) -> bytes:
    """Return a message as the bytes that ROS 2 sends."""
    return encode(message, type(message))


def deserialize_message(serialized_message: bytes, message_type: Anything) -> Anything:
    """Decode the bytes that ROS 2 sends, and return the message."""
    return decode(bytes(serialized_message), message_type)


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
    if isinstance(msg_or_srv_type, RosMeta | ServiceMeta):
        return
    metaclass: Anything = type(msg_or_srv_type)
    support = vars(metaclass).get("_TYPE_SUPPORT", HINT)
    if support is HINT:
        raise AttributeError(f"{msg_or_srv_type!r} has no type support.{HINT}")
    if support is None:
        raise NoTypeSupportImportedException


def _check(interface: Anything, parts: tuple[str, ...], noun: str) -> None:
    check_for_type_support(interface)
    is_message = not isinstance(interface, ServiceMeta)
    if bool(parts) is is_message or not all(hasattr(interface, part) for part in parts):
        other = "message" if parts else "service or action"
        raise RuntimeError(
            f"The {noun} type provided is not valid ({interface}) this may be a {other}"
        )


def check_is_valid_msg_type(msg_type: Anything) -> None:
    """Check that a class is a message class. Raise RuntimeError for a service or action."""
    _check(msg_type, (), "message")


def check_is_valid_srv_type(srv_type: Anything) -> None:
    """Check that a class is a service class. Raise RuntimeError for a message or action."""
    _check(srv_type, ("Request", "Response"), "service")


def check_is_valid_action_type(action_type: Anything) -> None:
    """Check that a class is an action class. Raise RuntimeError for a message or service."""
    _check(action_type, ("Goal", "Result", "Feedback"), "action")
