"""rosapi: what clients ask of the graph, and of the interfaces in it.

Its services are answered here, for clients of the web alone; they are not on the graph. The names
of types are those of ROS 2 (``pkg/msg/Name``), the typedefs those of rosapi.

Source: rosapi ``rosapi_node.py``, ``proxy.py`` and ``rosapi_msgs``.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Final, TypeAlias, cast

from turtleact.errors import InvalidMessage, ServerUnavailable, TurtleactError
from turtleact.interfaces import known_interfaces
from turtleact.interfaces.definition import did_you_mean
from turtleact.node import Node
from turtleact.transports.base import EndpointKind
from turtleact.web.directory import ALWAYS, SERVICE_KINDS, Directory
from turtleact.web.parameters import Parameters
from turtleact.web.spelling import (
    absolute,
    action_class,
    message_class,
    service_class,
    type_name,
)
from turtleact.web.typedefs import full_text, typedefs

__all__ = ["Rosapi"]

Values: TypeAlias = dict[str, Any]
Answer: TypeAlias = Callable[..., Values | Awaitable[Values]]

DISTRO: Final = "jazzy"
"""The distribution whose interfaces ship."""


class Rosapi:
    """Answers rosapi's services.

    Args:
        node: Its graph is what is told.
        directory: Knows its endpoints.
        parameters: Gets and sets parameters.
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
            "message_details": (("type",), _message_details),
            "service_request_details": (("type",), _service_request_details),
            "service_response_details": (("type",), _service_response_details),
            "action_goal_details": (("type",), _action_goal_details),
            "action_result_details": (("type",), _action_result_details),
            "action_feedback_details": (("type",), _action_feedback_details),
            "get_param": (("name", "default_value"), parameters.get),
            "set_param": (("name", "value"), parameters.set),
            "has_param": (("name",), parameters.has),
            "delete_param": (("name",), parameters.delete),
            "get_param_names": ((), parameters.names),
            "get_time": ((), self._get_time),
            "get_ros_version": ((), _get_ros_version),
        }

    async def call(self, service: str, args: object) -> Values | None:
        """The values of a response; None if that is no service of rosapi.

        Args:
            service: The name as a client spells it, with or without the leading slash.
            args: An object by names, or a list in the order of rosapi's request.

        Raises:
            ServerUnavailable: if rosapi has no such service.
            InvalidMessage: if an argument is no text.
            TurtleactError: if a type is not known, a name breaks the rules, or a node is silent.
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
        """Foxglove and Lichtblick take a graph without ``/rosout`` for one of ROS 1."""
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
        name = absolute(node)
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
        return {"type": next(iter(self._node.graph().actions.get(absolute(action), ())), "")}

    def _interfaces(self) -> Values:
        return {"interfaces": list(known_interfaces())}

    # the rest

    def _get_time(self) -> Values:
        seconds, nanoseconds = divmod(self._node.clock.now(), 1_000_000_000)
        time = {"sec": seconds, "nanosec": nanoseconds}
        return {"time": {**time, "secs": seconds, "nsecs": nanoseconds}}

    def _first_type(self, kinds: tuple[EndpointKind, ...], name: str) -> str:
        return next(iter(self._directory.types(kinds, absolute(name))), "")

    def _nodes_of(self, kinds: tuple[EndpointKind, ...], name: str) -> list[str]:
        return sorted({endpoint.node for endpoint in self._directory.find(kinds, absolute(name))})


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
        return full_text(message_class(name))
    except TurtleactError as error:
        return f"# {error}"


def _message_details(type: str) -> Values:
    return {"typedefs": typedefs(message_class(type))}


def _service_request_details(type: str) -> Values:
    return {"typedefs": typedefs(service_class(type).Request)}


def _service_response_details(type: str) -> Values:
    return {"typedefs": typedefs(service_class(type).Response)}


def _action_goal_details(type: str) -> Values:
    return {"typedefs": typedefs(action_class(type).Goal)}


def _action_result_details(type: str) -> Values:
    return {"typedefs": typedefs(action_class(type).Result)}


def _action_feedback_details(type: str) -> Values:
    return {"typedefs": typedefs(action_class(type).Feedback)}


def _get_ros_version() -> Values:
    return {"version": 2, "distro": DISTRO}
