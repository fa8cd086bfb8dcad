"""The parameters of other nodes: reading and setting them, and hearing of their changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from turtleact.names import PARAMETER_SERVICES
from turtleact.rclpy.impl.entity import CallbackGroup, wait_until
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from turtleact.rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_services_default,
)
from turtleact.rclpy.task import Future

if TYPE_CHECKING:
    from turtleact.rclpy.node import Node

__all__ = [
    "AsyncParameterClient",
    "ParameterCallbackHandle",
    "ParameterEventCallbackHandle",
    "ParameterEventHandler",
]

WhenDone: TypeAlias = Callable[[Future], object] | None
"""A function that gets the future of a response when the future is done."""


class AsyncParameterClient:
    """Calls the parameter services of another node. A call returns a future with the response.

    Args:
        node: The node that calls.
        remote_node_name: The name of the other node.
        qos_profile: Ignored.
        callback_group: Decides when responses may be handled.
    """

    def __init__(
        self,
        node: Node,
        remote_node_name: str,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.remote_node_name = remote_node_name
        self.node = node
        self._clients = {
            name: node.create_client(
                interface_class(f"rcl_interfaces/srv/{name.title().replace('_', '')}"),
                f"{remote_node_name}/{name}",
                qos_profile=qos_profile,
                callback_group=callback_group,
            )
            for name in PARAMETER_SERVICES
        }

    def services_are_ready(self) -> bool:
        """Whether all parameter services of the other node are available."""
        return all(client.service_is_ready() for client in self._clients.values())

    def wait_for_services(self, timeout_sec: float | None = None) -> bool:
        """Wait until all services are available. Return False if ``timeout_sec`` ends first."""
        return wait_until(self.services_are_ready, timeout_sec, self.node.context.ok)

    def list_parameters(
        self,
        prefixes: Sequence[str] | None = None,
        depth: int | None = None,
        callback: WhenDone = None,
    ) -> Future:
        """Request the names of all parameters, or only of those with one of the prefixes."""
        return self._call(
            "list_parameters", callback, prefixes=list(prefixes or ()), depth=depth or 0
        )

    def get_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the values of parameters."""
        return self._call("get_parameters", callback, names=list(names))

    def set_parameters(self, parameters: Sequence[Anything], callback: WhenDone = None) -> Future:
        """Set parameters one by one. Each is a `Parameter` or a message."""
        return self._call("set_parameters", callback, parameters=_messages(parameters))

    def set_parameters_atomically(
        self, parameters: Sequence[Anything], callback: WhenDone = None
    ) -> Future:
        """Set all the given parameters, or none. Each is a `Parameter` or a message."""
        return self._call("set_parameters_atomically", callback, parameters=_messages(parameters))

    def describe_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the descriptors of parameters."""
        return self._call("describe_parameters", callback, names=list(names))

    def get_parameter_types(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the types of parameters."""
        return self._call("get_parameter_types", callback, names=list(names))

    def delete_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Ask the node to delete parameters.

        The node deletes a declared parameter only if the parameter has a dynamic type.
        """
        return self.set_parameters([Parameter(name) for name in names], callback)

    def load_parameter_file(
        self, parameter_file: str, use_wildcard: bool = False, callback: WhenDone = None
    ) -> Future:
        """Set the parameters in a file, one by one."""
        loaded = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters(list(loaded.values()), callback)

    def load_parameter_file_atomically(
        self, parameter_file: str, use_wildcard: bool = False, callback: WhenDone = None
    ) -> Future:
        """Set all the parameters in a file, or none."""
        loaded = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters_atomically(list(loaded.values()), callback)

    def on_parameter_event(
        self,
        callback: Callable[[Anything], object],
        qos_profile: QoSProfile = qos_profile_parameter_events,
        *,
        callback_group: CallbackGroup | None = None,
    ) -> Anything:
        """Call ``callback(event)`` when parameters of any node change; return the subscription."""
        return _subscribe(self.node, callback, qos_profile, callback_group)

    def _call(self, service: str, callback: WhenDone, **fields: Anything) -> Future:
        client = self._clients[service]
        future = client.call_async(client.srv_type.Request(**fields))
        if callback is not None:
            future.add_done_callback(callback)
        return future


def _messages(parameters: Sequence[Anything]) -> list[Anything]:
    return [each.to_parameter_msg() if isinstance(each, Parameter) else each for each in parameters]


def _subscribe(
    node: Node,
    callback: Callable[[Anything], object],
    qos_profile: QoSProfile,
    callback_group: CallbackGroup | None,
) -> Anything:
    return node.create_subscription(
        interface_class("rcl_interfaces/msg/ParameterEvent"),
        "/parameter_events",
        callback,
        qos_profile,
        callback_group=callback_group,
    )


class ParameterCallbackHandle(NamedTuple):
    """A callback for one parameter of one node."""

    parameter_name: str
    node_name: str
    callback: Callable[[Anything], object]


class ParameterEventCallbackHandle(NamedTuple):
    """A callback for all parameter events."""

    callback: Callable[[Anything], object]


class ParameterEventHandler:
    """Calls callbacks for the events on ``/parameter_events``.

    Callbacks for single parameters are called before callbacks for all events. Callbacks for the
    same parameter are called in reverse order of their registration, and so are callbacks for all
    events.

    Args:
        node: The node that subscribes to the topic.
        qos_profile: The quality of service of the subscription.
        callback_group: Decides when callbacks may run.
    """

    class Callbacks:
        """The callbacks of a `ParameterEventHandler`.

        Attributes:
            parameter_callbacks: The callbacks for single parameters, keyed by parameter name and
                node name.
            event_callbacks: The callbacks for all events.
        """

        def __init__(self) -> None:
            self.parameter_callbacks: dict[tuple[str, str], list[ParameterCallbackHandle]] = {}
            self.event_callbacks: list[ParameterEventCallbackHandle] = []

        def event_callback(self, event: Anything) -> None:
            """Call the callbacks for the parameters in an event, then those for all events."""
            # Copies, because a callback may add or remove others.
            for (name, node), handles in list(self.parameter_callbacks.items()):
                found = ParameterEventHandler.get_parameter_from_event(event, name, node)
                for handle in [] if found is None else list(handles):
                    handle.callback(found)
            for each in list(self.event_callbacks):
                each.callback(event)

    def __init__(
        self,
        node: Node,
        qos_profile: QoSProfile = qos_profile_parameter_events,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.node = node
        self._callbacks = self.Callbacks()
        self.parameter_event_subscription = _subscribe(
            node, self._callbacks.event_callback, qos_profile, callback_group
        )

    def destroy(self) -> None:
        """Close the subscription."""
        self.node.destroy_subscription(self.parameter_event_subscription)

    @staticmethod
    def get_parameter_from_event(
        event: Anything, parameter_name: str, node_name: str
    ) -> Anything | None:
        """Return a node's new or changed parameter from an event; None if not in the event."""
        if event.node != node_name:
            return None
        found = ParameterEventHandler.get_parameters_from_event(event)
        return next((each for each in found if each.name == parameter_name), None)

    @staticmethod
    def get_parameters_from_event(event: Anything) -> Iterator[Anything]:
        """Return all new and changed parameters in an event."""
        yield from event.new_parameters
        yield from event.changed_parameters

    def add_parameter_callback(
        self, parameter_name: str, node_name: str, callback: Callable[[Anything], object]
    ) -> ParameterCallbackHandle:
        """Call ``callback(parameter)`` when a parameter of a node is new or changes."""
        handle = ParameterCallbackHandle(parameter_name, self._resolve_path(node_name), callback)
        self._callbacks.parameter_callbacks.setdefault(handle[:2], []).insert(0, handle)
        return handle

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        _remove(self._callbacks.parameter_callbacks.get(handle[:2], []), handle)

    def add_parameter_event_callback(
        self, callback: Callable[[Anything], object]
    ) -> ParameterEventCallbackHandle:
        """Call ``callback(event)`` on every event about parameters of any node."""
        handle = ParameterEventCallbackHandle(callback)
        self._callbacks.event_callbacks.insert(0, handle)
        return handle

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        _remove(self._callbacks.event_callbacks, handle)

    def _resolve_path(self, node_path: str = "") -> str:
        """Return the full name of a node; by default, of the node of this handler."""
        if not node_path:
            return self.node.get_fully_qualified_name()
        if node_path.startswith("/"):
            return node_path
        return f"{self.node.get_namespace().rstrip('/')}/{node_path}"


def _remove(handles: list[Anything], handle: object) -> None:
    if handle not in handles:
        raise RuntimeError("Callback doesn't exist")
    handles.remove(handle)
