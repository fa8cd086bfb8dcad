"""Parameters of nodes. A parameter has a name, a type and a value."""

from __future__ import annotations

import array
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import ClassVar

from turtleact.node.parameter_rules import KINDS
from turtleact.rclpy.impl.arguments import Arguments, parse_value, read_parameters
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages import interface_class

__all__ = [
    "PARAMETER_SEPARATOR_STRING",
    "Parameter",
    "get_parameter_value",
    "parameter_dict_from_yaml_file",
    "parameter_value_to_python",
]

PARAMETER_SEPARATOR_STRING = "."


class Parameter(Subscriptable):
    """A parameter of a node.

    Args:
        name: The parameter's name.
        type_: The parameter's type. If left out, it is the type of the value.
        value: The parameter's value.

    Raises:
        TypeError: if the type is not a `Parameter.Type`.
        ValueError: if the value does not fit the type.
    """

    class Type(Enum):
        """The types of parameters."""

        NOT_SET = 0
        BOOL = 1
        INTEGER = 2
        DOUBLE = 3
        STRING = 4
        BYTE_ARRAY = 5
        BOOL_ARRAY = 6
        INTEGER_ARRAY = 7
        DOUBLE_ARRAY = 8
        STRING_ARRAY = 9

        @classmethod
        def from_parameter_value(cls, parameter_value: object) -> Parameter.Type:
            """Return the type of a parameter with this value.

            Raises:
                TypeError: if no parameter can have this value.
            """
            if parameter_value is None:
                return cls.NOT_SET
            single = _single(parameter_value)
            if single is not None:
                return cls[single]
            if isinstance(parameter_value, list | tuple | array.array):
                return _array_type(parameter_value)
            raise TypeError(f"The given value is not one of the allowed types '{parameter_value}'.")

        def check(self, parameter_value: object) -> bool:
            """Whether a value is of this type."""
            if self is Parameter.Type.NOT_SET:
                return parameter_value is None
            try:
                found = Parameter.Type.from_parameter_value(parameter_value)
            except TypeError:
                return False
            if isinstance(parameter_value, list | tuple | array.array) and not parameter_value:
                return self.name.endswith("ARRAY")
            return found is self

    NOT_SET: ClassVar[Parameter.Type] = Type.NOT_SET

    @classmethod
    def from_parameter_msg(cls, param_msg: Anything) -> Parameter:
        """Return the parameter that a ``rcl_interfaces.msg.Parameter`` describes."""
        kind = Parameter.Type(param_msg.value.type)
        return cls(param_msg.name, kind, parameter_value_to_python(param_msg.value))

    def __init__(self, name: str, type_: Type | None = None, value: Anything = None) -> None:
        if type_ is None:
            type_ = Parameter.Type.from_parameter_value(value)
        if not isinstance(type_, Parameter.Type):
            raise TypeError(f"type must be an instance of '{Parameter.Type!r}'")
        if not type_.check(value):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self.name = name
        self.type_ = type_
        self.value = value

    def __repr__(self) -> str:
        return f"Parameter(name={self.name!r}, type={self.type_}, value={self.value!r})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Parameter):
            return NotImplemented
        return vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((self.name, self.type_))

    def get_parameter_value(self) -> Anything:
        """Return the parameter's value as a ``rcl_interfaces.msg.ParameterValue``."""
        made: Anything = interface_class("rcl_interfaces/msg/ParameterValue")
        message = made(type=self.type_.value)
        field = KINDS[self.type_.value].field
        if field:
            setattr(message, field, self.value)
        return message

    def to_parameter_msg(self) -> Anything:
        """Return the parameter as a ``rcl_interfaces.msg.Parameter``."""
        made: Anything = interface_class("rcl_interfaces/msg/Parameter")
        return made(name=self.name, value=self.get_parameter_value())


def _single(value: object) -> str | None:
    """Return the name of the type of a value that is not a list; None if no type fits."""
    kinds = ((bool, "BOOL"), (int, "INTEGER"), (float, "DOUBLE"), (str, "STRING"))
    return next((name for kind, name in kinds if isinstance(value, kind)), None)


def _array_type(values: Sequence[object]) -> Parameter.Type:
    """Return the type of a list. An empty list has the type BYTE_ARRAY.

    Raises:
        TypeError: if the elements are of different types, or of a type that no parameter can have.
    """
    if all(isinstance(each, bytes) for each in values):
        return Parameter.Type.BYTE_ARRAY
    found = {_single(each) for each in values}
    if len(found) == 1 and (kind := found.pop()) is not None:
        return Parameter.Type[f"{kind}_ARRAY"]
    raise TypeError(f"The given value is not one of the allowed types '{values!r}'.")


def get_parameter_value(string_value: str) -> Anything:
    """Parse a text as YAML, and return the value as a ``rcl_interfaces.msg.ParameterValue``."""
    value = parse_value(string_value)
    try:
        return Parameter("", value=value).get_parameter_value()
    except TypeError:
        return Parameter("", value=string_value).get_parameter_value()


def parameter_value_to_python(parameter_value: Anything) -> Anything:
    """Return the Python value of a ``rcl_interfaces.msg.ParameterValue``.

    Raises:
        RuntimeError: if the message has an unknown type.
    """
    kind = parameter_value.type
    if kind not in range(len(KINDS)):
        raise RuntimeError(f"unexpected parameter type {kind}")
    field = KINDS[kind].field
    if not field:
        return None
    value = getattr(parameter_value, field)
    return list(value) if field.endswith("array_value") else value


def parameter_dict_from_yaml_file(
    parameter_file: str,
    use_wildcard: bool = False,  # rclpy's signature
    target_nodes: Sequence[str] | None = None,
    namespace: str = "",
) -> dict[str, Anything]:
    """Read the parameters in a YAML file. Return a dict from names to parameter messages.

    Args:
        parameter_file: The path of the file.
        use_wildcard: Whether the file's parameters for ``/**`` apply to the target nodes.
        target_nodes: The full names of the nodes whose parameters to return. None means all nodes
            in the file.
        namespace: A prefix for the name of each parameter, with a dot at the end: ``"robot."``.

    Raises:
        RuntimeError: if the file has no parameters for one of the target nodes.
    """
    rules = read_parameters(Path(parameter_file))
    wanted = [rule for rule in rules if use_wildcard or rule.pattern != "/**"]
    found: dict[str, object] = {}
    for node in target_nodes or ():
        values = Arguments(parameters=tuple(wanted)).parameters_for(f"/{node.removeprefix('/')}")
        if not values:
            raise RuntimeError(f"Param file does not contain any valid parameters for {node}")
        found |= values
    if not target_nodes:
        found = {name: value for rule in rules for name, value in rule.values.items()}
    return {
        f"{namespace}{name}": Parameter(f"{namespace}{name}", value=value).to_parameter_msg()
        for name, value in found.items()
    }
