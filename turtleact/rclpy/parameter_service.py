"""The six services with which other nodes read and set the parameters of a node."""

from __future__ import annotations

from turtleact.rclpy.exceptions import ParameterNotDeclaredException
from turtleact.rclpy.impl.node_parameters import NodeParameters
from turtleact.rclpy.impl.typing import Anything, ServiceHost
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import qos_profile_parameters

__all__ = ["ParameterService"]


class ParameterService:
    """Creates the six parameter services on a node. They are destroyed with the node.

    Args:
        node: The node.
        parameters: The parameters of the node.
    """

    def __init__(self, node: ServiceHost, parameters: NodeParameters) -> None:
        self._parameters = parameters
        name = node.get_name()
        for kind, callback in (
            ("DescribeParameters", self._describe),
            ("GetParameters", self._get),
            ("GetParameterTypes", self._get_types),
            ("ListParameters", self._list),
            ("SetParameters", self._set),
            ("SetParametersAtomically", self._set_atomically),
        ):
            snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in kind)[1:]
            node.create_service(
                interface_class(f"rcl_interfaces/srv/{kind}"),
                f"{name}/{snake}",
                callback,
                qos_profile=qos_profile_parameters,
            )

    def _describe(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/ParameterDescriptor")
        for name in request.names:
            try:
                descriptor = self._parameters.describe_parameter(name)
            except ParameterNotDeclaredException:
                descriptor = made(name=name)
            response.descriptors.append(descriptor)
        return response

    def _get(self, request: Anything, response: Anything) -> Anything:
        for name in request.names:
            if self._parameters.get_parameter_or(name).type_ is Parameter.Type.NOT_SET:
                # One unknown name leaves the answer empty, as in rclpy.
                response.values = []
                return response
            parameter = self._parameters.get_parameter_or(name)
            response.values.append(parameter.get_parameter_value())
        return response

    def _get_types(self, request: Anything, response: Anything) -> Anything:
        try:
            found = self._parameters.get_parameter_types(list(request.names))
        except ParameterNotDeclaredException:
            found = []
        response.types = [kind.value for kind in found]
        return response

    def _list(self, request: Anything, response: Anything) -> Anything:
        response.result = self._parameters.list_parameters(list(request.prefixes), request.depth)
        return response

    def _set(self, request: Anything, response: Anything) -> Anything:
        for message in request.parameters:
            parameter = Parameter.from_parameter_msg(message)
            response.results.append(self._set_one(parameter))
        return response

    def _set_one(self, parameter: Parameter) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetParametersResult")
        try:
            return self._parameters.set_parameters_atomically([parameter])
        except ParameterNotDeclaredException as error:
            return made(successful=False, reason=str(error))

    def _set_atomically(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetParametersResult")
        parameters = [Parameter.from_parameter_msg(each) for each in request.parameters]
        try:
            response.result = self._parameters.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException as error:
            response.result = made(successful=False, reason=str(error))
        return response
