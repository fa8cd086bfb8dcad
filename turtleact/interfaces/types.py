"""Message, Service and Action: interfaces as Python classes.

A class statement is a declaration: its annotations say the fields, class constants the constants,
and what has no default gets the zero of its type. From ``definition`` and ``annotations`` up; knows
no text, no wire and no file.

>>> class Goal(Message, type_name="example_msgs/msg/Goal"):
...     order: int32
...     name: string = "turtle1"
>>> Goal()
Goal(order=0, name='turtle1')
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, ClassVar, cast, dataclass_transform, overload

import msgspec

from turtleact.errors import InvalidInterface
from turtleact.interfaces.annotations import (
    array,
    bool_,
    bounded,
    byte,
    char,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    is_message_class,
    string,
    uint8,
    uint16,
    uint32,
    uint64,
    wstring,
)
from turtleact.interfaces.declaration import Shape, read_body
from turtleact.interfaces.definition import (
    ActionDefinition,
    MessageDefinition,
    ServiceDefinition,
    check_type_name,
    did_you_mean,
)
from turtleact.interfaces.registry import REGISTRY

if TYPE_CHECKING:
    from turtleact.interfaces.definition import Constant, Definition, Field

__all__ = [
    "Action",
    "Message",
    "MessageMeta",
    "Service",
    "array",
    "bool_",
    "bounded",
    "byte",
    "char",
    "constants",
    "definition",
    "fields",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "int64",
    "nested_classes",
    "string",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "wstring",
]


@dataclass_transform(field_specifiers=(msgspec.field,))
class MessageMeta(msgspec.StructMeta):
    """Makes message classes; ``Message`` says how they behave."""

    _shape: Shape

    def __new__(
        mcls,
        name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        *,
        type_name: str = "",
    ) -> MessageMeta:
        """Reads the class body before msgspec makes a class of it."""
        if bases == (msgspec.Struct,):
            # A message is a tree: never part of a cycle, so the garbage collector leaves it out.
            base = super().__new__(mcls, name, bases, namespace, gc=False)
            base._shape = Shape()
            return base
        namespace.setdefault("__qualname__", name)
        if bases != (Message,):
            problem = "derive a message from Message alone"
            raise InvalidInterface(problem, source=namespace["__qualname__"])
        shape = read_body(namespace, sys._getframe(1), type_name)
        cls = super().__new__(mcls, name, bases, namespace)
        cls._shape = shape
        if type_name:
            message = cast("type[Message]", cls)
            REGISTRY.add(message, definition(message))
        return cls

    @property
    def type_name(cls) -> str:
        """The full name, ``package/kind/Name``; empty as long as the class has none."""
        return cls._shape.type_name


class Message(msgspec.Struct, metaclass=MessageMeta):
    """The base of all messages: mutable, compared by value, cheap to make and to keep.

    Making one checks nothing; ``snapshot`` does, whenever a message is sent. A field without a
    default gets the zero of its type; type checkers ask for each argument that has no default in
    the class, so say ``order: int32 = 0`` where it may be left out. Constants are
    ``ClassVar[int8]`` and the like. A field whose ROS name is a Python keyword has an underscore at
    its end (``from_``).

    >>> class Pair(Message, type_name="example_msgs/msg/Pair"):
    ...     left: bounded[list[int32], 3]
    ...     right: array[list[float64], 2]
    >>> Pair(left=[1])
    Pair(left=[1], right=[0.0, 0.0])
    """


class Action:
    """The base of all actions: a class with Goal, Result and Feedback inside.

    Each is a Message; one that is left out has no fields.

    >>> class Count(Action, type_name="example_msgs/action/Count"):
    ...     class Goal(Message):
    ...         target: int32 = 0
    >>> Count.Goal(target=3), Count.Result()
    (Goal(target=3), Result())
    """

    type_name: ClassVar[str] = ""
    Goal: ClassVar[type[Message]] = Message
    Result: ClassVar[type[Message]] = Message
    Feedback: ClassVar[type[Message]] = Message
    _implied: ClassVar[object] = None

    def __init_subclass__(cls, *, type_name: str = "") -> None:
        """Names the parts after the action and makes all of it known."""
        super().__init_subclass__()
        declare(cls, type_name, base=Action, kind="action")


class Service:
    """The base of all services: a class with Request and Response inside, as in ``Action``."""

    type_name: ClassVar[str] = ""
    Request: ClassVar[type[Message]] = Message
    Response: ClassVar[type[Message]] = Message

    def __init_subclass__(cls, *, type_name: str = "") -> None:
        """Names the parts after the service and makes all of it known."""
        super().__init_subclass__()
        declare(cls, type_name, base=Service, kind="srv")


def fields(cls: type[Message]) -> tuple[Field, ...]:
    """The fields of a message class, in the order in which they are sent."""
    return cls._shape.fields


def constants(cls: type[Message]) -> tuple[Constant, ...]:
    """The constants of a message class."""
    return cls._shape.constants


def nested_classes(cls: type[Message]) -> tuple[type[Message] | None, ...]:
    """For each field the class of the messages in it, or None."""
    return cls._shape.nested


@overload
def definition(cls: type[Message]) -> MessageDefinition: ...
@overload
def definition(cls: type[Service]) -> ServiceDefinition: ...
@overload
def definition(cls: type[Action]) -> ActionDefinition: ...
def definition(cls: type[Message] | type[Service] | type[Action]) -> Definition:
    """What an interface class declares.

    Raises:
        InvalidInterface: if the class has no type name.
    """
    if issubclass(cls, Message):
        return MessageDefinition(cls.type_name, fields(cls), constants(cls))
    if issubclass(cls, Service):
        return ServiceDefinition(cls.type_name, definition(cls.Request), definition(cls.Response))
    return ActionDefinition(
        cls.type_name, definition(cls.Goal), definition(cls.Result), definition(cls.Feedback)
    )


#: The classes inside a service or action.
PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


def declare(cls: type[Service] | type[Action], type_name: str, *, base: type, kind: str) -> None:
    """Completes a service or action, names its parts and makes all of it known."""
    source = cls.__qualname__
    if cls.__bases__ != (base,):
        raise InvalidInterface(f"derive it from {base.__name__} alone", source=source)
    if not type_name:
        problem = (
            f"say its name: class {cls.__name__}({base.__name__}, "
            f'type_name="package_name/{kind}/{cls.__name__}")'
        )
        raise InvalidInterface(problem, source=source)
    check_type_name(type_name, kinds=(kind,) if kind == "action" else ("action", "srv"))
    cls.type_name = type_name
    check_strays(cls, PARTS[kind])
    parts = [named_part(cls, part) for part in PARTS[kind]]
    # The whole comes first: a changed one drops all that went by its name.
    REGISTRY.add(cls, definition(cls))
    for part in parts:
        REGISTRY.add(part, definition(part))


def named_part(cls: type[Service] | type[Action], part: str) -> type[Message]:
    """One part of a service or action under its full name; an empty one where it is left out."""
    type_name = f"{cls.type_name}_{part}"
    qualname = f"{cls.__qualname__}.{part}"
    message = vars(cls).get(part)
    if message is None:
        body = {"__module__": cls.__module__, "__qualname__": qualname}
        message = cast("type[Message]", MessageMeta(part, (Message,), body))
        setattr(cls, part, message)
    if not is_message_class(message) or message is Message:
        raise InvalidInterface(f"is no message: write class {part}(Message)", source=qualname)
    if message.type_name not in ("", type_name):
        problem = (
            f"belongs to {message.type_name}: write class {part}(Message) inside {cls.__name__}"
        )
        raise InvalidInterface(problem, source=qualname)
    message._shape = msgspec.structs.replace(message._shape, type_name=type_name)
    return message


def check_strays(cls: type, parts: tuple[str, ...]) -> None:
    """Refuses a message class inside that is no part, such as a misspelled one."""
    for name, member in vars(cls).items():
        if is_message_class(member) and name not in parts and member.__name__ == name:
            problem = f"the parts are {', '.join(parts)}{did_you_mean(name, parts)}"
            raise InvalidInterface(problem, source=f"{cls.__qualname__}.{name}")
