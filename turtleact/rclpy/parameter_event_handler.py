"""Calls functions when parameters of any node change."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.qos import QoSProfile, qos_profile_parameter_events

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup
    from turtleact.rclpy.node import Node

__all__ = ["ParameterCallbackHandle", "ParameterEventCallbackHandle", "ParameterEventHandler"]


class ParameterCallbackHandle:
    """A callback for one parameter of one node."""

    def __init__(
        self, parameter_name: str, node_name: str, callback: Callable[[Anything], object]
    ) -> None:
        self.parameter_name = parameter_name
        self.node_name = node_name
        self.callback = callback


class ParameterEventCallbackHandle:
    """A callback for all parameter events."""

    def __init__(self, callback: Callable[[Anything], object]) -> None:
        self.callback = callback


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
            self.parameter_callbacks: dict[tuple[str, str], list[ParameterCallbackHandle]] = (
                defaultdict(list)
            )
            self.event_callbacks: list[ParameterEventCallbackHandle] = []
            self.lock = threading.Lock()

        def event_callback(self, event: Anything) -> None:
            """Call the callbacks for the parameters in an event, then those for all events."""
            with self.lock:
                ones = {key: list(each) for key, each in self.parameter_callbacks.items()}
                alls = list(self.event_callbacks)
            for (name, node), handles in ones.items():
                found = ParameterEventHandler.get_parameter_from_event(event, name, node)
                if found is not None:
                    for handle in handles:
                        handle.callback(found)
            for each in alls:
                each.callback(event)

    def __init__(
        self,
        node: Node,
        qos_profile: QoSProfile = qos_profile_parameter_events,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.node = node
        self._callbacks = self.Callbacks()
        self.parameter_event_subscription = node.create_subscription(
            interface_class("rcl_interfaces/msg/ParameterEvent"),
            "/parameter_events",
            self._callbacks.event_callback,
            qos_profile,
            callback_group=callback_group,
        )

    def destroy(self) -> None:
        """Close the subscription of ``/parameter_events``."""
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
        with self._callbacks.lock:
            key = handle.parameter_name, handle.node_name
            self._callbacks.parameter_callbacks[key].insert(0, handle)
        return handle

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        with self._callbacks.lock:
            handles = self._callbacks.parameter_callbacks.get(
                (handle.parameter_name, handle.node_name), []
            )
            if handle not in handles:
                raise RuntimeError("Callback doesn't exist")
            handles.remove(handle)
            if not handles:
                del self._callbacks.parameter_callbacks[handle.parameter_name, handle.node_name]

    def add_parameter_event_callback(
        self, callback: Callable[[Anything], object]
    ) -> ParameterEventCallbackHandle:
        """Call ``callback(event)`` on every event about parameters of any node."""
        handle = ParameterEventCallbackHandle(callback)
        with self._callbacks.lock:
            self._callbacks.event_callbacks.insert(0, handle)
        return handle

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        with self._callbacks.lock:
            if handle not in self._callbacks.event_callbacks:
                raise RuntimeError("Callback doesn't exist")
            self._callbacks.event_callbacks.remove(handle)

    def _resolve_path(self, node_path: str | None = None) -> str:
        """Return the full name of a node; None means the node of this handler."""
        if not node_path:
            return self.node.get_fully_qualified_name()
        if node_path.startswith("/"):
            return node_path
        return f"{self.node.get_namespace().rstrip('/')}/{node_path}"
