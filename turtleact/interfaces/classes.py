"""Makes classes from definitions, and makes the types that ROS 2 derives from such classes.

``make_message`` and ``make_interface`` make classes like those that a class
statement makes. These functions read no files and look up no interfaces. Instead, the caller passes
``find``, which returns the class of an interface or raises ``UnknownInterface``.

ROS 2 never sends a goal, result or feedback alone: each travels in a message or service generated
for its action. The introspection of a service sends the message ``NAME_Event``. ``implied`` and
``event_message`` build these types from the action's or service's own classes, once, on first use.

Source: ``rosidl_parser/definition.py``, classes ``Action`` and ``Service``.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, ClassVar, cast

import msgspec

from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces.class_body import annotation_of
from turtleact.interfaces.definition import (
    ArrayForm,
    FieldType,
    MessageDefinition,
    check_type_name,
)
from turtleact.interfaces.standard.builtin_interfaces.msg import Time
from turtleact.interfaces.standard.service_msgs.msg import ServiceEventInfo
from turtleact.interfaces.standard.unique_identifier_msgs.msg import UUID
from turtleact.interfaces.types import (
    PARTS,
    Action,
    Message,
    MessageMeta,
    Service,
    bool_,
    int8,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from turtleact.interfaces.definition import (
        Definition,
        Field,
    )
    from turtleact.interfaces.types import Interface, field

    Find = Callable[[str], Interface]

    class SendGoal(Service):
        """``NAME_SendGoal`` as type checkers see it."""

        class Request(Message):
            goal_id: UUID = field(default_factory=UUID)
            goal: Message = field(default_factory=Message)

        class Response(Message):
            accepted: bool_ = False
            stamp: Time = field(default_factory=Time)

    class GetResult(Service):
        """``NAME_GetResult`` as type checkers see it."""

        class Request(Message):
            goal_id: UUID = field(default_factory=UUID)

        class Response(Message):
            status: int8 = 0
            result: Message = field(default_factory=Message)

    class FeedbackMessage(Message):
        """``NAME_FeedbackMessage`` as type checkers see it."""

        goal_id: UUID = field(default_factory=UUID)
        feedback: Message = field(default_factory=Message)


__all__ = [
    "Implied",
    "event_message",
    "implied",
    "make_interface",
    "make_message",
    "owner_and_part",
    "part_of",
]


def make_message(
    definition: MessageDefinition, find: Find, *, register: bool = True
) -> type[Message]:
    """Make a message class; with ``register``, `get_interface` returns it from now on."""
    name, body = message_body(definition, find)
    made = MessageMeta(name, (Message,), body, type_name=definition.type_name, register=register)
    return cast("type[Message]", made)


def message_body(definition: MessageDefinition, find: Find) -> tuple[str, dict[str, object]]:
    """Return the name and the namespace of a message class."""
    annotations: dict[str, object] = {}
    name, body = naming(definition.type_name)
    body["__annotations__"] = annotations
    for constant in definition.constants:
        annotations[constant.name] = ClassVar[annotation_of(constant.type, None)]
        body[constant.name] = constant.value
    for field in definition.fields:
        annotations[field.attribute] = annotation_of(field.type, nested(definition, field, find))
        if field.default is not None:
            body[field.attribute] = field.default
    return name, body


def make_interface(definition: Definition, find: Find, *, register: bool = True) -> Interface:
    """Make the class of a message, service or action; see `make_message`."""
    if isinstance(definition, MessageDefinition):
        return make_message(definition, find, register=register)
    base = Service if len(definition.parts) == len(PARTS["srv"]) else Action
    name, body = naming(definition.type_name)
    names = PARTS["srv" if base is Service else "action"]
    for part, content in zip(names, definition.parts, strict=True):
        _, own = message_body(content, find)
        own["__qualname__"] = f"{name}.{part}"
        body[part] = MessageMeta(part, (Message,), own)
    # The metaclass is type, so that the keywords reach __init_subclass__.
    made = type(name, (base,), body, type_name=definition.type_name, register=register)
    return cast("Interface", made)


def nested(definition: MessageDefinition, field: Field, find: Find) -> type[Message] | None:
    """Return the class of the messages that a field holds; None if it holds primitives."""
    if not field.type.is_nested:
        return None
    try:
        found = find(field.type.name)
    except UnknownInterface as error:
        problem = f"{field.name}: {error}"
        raise InvalidInterface(problem, source=definition.type_name) from error
    if not issubclass(found, Message):
        problem = f"{field.name}: {field.type.name} is not a message"
        raise InvalidInterface(problem, source=definition.type_name)
    return found


class Implied(msgspec.Struct, frozen=True):
    """The services and the feedback message that ROS 2 derives from an action.

    Attributes:
        send_goal: The service whose request has a goal id and a goal; the response says whether and
            when the goal was accepted.
        get_result: The service whose request has a goal id; the response has the goal's status and
            result.
        feedback_message: The message that has a goal id and feedback.
    """

    send_goal: type[SendGoal]
    get_result: type[GetResult]
    feedback_message: type[FeedbackMessage]


#: The suffixes after an action's name, and the attributes of ``Implied`` they stand for.
WRAPPERS = {
    "SendGoal": "send_goal",
    "GetResult": "get_result",
    "FeedbackMessage": "feedback_message",
}
SUFFIXES = frozenset({*PARTS["srv"], *PARTS["action"], *WRAPPERS, "Event"})


def implied(action_type: type[Action]) -> Implied:
    """Return the service and message classes that carry the goals of an action.

    The same action always gets the same classes.

    Raises:
        InvalidInterface: if the class has no type name.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> implied(Fibonacci).send_goal.Request(goal=Fibonacci.Goal(order=5)).goal
    Goal(order=5)
    """
    # mypy wants the class's instances to be hashable, but the class itself is looked up.
    return made_implied(action_type)  # type: ignore[arg-type]


def event_message(service: type[Service]) -> type[Message]:
    """Return ``NAME_Event``, the message of a service's introspection.

    Raises:
        InvalidInterface: if the class has no type name.
    """
    # mypy wants the class's instances to be hashable, but the class itself is looked up.
    return made_event(service)  # type: ignore[arg-type]


def owner_and_part(type_name: str) -> tuple[str, str]:
    """Split the name of a derived type into its owner and its part.

    For any other name, both strings are empty.

    >>> owner_and_part("example_interfaces/action/Fibonacci_SendGoal_Request")
    ('example_interfaces/action/Fibonacci_SendGoal', 'Request')
    """
    owner, _, part = type_name.rpartition("_")
    return (owner, part) if part in SUFFIXES and "/msg/" not in owner else ("", "")


def part_of(owner: Interface | None, part: str) -> Interface | None:
    """Return the class whose type name is ``OWNER_PART``, or None if there is none."""
    if owner is None or issubclass(owner, Message):
        return None
    if issubclass(owner, Service) and part == "Event":
        return event_message(owner)
    if issubclass(owner, Action) and part in WRAPPERS:
        return cast("Interface", getattr(implied(owner), WRAPPERS[part]))
    own = PARTS["srv" if issubclass(owner, Service) else "action"]
    return cast("Interface", getattr(owner, part)) if part in own else None


@functools.cache
def made_implied(action: type[Action]) -> Implied:
    """Make the service and message classes that carry the goals of an action.

    The fields and their order are those of ROS.
    """
    check_type_name(action.type_name, kinds=("action",))
    send_goal = service(
        f"{action.type_name}_SendGoal",
        {"goal_id": UUID, "goal": action.Goal},
        {"accepted": bool_, "stamp": Time},
    )
    get_result = service(
        f"{action.type_name}_GetResult",
        {"goal_id": UUID},
        {"status": int8, "result": action.Result},
    )
    feedback_message = message(
        f"{action.type_name}_FeedbackMessage",
        {"goal_id": UUID, "feedback": action.Feedback},
    )
    return Implied(
        cast("type[SendGoal]", send_goal),
        cast("type[GetResult]", get_result),
        cast("type[FeedbackMessage]", feedback_message),
    )


@functools.cache
def made_event(service: type[Service]) -> type[Message]:
    """Make the class for `event_message`. The fields and their order are those of ROS."""
    check_type_name(service.type_name)
    return message(
        f"{service.type_name}_Event",
        {
            "info": ServiceEventInfo,
            "request": at_most_one(service.Request),
            "response": at_most_one(service.Response),
        },
    )


def service(
    type_name: str, request: Mapping[str, object], response: Mapping[str, object]
) -> type[Service]:
    """Make a service class with these fields in its request and response."""
    name, body = naming(type_name)
    body["Request"] = message(f"{type_name}_Request", request)
    body["Response"] = message(f"{type_name}_Response", response)
    # The metaclass is type, so that the keywords reach __init_subclass__.
    made = type(name, (Service,), body, type_name=type_name, register=False)
    return cast("type[Service]", made)


def message(type_name: str, annotations: Mapping[str, object]) -> type[Message]:
    """Make a message class with these fields. It is reached through its owner, not by its name."""
    name, body = naming(type_name)
    body["__annotations__"] = annotations
    made = MessageMeta(name, (Message,), body, type_name=type_name, register=False)
    return cast("type[Message]", made)


def at_most_one(part: type[Message]) -> object:
    """Return the annotation of a list with at most one message of this class."""
    return annotation_of(FieldType(part.type_name, None, ArrayForm.BOUNDED, 1), part)


def naming(type_name: str) -> tuple[str, dict[str, object]]:
    """Return a type's class name, and a namespace with ``__module__`` and ``__qualname__``."""
    package, kind, name = type_name.split("/")
    return name, {"__module__": f"{package}.{kind}", "__qualname__": name}
