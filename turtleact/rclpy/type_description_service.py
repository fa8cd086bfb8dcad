"""Serves ``~/get_type_description``, which describes the types that a node uses."""

from __future__ import annotations

from turtleact.errors import TurtleactError
from turtleact.interfaces import get_interface, interface_source, type_hash
from turtleact.interfaces.type_hash import description, referenced
from turtleact.interfaces.types import Interface
from turtleact.rclpy.impl.node_parameters import NodeParameters
from turtleact.rclpy.impl.typing import Anything, ServiceHost
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.parameter import Parameter

__all__ = ["START_TYPE_DESCRIPTION_SERVICE_PARAM", "TypeDescriptionService"]

START_TYPE_DESCRIPTION_SERVICE_PARAM = "start_type_description_service"

PACKAGE = "type_description_interfaces"


class TypeDescriptionService:
    """Creates ``~/get_type_description`` on a node. The service is destroyed with the node.

    If the node's parameter ``start_type_description_service`` is false, no service is created.

    Args:
        node: The node.
        parameters: The parameters of the node.
    """

    def __init__(self, node: ServiceHost, parameters: NodeParameters) -> None:
        self.service_name = f"{node.get_name()}/get_type_description"
        name = START_TYPE_DESCRIPTION_SERVICE_PARAM
        if not parameters.has_parameter(name):
            descriptor = interface_class("rcl_interfaces/msg/ParameterDescriptor")(
                description=f"Whether to offer {self.service_name}.", read_only=True
            )
            parameters.declare_parameter(name, True, descriptor)
        parameter = parameters.get_parameter(name)
        self.enabled = parameter.type_ is Parameter.Type.BOOL and parameter.value
        if self.enabled:
            node.create_service(
                interface_class(f"{PACKAGE}/srv/GetTypeDescription"),
                self.service_name,
                self._describe,
            )

    def _describe(self, request: Anything, response: Anything) -> Anything:
        try:
            found = get_interface(request.type_name)
            if request.type_hash not in ("", type_hash(found)):
                raise TurtleactError(f"{request.type_name} has another hash here")
        except TurtleactError as error:
            response.failure_reason = str(error)
            return response
        response.successful = True
        others = referenced(found)
        response.type_description = _made(
            "TypeDescription",
            type_description=_individual(found),
            referenced_type_descriptions=[_individual(others[name]) for name in sorted(others)],
        )
        if request.include_type_sources:
            response.type_sources = [_source(each) for each in (found, *others.values())]
        return response


def _made(message: str, **fields: Anything) -> Anything:
    return interface_class(f"{PACKAGE}/msg/{message}")(**fields)


def _individual(interface: Interface) -> Anything:
    said: Anything = description(interface)
    fields = [
        _made("Field", name=each["name"], type=_made("FieldType", **each["type"]))
        for each in said["fields"]
    ]
    return _made("IndividualTypeDescription", type_name=said["type_name"], fields=fields)


def _source(interface: Interface) -> Anything:
    kind = interface.type_name.split("/")[1]
    try:
        text = interface_source(interface.type_name)
    except TurtleactError:  # a type that an action or service implies
        return _made("TypeSource", type_name=interface.type_name, encoding="implicit")
    return _made("TypeSource", type_name=interface.type_name, encoding=kind, raw_file_contents=text)
