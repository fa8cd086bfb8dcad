"""Reads and sets the parameters of another node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.impl.waiting import wait_until
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from turtleact.rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_services_default,
)
from turtleact.rclpy.task import Future

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup
    from turtleact.rclpy.client import Client
    from turtleact.rclpy.node import Node
    from turtleact.rclpy.subscription import Subscription

__all__ = ["AsyncParameterClient"]

SERVICES = (
    "GetParameters",
    "SetParameters",
    "ListParameters",
    "DescribeParameters",
    "GetParameterTypes",
    "SetParametersAtomically",
)


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
        self._clients: dict[str, Client] = {}
        for kind in SERVICES:
            snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in kind)[1:]
            self._clients[kind] = node.create_client(
                interface_class(f"rcl_interfaces/srv/{kind}"),
                f"{remote_node_name}/{snake}",
                qos_profile=qos_profile,
                callback_group=callback_group,
            )

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
        callback: Callable[[Future], object] | None = None,
    ) -> Future:
        """Request the names of all parameters, or only of those with one of the prefixes."""
        fields: dict[str, Anything] = {}
        if prefixes:
            fields["prefixes"] = list(prefixes)
        if depth:
            fields["depth"] = depth
        return self._call("ListParameters", callback, **fields)

    def get_parameters(
        self, names: Sequence[str], callback: Callable[[Future], object] | None = None
    ) -> Future:
        """Request the values of parameters."""
        return self._call("GetParameters", callback, names=list(names))

    def set_parameters(
        self,
        parameters: Sequence[Anything],
        callback: Callable[[Future], object] | None = None,
    ) -> Future:
        """Set parameters one by one. Each is a `Parameter` or a message."""
        return self._call("SetParameters", callback, parameters=_messages(parameters))

    def set_parameters_atomically(
        self,
        parameters: Sequence[Anything],
        callback: Callable[[Future], object] | None = None,
    ) -> Future:
        """Set all the given parameters, or none. Each is a `Parameter` or a message."""
        return self._call("SetParametersAtomically", callback, parameters=_messages(parameters))

    def describe_parameters(
        self, names: Sequence[str], callback: Callable[[Future], object] | None = None
    ) -> Future:
        """Request the descriptors of parameters."""
        return self._call("DescribeParameters", callback, names=list(names))

    def get_parameter_types(
        self, names: Sequence[str], callback: Callable[[Future], object] | None = None
    ) -> Future:
        """Request the types of parameters."""
        return self._call("GetParameterTypes", callback, names=list(names))

    def delete_parameters(
        self, names: Sequence[str], callback: Callable[[Future], object] | None = None
    ) -> Future:
        """Ask the node to delete parameters.

        The node deletes a declared parameter only if the parameter has a dynamic type.
        """
        return self.set_parameters([Parameter(name) for name in names], callback)

    def load_parameter_file(
        self,
        parameter_file: str,
        use_wildcard: bool = False,
        callback: Callable[[Future], object] | None = None,
    ) -> Future:
        """Set the parameters in a file, one by one."""
        return self.set_parameters(self._loaded(parameter_file, use_wildcard), callback)

    def load_parameter_file_atomically(
        self,
        parameter_file: str,
        use_wildcard: bool = False,
        callback: Callable[[Future], object] | None = None,
    ) -> Future:
        """Set all the parameters in a file, or none."""
        return self.set_parameters_atomically(self._loaded(parameter_file, use_wildcard), callback)

    def on_parameter_event(
        self,
        callback: Callable[[Anything], object],
        qos_profile: QoSProfile = qos_profile_parameter_events,
        *,
        callback_group: CallbackGroup | None = None,
    ) -> Subscription:
        """Call ``callback(event)`` when parameters of any node change."""
        return self.node.create_subscription(
            interface_class("rcl_interfaces/msg/ParameterEvent"),
            "/parameter_events",
            callback,
            qos_profile,
            callback_group=callback_group,
        )

    def _loaded(self, parameter_file: str, use_wildcard: bool) -> list[Anything]:
        return list(parameter_dict_from_yaml_file(parameter_file, use_wildcard).values())

    def _call(
        self, kind: str, callback: Callable[[Future], object] | None, **fields: Anything
    ) -> Future:
        client = self._clients[kind]
        future = client.call_async(client.srv_type.Request(**fields))
        if callback is not None:
            future.add_done_callback(callback)
        return future


def _messages(parameters: Sequence[Anything]) -> list[Anything]:
    return [each.to_parameter_msg() if isinstance(each, Parameter) else each for each in parameters]
