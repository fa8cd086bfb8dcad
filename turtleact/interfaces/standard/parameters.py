"""The messages and services of ROS 2 parameters, as classes.

Source: package ``rcl_interfaces`` of ROS 2 Jazzy.
"""

from __future__ import annotations

from typing import ClassVar

from msgspec import field

from turtleact.interfaces.standard import Time
from turtleact.interfaces.types import (
    Message,
    Service,
    bool_,
    bounded,
    byte,
    float64,
    int64,
    string,
    uint8,
    uint64,
)

__all__ = [
    "DescribeParameters",
    "FloatingPointRange",
    "GetParameterTypes",
    "GetParameters",
    "IntegerRange",
    "ListParameters",
    "ListParametersResult",
    "Parameter",
    "ParameterDescriptor",
    "ParameterEvent",
    "ParameterType",
    "ParameterValue",
    "SetParameters",
    "SetParametersAtomically",
    "SetParametersResult",
]


class ParameterType(Message, type_name="rcl_interfaces/msg/ParameterType"):
    """The kinds of values that a parameter may have."""

    PARAMETER_NOT_SET: ClassVar[uint8] = 0
    PARAMETER_BOOL: ClassVar[uint8] = 1
    PARAMETER_INTEGER: ClassVar[uint8] = 2
    PARAMETER_DOUBLE: ClassVar[uint8] = 3
    PARAMETER_STRING: ClassVar[uint8] = 4
    PARAMETER_BYTE_ARRAY: ClassVar[uint8] = 5
    PARAMETER_BOOL_ARRAY: ClassVar[uint8] = 6
    PARAMETER_INTEGER_ARRAY: ClassVar[uint8] = 7
    PARAMETER_DOUBLE_ARRAY: ClassVar[uint8] = 8
    PARAMETER_STRING_ARRAY: ClassVar[uint8] = 9


class ParameterValue(Message, type_name="rcl_interfaces/msg/ParameterValue"):
    """A value: its kind says which of the fields holds it."""

    type: uint8 = 0
    bool_value: bool_ = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: string = ""
    byte_array_value: list[byte] = field(default_factory=list)
    bool_array_value: list[bool_] = field(default_factory=list)
    integer_array_value: list[int64] = field(default_factory=list)
    double_array_value: list[float64] = field(default_factory=list)
    string_array_value: list[string] = field(default_factory=list)


class Parameter(Message, type_name="rcl_interfaces/msg/Parameter"):
    """A name and its value."""

    name: string = ""
    value: ParameterValue = field(default_factory=ParameterValue)


class FloatingPointRange(Message, type_name="rcl_interfaces/msg/FloatingPointRange"):
    """The numbers that are allowed, both ends included; a step of 0 allows all between them."""

    from_value: float64 = 0.0
    to_value: float64 = 0.0
    step: float64 = 0.0


class IntegerRange(Message, type_name="rcl_interfaces/msg/IntegerRange"):
    """The whole numbers that are allowed, both ends included; a step of 0 counts as 1."""

    from_value: int64 = 0
    to_value: int64 = 0
    step: uint64 = 0


class ParameterDescriptor(Message, type_name="rcl_interfaces/msg/ParameterDescriptor"):
    """What a parameter is for, and what it may be."""

    name: string = ""
    type: uint8 = 0
    description: string = ""
    additional_constraints: string = ""
    read_only: bool_ = False
    dynamic_typing: bool_ = False
    floating_point_range: bounded[list[FloatingPointRange], 1] = field(default_factory=list)
    integer_range: bounded[list[IntegerRange], 1] = field(default_factory=list)


class ParameterEvent(Message, type_name="rcl_interfaces/msg/ParameterEvent"):
    """What has become of the parameters of a node."""

    stamp: Time = field(default_factory=Time)
    node: string = ""
    new_parameters: list[Parameter] = field(default_factory=list)
    changed_parameters: list[Parameter] = field(default_factory=list)
    deleted_parameters: list[Parameter] = field(default_factory=list)


class SetParametersResult(Message, type_name="rcl_interfaces/msg/SetParametersResult"):
    """Whether a parameter was set, and why not."""

    successful: bool_ = False
    reason: string = ""


class ListParametersResult(Message, type_name="rcl_interfaces/msg/ListParametersResult"):
    """The parameters found, and what their names begin with, up to the last dot."""

    names: list[string] = field(default_factory=list)
    prefixes: list[string] = field(default_factory=list)


class GetParameters(Service, type_name="rcl_interfaces/srv/GetParameters"):
    """Asks for values."""

    class Request(Message):
        """Of which parameters."""

        names: list[string] = field(default_factory=list)

    class Response(Message):
        """The values in the same order; none at all if one is not declared."""

        values: list[ParameterValue] = field(default_factory=list)


class GetParameterTypes(Service, type_name="rcl_interfaces/srv/GetParameterTypes"):
    """Asks for the kinds of values."""

    class Request(Message):
        """Of which parameters."""

        names: list[string] = field(default_factory=list)

    class Response(Message):
        """The kinds, as in ``ParameterType``; none at all if one is not declared."""

        types: list[uint8] = field(default_factory=list)


class DescribeParameters(Service, type_name="rcl_interfaces/srv/DescribeParameters"):
    """Asks what parameters are for."""

    class Request(Message):
        """Which ones."""

        names: list[string] = field(default_factory=list)

    class Response(Message):
        """The descriptions; none at all if one is not declared."""

        descriptors: list[ParameterDescriptor] = field(default_factory=list)


class ListParameters(Service, type_name="rcl_interfaces/srv/ListParameters"):
    """Asks which parameters there are."""

    class Request(Message):
        """What their names begin with, and how many dots deep to look."""

        DEPTH_RECURSIVE: ClassVar[uint64] = 0

        prefixes: list[string] = field(default_factory=list)
        depth: uint64 = 0

    class Response(Message):
        """What was found."""

        result: ListParametersResult = field(default_factory=ListParametersResult)


class SetParameters(Service, type_name="rcl_interfaces/srv/SetParameters"):
    """Sets parameters, each for itself."""

    class Request(Message):
        """Which ones, to what."""

        parameters: list[Parameter] = field(default_factory=list)

    class Response(Message):
        """What came of each."""

        results: list[SetParametersResult] = field(default_factory=list)


class SetParametersAtomically(Service, type_name="rcl_interfaces/srv/SetParametersAtomically"):
    """Sets all parameters, or none."""

    class Request(Message):
        """Which ones, to what."""

        parameters: list[Parameter] = field(default_factory=list)

    class Response(Message):
        """What came of it."""

        result: SetParametersResult = field(default_factory=SetParametersResult)
