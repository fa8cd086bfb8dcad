"""Classes made of definitions, as a class statement would make them.

Knows neither files nor what is known already: whoever calls brings a ``find``, which gives the
class of an interface or raises ``UnknownInterface``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, cast

from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces.annotations import annotation_of
from turtleact.interfaces.definition import parts_of
from turtleact.interfaces.types import Action, Message, MessageMeta, Service

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import (
        ActionDefinition,
        Field,
        MessageDefinition,
        ServiceDefinition,
    )
    from turtleact.interfaces.registry import Interface

    Find = Callable[[str], Interface]

__all__ = ["make_action", "make_message", "make_service"]


def make_message(
    definition: MessageDefinition, find: Find, *, part: str = "", whole: str = ""
) -> type[Message]:
    """A message class; as a part of a service or action it is named by that."""
    package, kind, name = definition.type_name.split("/")
    annotations: dict[str, object] = {}
    body: dict[str, object] = {
        "__module__": f"{package}.{kind}",
        "__qualname__": f"{whole}.{part}" if part else name,
        "__annotations__": annotations,
    }
    for constant in definition.constants:
        annotations[constant.name] = ClassVar[annotation_of(constant.type, None)]
        body[constant.name] = constant.value
    for field in definition.fields:
        annotations[field.attribute] = annotation_of(field.type, nested(definition, field, find))
        if field.default is not None:
            body[field.attribute] = field.default
    type_name = "" if part else definition.type_name
    made = MessageMeta(part or name, (Message,), body, type_name=type_name)
    return cast("type[Message]", made)


def make_service(definition: ServiceDefinition, find: Find) -> type[Service]:
    """A service class."""
    return cast("type[Service]", whole_class(definition, Service, ("Request", "Response"), find))


def make_action(definition: ActionDefinition, find: Find) -> type[Action]:
    """An action class."""
    return cast(
        "type[Action]", whole_class(definition, Action, ("Goal", "Result", "Feedback"), find)
    )


def nested(definition: MessageDefinition, field: Field, find: Find) -> type[Message] | None:
    """The class of the messages in a field; None where it holds primitives."""
    if not field.type.is_nested:
        return None
    try:
        found = find(field.type.name)
    except UnknownInterface as error:
        problem = f"{field.name}: {error}"
        raise InvalidInterface(problem, source=definition.type_name) from error
    if not issubclass(found, Message):
        problem = f"{field.name}: {field.type.name} is no message"
        raise InvalidInterface(problem, source=definition.type_name)
    return found


def whole_class(
    definition: ServiceDefinition | ActionDefinition, base: type, names: tuple[str, ...], find: Find
) -> type:
    """A class with its parts inside."""
    package, kind, name = definition.type_name.split("/")
    body: dict[str, object] = {"__module__": f"{package}.{kind}"}
    for part, content in zip(names, parts_of(definition), strict=True):
        body[part] = make_message(content, find, part=part, whole=name)
    # The metaclass is type, so that type_name reaches __init_subclass__.
    return type(name, (base,), body, type_name=definition.type_name)
