"""Answers rosapi's services, which describe the graph, and get and set parameters.

Only web clients can call these services, because they are not on the graph. Type names have the
form of ROS 2 (``pkg/msg/Name``). In typedefs, type names have the form of rosapi (``pkg/Name``).

A name such as ``/turtlesim:background_b`` stands for the parameter ``background_b`` of the node
``/turtlesim``. This module gets and sets such a parameter through the node's parameter services.
Parameters without a colon in their names belong to the clients, and are kept until the bridge is
closed. Values of parameters are JSON text.

Source: rosapi ``rosapi_node.py``, ``proxy.py``, ``params.py``, ``objectutils.py`` and
``stringify_field_types.py``, and ``rosapi_msgs``; package ``rcl_interfaces`` of ROS 2 Jazzy.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Final, Protocol, TypeAlias, TypeVar, cast

import msgspec

from turtleact.errors import InvalidMessage, InvalidParameter, ServerUnavailable, TurtleactError
from turtleact.interfaces import Message, fields, known_interfaces
from turtleact.interfaces.definition import ArrayForm, Field, did_you_mean
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    Parameter,
    ParameterValue,
    SetParametersResult,
)
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    GetParameters,
    ListParameters,
    SetParameters,
)
from turtleact.interfaces.types import constants, nested_classes
from turtleact.names import resolve_name
from turtleact.node import Node
from turtleact.node.parameter_rules import fitted, value_of
from turtleact.node.services import ServiceType
from turtleact.recording.schemas import schema_of, short_name
from turtleact.transports.base import EndpointKind
from turtleact.web.name_lookup import (
    ALWAYS,
    SERVICE_KINDS,
    Directory,
    action_class,
    message_class,
    service_class,
    type_name,
)

__all__ = [
    "Parameters",
    "Rosapi",
    "typedefs",
]

logger = logging.getLogger("turtleact.web")

Values: TypeAlias = dict[str, Any]
Answer: TypeAlias = Callable[..., Values | Awaitable[Values]]

DISTRO: Final = "jazzy"
"""The ROS distribution of the built-in interfaces."""

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

LIST: Final = "/list_parameters"

PROBLEM: Final = "expected true, false, a number, text, or a list of one of these"


class Rosapi:
    """Answers rosapi's services.

    Args:
        node: A node on the graph that the answers describe.
        directory: Looks up the endpoints of the graph.
        parameters: Answers the services for parameters.
    """

    def __init__(self, node: Node, directory: Directory, parameters: Parameters) -> None:
        self._node = node
        self._directory = directory
        self._services: dict[str, tuple[tuple[str, ...], Answer]] = {
            "topics": ((), self._topics),
            "topics_and_raw_types": ((), self._topics_and_raw_types),
            "topics_for_type": (("type",), self._topics_for_type),
            "topic_type": (("topic",), self._topic_type),
            "services": ((), self._list_services),
            "services_for_type": (("type",), self._services_for_type),
            "service_type": (("service",), self._service_type),
            "service_node": (("service",), self._service_node),
            "service_providers": (("service",), self._service_providers),
            "nodes": ((), self._nodes),
            "node_details": (("node",), self._node_details),
            "publishers": (("topic",), self._publishers),
            "subscribers": (("topic",), self._subscribers),
            "action_servers": ((), self._action_servers),
            "action_type": (("action",), self._action_type),
            "interfaces": ((), self._interfaces),
            **{name: (("type",), partial(_details, find)) for name, find in DETAILS.items()},
            "get_param": (("name", "default_value"), parameters.get),
            "set_param": (("name", "value"), parameters.set),
            "has_param": (("name",), parameters.has),
            "delete_param": (("name",), parameters.delete),
            "get_param_names": ((), parameters.names),
            "get_time": ((), self._get_time),
            "get_ros_version": ((), _get_ros_version),
        }

    async def call(self, service: str, args: object) -> Values | None:
        """Return the response of a service under ``/rosapi/``; None for any other service.

        Args:
            service: The service's name, with or without the leading slash.
            args: A dict of arguments by name, or a list of arguments in the order of the request's
                fields.

        Raises:
            ServerUnavailable: if rosapi has no service with this name.
            InvalidMessage: if an argument is not a string.
            TurtleactError: if a type is not known, a name breaks ROS 2's rules, or a node does not
                answer.
        """
        prefix, _, name = service.removeprefix("/").partition("/")
        if prefix != "rosapi" or not name:
            return None
        if name not in self._services:
            hint = did_you_mean(name[:100], self._services)
            problem = f"rosapi has no such service{hint}"
            raise ServerUnavailable(f"/rosapi/{name[:100]}", problem, kind="service")
        names, function = self._services[name]
        if isinstance(args, list):
            args = dict(zip(names, args, strict=False))
        given = cast("Values", args or {})
        values = function(*(_text(each, given.get(each)) for each in names))
        return values if isinstance(values, dict) else await values

    # topics

    def _topics(self) -> Values:
        topics = self._node.graph().topics
        return {"topics": list(topics), "types": [types[0] for types in topics.values()]}

    def _topics_and_raw_types(self) -> Values:
        """Return all topics, their types, and the definitions of the types.

        ``/rosout`` is always included. Without ``/rosout``, Foxglove and Lichtblick would treat the
        graph as a ROS 1 graph.
        """
        listed = self._topics()
        for topic, type in ALWAYS.items():
            if topic not in listed["topics"]:
                listed["topics"].append(topic)
                listed["types"].append(type)
        return {**listed, "typedefs_full_text": [_definition(each) for each in listed["types"]]}

    def _topics_for_type(self, type: str) -> Values:
        wanted = type_name(type, "msg")
        topics = self._node.graph().topics
        return {"topics": [topic for topic, types in topics.items() if wanted in types]}

    def _topic_type(self, topic: str) -> Values:
        return {"type": self._first_type(("publisher", "subscription"), topic)}

    def _publishers(self, topic: str) -> Values:
        return {"publishers": self._nodes_of(("publisher",), topic)}

    def _subscribers(self, topic: str) -> Values:
        return {"subscribers": self._nodes_of(("subscription",), topic)}

    # services

    def _list_services(self) -> Values:
        return {"services": list(self._node.graph().services)}

    def _services_for_type(self, type: str) -> Values:
        wanted = type_name(type, "srv")
        services = self._node.graph().services
        return {"services": [name for name, types in services.items() if wanted in types]}

    def _service_type(self, service: str) -> Values:
        return {"type": self._first_type(SERVICE_KINDS, service)}

    def _service_node(self, service: str) -> Values:
        return {"node": next(iter(self._nodes_of(SERVICE_KINDS, service)), "")}

    def _service_providers(self, service: str) -> Values:
        return {"providers": self._nodes_of(SERVICE_KINDS, service)}

    # nodes and actions

    def _nodes(self) -> Values:
        return {"nodes": list(self._node.graph().nodes)}

    def _node_details(self, node: str) -> Values:
        name = resolve_name(node)
        return {
            member: sorted(
                {
                    endpoint.name
                    for endpoint in self._directory.find((kind,))
                    if endpoint.node == name and "/_" not in endpoint.name
                }
            )
            for member, kind in NODE_DETAILS.items()
        }

    def _action_servers(self) -> Values:
        return {"action_servers": list(self._node.graph().actions)}

    def _action_type(self, action: str) -> Values:
        return {"type": next(iter(self._node.graph().actions.get(resolve_name(action), ())), "")}

    def _interfaces(self) -> Values:
        return {"interfaces": list(known_interfaces())}

    # the rest

    def _get_time(self) -> Values:
        seconds, nanoseconds = divmod(self._node.clock.now(), 1_000_000_000)
        time = {"sec": seconds, "nanosec": nanoseconds}
        return {"time": {**time, "secs": seconds, "nsecs": nanoseconds}}

    def _first_type(self, kinds: tuple[EndpointKind, ...], name: str) -> str:
        return next(iter(self._directory.types(kinds, resolve_name(name))), "")

    def _nodes_of(self, kinds: tuple[EndpointKind, ...], name: str) -> list[str]:
        return sorted(
            {endpoint.node for endpoint in self._directory.find(kinds, resolve_name(name))}
        )


class Ask(Protocol):
    """A function that calls a service."""

    async def __call__(self, name: str, service_type: ServiceType[Req, Res], request: Req) -> Res:
        """Call the service with this name and type, and return its response."""


class Parameters:
    """Answers rosapi's services for parameters.

    Args:
        node: A node on the graph.
        ask: A function that calls the parameter services of other nodes.
    """

    def __init__(self, node: Node, ask: Ask) -> None:
        self._node = node
        self._ask = ask
        self._own: dict[str, str] = {}

    async def get(self, name: str, default: str) -> Values:
        """Answer ``get_param``."""
        value = await self._value(name)
        if value is None:
            return {"value": default or "null", "successful": bool(default)}
        return {"value": value, "successful": True}

    async def set(self, name: str, value: str) -> Values:
        """Answer ``set_param``."""
        if ":" in name:
            return await self._set_of_node(name, value)
        self._own[name] = value
        return {"successful": True, "reason": ""}

    async def has(self, name: str) -> Values:
        """Answer ``has_param``."""
        return {"exists": await self._value(name) is not None}

    async def delete(self, name: str) -> Values:
        """Answer ``delete_param``."""
        if await self._value(name) is None:
            return {"successful": False, "reason": "there is no such parameter"}
        if ":" in name:
            return await self._set_of_node(name, "null")
        del self._own[name]
        return {"successful": True, "reason": ""}

    async def names(self) -> Values:
        """Answer ``get_param_names``. The parameters of nodes that do not answer are left out."""
        found = sorted(self._own)
        for service, types in self._node.graph().services.items():
            if not service.endswith(LIST) or ListParameters.type_name not in types:
                continue
            try:
                listed = await self._ask(service, ListParameters, ListParameters.Request())
            except TurtleactError as error:
                logger.warning("parameters are left out: %s", error)
            else:
                node = service.removesuffix(LIST)
                found += [f"{node}:{name}" for name in listed.result.names]
        return {"names": found}

    async def _value(self, name: str) -> str | None:
        """Return the value of a parameter as JSON text; None if the parameter is not set."""
        if ":" not in name:
            return self._own.get(name)
        held = await self._held(name)
        value = value_of(held)
        if value is None:
            return None
        return msgspec.json.encode(list(value) if isinstance(value, bytes) else value).decode()

    async def _held(self, name: str) -> ParameterValue:
        """Return the value of a node's parameter.

        If the node has no such parameter, the value has the type ``PARAMETER_NOT_SET``.

        Raises:
            TurtleactError: if the node does not answer.
        """
        node, _, parameter = name.partition(":")
        service = resolve_name(f"{node}/get_parameters")
        answer = await self._ask(service, GetParameters, GetParameters.Request([parameter]))
        return next(iter(answer.values), ParameterValue())

    async def _set_of_node(self, name: str, text: str) -> Values:
        try:
            value = msgspec.json.decode(text)
        except msgspec.DecodeError as error:
            raise InvalidMessage("args.value", f"expected a value as JSON text: {error}") from None
        wanted = _as_parameter(value, (await self._held(name)).type)
        node, _, parameter = name.partition(":")
        request = SetParameters.Request([Parameter(parameter, wanted)])
        answer = await self._ask(resolve_name(f"{node}/set_parameters"), SetParameters, request)
        result = next(iter(answer.results), SetParametersResult(reason="the node does not answer"))
        return {"successful": result.successful, "reason": result.reason}


def typedefs(cls: type[Message]) -> list[dict[str, object]]:
    """Return the typedefs of a message and of all messages in it.

    Each type occurs once. The outermost message comes first.
    """
    return [_typedef(each) for each in _with_nested(cls)]


NODE_DETAILS: Final[dict[str, EndpointKind]] = {
    "subscribing": "subscription",
    "publishing": "publisher",
    "services": "service",
}


def _text(name: str, value: object) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise InvalidMessage(f"args.{name}", f"expected text, got a {type(value).__name__}")
    return value


def _definition(name: str) -> str:
    try:
        return schema_of(message_class(name)).text
    except TurtleactError as error:
        return f"# {error}"


def _details(find: Callable[[str], type[Message]], type: str) -> Values:
    return {"typedefs": typedefs(find(type))}


DETAILS: Final[dict[str, Callable[[str], type[Message]]]] = {
    "message_details": message_class,
    "service_request_details": lambda type: service_class(type).Request,
    "service_response_details": lambda type: service_class(type).Response,
    "action_goal_details": lambda type: action_class(type).Goal,
    "action_result_details": lambda type: action_class(type).Result,
    "action_feedback_details": lambda type: action_class(type).Feedback,
}
"""The services that describe a type, each with the function that finds the described message."""


def _get_ros_version() -> Values:
    return {"version": 2, "distro": DISTRO}


def _as_parameter(value: object, declared: int) -> ParameterValue:
    """Turn a value from JSON into a parameter value, of the declared kind if possible.

    Raises:
        InvalidMessage: if no type of parameter can hold the value.
    """
    if value is None:
        return ParameterValue()
    try:
        return fitted("args.value", value, declared)
    except InvalidParameter:
        raise InvalidMessage("args.value", PROBLEM) from None


def _with_nested(cls: type[Message]) -> list[type[Message]]:
    """Return a message and all messages in it, each once and the outermost first."""
    found = [cls]
    for each in found:  # which grows meanwhile
        nested = [inner for inner in nested_classes(each) if inner is not None]
        found += [inner for inner in dict.fromkeys(nested) if inner not in found]
    return found


def _typedef(cls: type[Message]) -> dict[str, object]:
    known = fields(cls)
    return {
        "type": short_name(cls.type_name),
        "fieldnames": [field.name for field in known],
        "fieldtypes": [_field_type(field) for field in known],
        "fieldarraylen": [_array_length(field) for field in known],
        "examples": [_example(cls, field) for field in known],
        "constnames": [constant.name for constant in constants(cls)],
        "constvalues": [str(constant.value) for constant in constants(cls)],
    }


def _field_type(field: Field) -> str:
    return short_name(field.type.name) if field.type.is_nested else field.type.name


def _array_length(field: Field) -> int:
    """Return the length of a field's array in a typedef of rosapi.

    The length is -1 for a single value, and 0 for a list of variable length.
    """
    if not field.type.is_sequence:
        return -1
    return field.type.size if field.type.form is ArrayForm.FIXED else 0


def _example(cls: type[Message], field: Field) -> str:
    if field.type.is_sequence:
        return "[]"
    return "{}" if field.type.is_nested else str(getattr(cls(), field.attribute))
