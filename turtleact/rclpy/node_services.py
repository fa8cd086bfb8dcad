"""The services that a node offers to other nodes: for parameters, log levels and types.

All services are destroyed with the node. `turtleact.node.learning` answers
``~/get_type_description``.
"""

from __future__ import annotations

from collections.abc import Sequence

from turtleact.names import PARAMETER_SERVICES
from turtleact.rclpy.exceptions import ParameterNotDeclaredException
from turtleact.rclpy.impl.rcutils_logger import LoggingSeverity, logger_named
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import qos_profile_parameters

__all__ = [
    "START_TYPE_DESCRIPTION_SERVICE_PARAM",
    "LoggingService",
    "ParameterService",
    "declares_type_descriptions",
]

START_TYPE_DESCRIPTION_SERVICE_PARAM = "start_type_description_service"


class ParameterService:
    """Creates the six parameter services on a node.

    Args:
        node: The node.
    """

    def __init__(self, node: Anything) -> None:
        self._parameters = node
        answers = (
            self._describe,
            self._get_types,
            self._get,
            self._list,
            self._set,
            self._set_atomically,
        )
        for name, callback in zip(PARAMETER_SERVICES, answers, strict=True):
            node.create_service(
                interface_class(f"rcl_interfaces/srv/{name.title().replace('_', '')}"),
                f"{node.get_name()}/{name}",
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
        found = [self._parameters.get_parameter_or(name) for name in request.names]
        # One unknown name leaves the answer empty, as in rclpy.
        if not any(each.type_ is Parameter.Type.NOT_SET for each in found):
            response.values = [each.get_parameter_value() for each in found]
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
        response.results = [self._set_together([each]) for each in request.parameters]
        return response

    def _set_atomically(self, request: Anything, response: Anything) -> Anything:
        response.result = self._set_together(request.parameters)
        return response

    def _set_together(self, messages: Sequence[Anything]) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetParametersResult")
        parameters = [Parameter.from_parameter_msg(each) for each in messages]
        try:
            return self._parameters.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException as error:
            return made(successful=False, reason=str(error))


class LoggingService:
    """Creates a node's services for log levels.

    Args:
        node: The node that offers the services.
    """

    def __init__(self, node: Anything) -> None:
        name = node.get_name()
        for kind, callback in (("Get", self._get), ("Set", self._set)):
            node.create_service(
                interface_class(f"rcl_interfaces/srv/{kind}LoggerLevels"),
                f"{name}/{kind.lower()}_logger_levels",
                callback,
            )

    def _get(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/LoggerLevel")
        for name in request.names:
            response.levels.append(made(name=name, level=logger_named(name).level))
        return response

    def _set(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetLoggerLevelsResult")
        for wanted in request.levels:
            try:
                logger_named(wanted.name).setLevel(LoggingSeverity(wanted.level))
            except ValueError:
                result = made(successful=False, reason="Failed reason: Invalid logger level.")
            else:
                result = made(successful=True)
            response.results.append(result)
        return response


def declares_type_descriptions(node: Anything) -> bool:
    """Declare the parameter that switches ``~/get_type_description`` on, and return its value."""
    name = START_TYPE_DESCRIPTION_SERVICE_PARAM
    if not node.has_parameter(name):
        descriptor = interface_class("rcl_interfaces/msg/ParameterDescriptor")(
            description="Whether to offer get_type_description.", read_only=True
        )
        node.declare_parameter(name, True, descriptor)
    return node.get_parameter(name).value is True
