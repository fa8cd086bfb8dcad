"""The types that a service or an action implies, and the names they go by.

ROS 2 sends no goal, result or feedback bare: each travels in a message or service made for its
action; ``NAME_Event`` is what the introspection of a service sends. Such a type is built on the
action's or service's own classes, once, when it is first asked for. Knows no text and no file.

Source: ``rosidl_parser/definition.py``, classes ``Action`` and ``Service``.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, cast

import msgspec

from turtleact.interfaces.annotations import annotation_of
from turtleact.interfaces.definition import ArrayForm, FieldType, check_type_name
from turtleact.interfaces.standard import UUID, ServiceEventInfo, Time
from turtleact.interfaces.types import PARTS, Action, Message, MessageMeta, Service, bool_, int8

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msgspec import field

    from turtleact.interfaces.registry import Interface

    class SendGoal(Service):
        """What a type checker sees of ``NAME_SendGoal``."""

        class Request(Message):
            goal_id: UUID = field(default_factory=UUID)
            goal: Message = field(default_factory=Message)

        class Response(Message):
            accepted: bool_ = False
            stamp: Time = field(default_factory=Time)

    class GetResult(Service):
        """What a type checker sees of ``NAME_GetResult``."""

        class Request(Message):
            goal_id: UUID = field(default_factory=UUID)

        class Response(Message):
            status: int8 = 0
            result: Message = field(default_factory=Message)

    class FeedbackMessage(Message):
        """What a type checker sees of ``NAME_FeedbackMessage``."""

        goal_id: UUID = field(default_factory=UUID)
        feedback: Message = field(default_factory=Message)


__all__ = ["Implied", "event_message", "implied", "owner_and_part", "part_of"]


class Implied(msgspec.Struct, frozen=True):
    """The services and the message that an action is sent in.

    Attributes:
        send_goal: Service: goal id and goal, answered by whether and when it was accepted.
        get_result: Service: goal id, answered by status and result.
        feedback_message: Message: goal id and feedback.
    """

    send_goal: type[SendGoal]
    get_result: type[GetResult]
    feedback_message: type[FeedbackMessage]


#: What stands behind an action's name, and the attribute of ``Implied`` that it names.
WRAPPERS = {
    "SendGoal": "send_goal",
    "GetResult": "get_result",
    "FeedbackMessage": "feedback_message",
}
SUFFIXES = frozenset({*PARTS["srv"], *PARTS["action"], *WRAPPERS, "Event"})


def implied(action_type: type[Action]) -> Implied:
    """What this action is sent in, as classes: the same ones every time.

    Raises:
        InvalidInterface: if the class has no type name.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> implied(Fibonacci).send_goal.Request(goal=Fibonacci.Goal(order=5)).goal
    Goal(order=5)
    """
    if action_type._implied is None:
        action_type._implied = make_implied(action_type)
    return cast("Implied", action_type._implied)


def event_message(service: type[Service]) -> type[Message]:
    """What the introspection of this service sends: ``NAME_Event``, the same class every time.

    Raises:
        InvalidInterface: if the class has no type name.
    """
    # mypy asks the class's instances for a hash, but it is the class that is looked up.
    return made_event(service)  # type: ignore[arg-type]


def owner_and_part(type_name: str) -> tuple[str, str]:
    """The service or action that a name says implies it, and as what; two empty strings if none.

    >>> owner_and_part("example_interfaces/action/Fibonacci_SendGoal_Request")
    ('example_interfaces/action/Fibonacci_SendGoal', 'Request')
    """
    owner, _, part = type_name.rpartition("_")
    return (owner, part) if part in SUFFIXES and "/msg/" not in owner else ("", "")


def part_of(owner: Interface | None, part: str) -> Interface | None:
    """The type that goes by the name of ``owner`` and ``_PART``, or None."""
    if owner is None or issubclass(owner, Message):
        return None
    if issubclass(owner, Service) and part == "Event":
        return event_message(owner)
    if issubclass(owner, Action) and part in WRAPPERS:
        return cast("Interface", getattr(implied(owner), WRAPPERS[part]))
    own = PARTS["srv" if issubclass(owner, Service) else "action"]
    return cast("Interface", getattr(owner, part)) if part in own else None


def make_implied(action: type[Action]) -> Implied:
    """Makes the types; fields and their order are ROS's."""
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
    """Makes the type; fields and their order are ROS's."""
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
    """A service whose parts have these fields."""
    name, body = naming(type_name)
    body["Request"] = message(f"{type_name}_Request", request)
    body["Response"] = message(f"{type_name}_Response", response)
    # The metaclass is type, so that type_name reaches __init_subclass__.
    return cast("type[Service]", type(name, (Service,), body, type_name=type_name))


def message(type_name: str, annotations: Mapping[str, object]) -> type[Message]:
    """A message with these fields."""
    name, body = naming(type_name)
    body["__annotations__"] = annotations
    return cast("type[Message]", MessageMeta(name, (Message,), body, type_name=type_name))


def at_most_one(part: type[Message]) -> object:
    """The annotation of a list that holds one such message, or none."""
    return annotation_of(FieldType(part.type_name, None, ArrayForm.BOUNDED, 1), part)


def naming(type_name: str) -> tuple[str, dict[str, object]]:
    """The name of a class as rosidl gives it, and a class body that says its place."""
    package, kind, name = type_name.split("/")
    return name, {"__module__": f"{package}.{kind}", "__qualname__": name}
