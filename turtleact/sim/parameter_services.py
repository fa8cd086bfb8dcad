"""The parameters of a node: six services, and an event for each change.

Each parameter is declared once, with a kind of value that it keeps. Answers and their texts match
rclcpp: a service that is asked about several parameters answers with an empty list if one of them
is not declared.

Source: rclcpp 28.1 (ROS 2 Jazzy), ``parameter_service.cpp`` and ``node_parameters.cpp``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.errors import InvalidOption
from turtleact.interfaces import stamp_of
from turtleact.interfaces.standard import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    IntegerRange,
    ListParameters,
    ListParametersResult,
    Parameter,
    ParameterDescriptor,
    ParameterEvent,
    ParameterType,
    ParameterValue,
    SetParameters,
    SetParametersAtomically,
    SetParametersResult,
)
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from turtleact.node import Node

__all__ = ["Parameters"]

EVENTS_QOS = QoS(depth=1000)

KINDS = (
    "not set", "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array",
    "double_array", "string_array",
)  # fmt: skip
"""rclcpp's names for the kinds of values, by the numbers of ``ParameterType``."""


class Parameters:
    """The parameters of a node, served as ``<node>/get_parameters`` and so on.

    Args:
        node: The node; the services stay open as long as it does.
        on_change: Called after each change.
    """

    def __init__(self, node: Node, on_change: Callable[[], None]) -> None:
        self._node = node
        self._on_change = on_change
        self._declared: dict[str, tuple[ParameterDescriptor, ParameterValue]] = {}
        self._events = node.publisher(ParameterEvent, "/parameter_events", EVENTS_QOS)
        node.service(GetParameters, "~/get_parameters", self._get)
        node.service(GetParameterTypes, "~/get_parameter_types", self._get_types)
        node.service(SetParameters, "~/set_parameters", self._set)
        node.service(SetParametersAtomically, "~/set_parameters_atomically", self._set_all)
        node.service(DescribeParameters, "~/describe_parameters", self._describe)
        node.service(ListParameters, "~/list_parameters", self._list)

    def declare(
        self, name: str, value: bool | int, description: str, bounds: tuple[int, int] | None = None
    ) -> None:
        """Declare a parameter.

        Args:
            name: Its name; dots group parameters.
            value: Its first value; later ones must be of the same kind.
            description: What it is for.
            bounds: The least and the greatest whole number it may have.

        Raises:
            InvalidOption: if it is declared already, or is out of its bounds.
        """
        if name in self._declared:
            raise InvalidOption(name, "this parameter is declared already: give another name")
        made = _value(value)
        ranges = [] if bounds is None else [IntegerRange(*bounds, 1)]
        descriptor = ParameterDescriptor(name, made.type, description, integer_range=ranges)
        if problem := _problem(descriptor, made):
            raise InvalidOption(name, problem)
        self._declared[name] = descriptor, made
        self._tell(new=[Parameter(name, made)])

    def __getitem__(self, name: str) -> int:
        """The value of a parameter: a whole number, or a bool."""
        value = self._declared[name][1]
        is_bool = value.type == ParameterType.PARAMETER_BOOL
        return value.bool_value if is_bool else value.integer_value

    # the services

    def _get(self, request: GetParameters.Request) -> GetParameters.Response:
        return GetParameters.Response([value for _, value in self._find(request.names)])

    def _get_types(self, request: GetParameterTypes.Request) -> GetParameterTypes.Response:
        return GetParameterTypes.Response([value.type for _, value in self._find(request.names)])

    def _describe(self, request: DescribeParameters.Request) -> DescribeParameters.Response:
        return DescribeParameters.Response([each for each, _ in self._find(request.names)])

    def _list(self, request: ListParameters.Request) -> ListParameters.Response:
        depth, prefixes = request.depth, request.prefixes
        names = [name for name in sorted(self._declared) if _is_listed(name, prefixes, depth)]
        groups = [name.rpartition(".")[0] for name in names if "." in name]
        found = ListParametersResult(names, list(dict.fromkeys(groups)))
        return ListParameters.Response(found)

    def _set(self, request: SetParameters.Request) -> SetParameters.Response:
        results = []
        for parameter in request.parameters:
            if parameter.name in self._declared:
                results.append(self._set_declared([parameter]))
            else:
                reason = f"parameter '{parameter.name}' cannot be set because it was not declared"
                results.append(SetParametersResult(reason=reason))
        return SetParameters.Response(results)

    def _set_all(
        self, request: SetParametersAtomically.Request
    ) -> SetParametersAtomically.Response:
        if all(parameter.name in self._declared for parameter in request.parameters):
            result = self._set_declared(request.parameters)
        else:
            reason = "One or more parameters were not declared before setting"
            result = SetParametersResult(reason=reason)
        return SetParametersAtomically.Response(result)

    def _set_declared(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Set all of them, or none."""
        # All are checked before any is set: rclcpp sets them atomically, too.
        problem = "" if parameters else _NO_PARAMETERS
        for each in parameters:
            problem = problem or _problem(self._declared[each.name][0], each.value)
        if problem:
            return SetParametersResult(reason=problem)
        for each in parameters:
            self._declared[each.name] = self._declared[each.name][0], each.value
        self._on_change()
        self._tell(changed=parameters)
        return SetParametersResult(successful=True)

    def _find(self, names: Sequence[str]) -> list[tuple[ParameterDescriptor, ParameterValue]]:
        """The declared parameters of these names; none at all if one is not declared."""
        found = [self._declared[name] for name in names if name in self._declared]
        return found if len(found) == len(names) else []

    def _tell(self, *, new: Sequence[Parameter] = (), changed: Sequence[Parameter] = ()) -> None:
        if self._events.has_subscriptions:
            stamp = stamp_of(self._node.clock.now())
            name = self._node.fully_qualified_name
            self._events.publish(ParameterEvent(stamp, name, list(new), list(changed)))


_NO_PARAMETERS = (
    "parameter list cannot be empty, this might be due to pre_set_parameters_callback modifying"
    " the original parameters list."
)


def _value(value: bool | int) -> ParameterValue:
    if isinstance(value, bool):
        return ParameterValue(ParameterType.PARAMETER_BOOL, bool_value=value)
    return ParameterValue(ParameterType.PARAMETER_INTEGER, integer_value=value)


def _problem(descriptor: ParameterDescriptor, value: ParameterValue) -> str:
    """Why a parameter cannot have this value; empty if it can."""
    name = descriptor.name
    if value.type == ParameterType.PARAMETER_NOT_SET:
        return "cannot undeclare a statically typed parameter"
    if value.type != descriptor.type:
        kind = KINDS[value.type] if value.type < len(KINDS) else f"unknown type {value.type}"
        return (
            f"Wrong parameter type, parameter {{{name}}} is of type {{{KINDS[descriptor.type]}}},"
            f" setting it to {{{kind}}} is not allowed."
        )
    for bounds in descriptor.integer_range:
        if not bounds.from_value <= value.integer_value <= bounds.to_value:
            return f"Parameter {{{name}}} doesn't comply with integer range."
    return ""


def _is_listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Whether a parameter was asked for; a depth of 0 means any depth."""
    if not prefixes:
        return depth == 0 or name.count(".") < depth
    for prefix in prefixes:
        rest = name.removeprefix(f"{prefix}.")
        if name == prefix or (rest != name and (depth == 0 or rest.count(".") < depth)):
            return True
    return False
