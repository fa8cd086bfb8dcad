"""The exceptions of rclpy."""

from __future__ import annotations

from typing import ClassVar

from turtleact.rclpy.impl.typing import Anything

__all__ = [
    "InvalidHandle",
    "InvalidNamespaceException",
    "InvalidNodeNameException",
    "InvalidParameterException",
    "InvalidParameterTypeException",
    "InvalidParameterValueException",
    "InvalidServiceNameException",
    "InvalidTopicNameException",
    "NameOfKind",
    "NameValidationException",
    "NoTypeSupportImportedException",
    "NotInitializedException",
    "ParameterAlreadyDeclaredException",
    "ParameterException",
    "ParameterImmutableException",
    "ParameterNotDeclaredException",
    "ParameterUninitializedException",
    "RCLError",
    "ROSInterruptException",
    "UnknownROSArgsError",
]


class InvalidHandle(RuntimeError):
    """An object was used after it was destroyed."""


class RCLError(RuntimeError):
    """An operation failed, for example because an argument is malformed."""


class UnknownROSArgsError(RuntimeError):
    """An argument after ``--ros-args`` is unknown."""


class NotInitializedException(Exception):
    """The context has not been initialised, or was shut down."""

    def __init__(self, *args: object) -> None:
        super().__init__("rclpy.init() has not been called", *args)


class NoTypeSupportImportedException(Exception):
    """A class is not a message, service or action of ROS 2."""

    def __init__(self, *args: object) -> None:
        super().__init__("no type support imported", *args)


class ROSInterruptException(Exception):
    """A wait ended early, because its context was shut down."""

    def __init__(self, *args: object) -> None:
        super().__init__("rclpy.shutdown() has been called", *args)


class NameValidationException(Exception):
    """A name breaks the naming rules.

    Attributes:
        name_type: The kind of name, such as "topic name".
        name: The name.
        error_msg: What is wrong with the name.
        invalid_index: The index of the first wrong character.
    """

    def __init__(
        self, name_type: str, name: str, error_msg: str, invalid_index: int, *args: object
    ) -> None:
        text = f"Invalid {name_type}: {error_msg}:\n  '{name}'\n   {' ' * invalid_index}^"
        super().__init__(text, *args)
        self.name_type = name_type
        self.name = name
        self.error_msg = error_msg
        self.invalid_index = invalid_index


class NameOfKind(NameValidationException):
    """The base class of the errors about one kind of name, which the attribute ``KIND`` names."""

    KIND: ClassVar[str]

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        super().__init__(self.KIND, name, error_msg, invalid_index, *args)


class InvalidNamespaceException(NameOfKind):
    """A namespace breaks the naming rules."""

    KIND = "namespace"


class InvalidNodeNameException(NameOfKind):
    """The name of a node breaks the naming rules."""

    KIND = "node name"


class InvalidTopicNameException(NameOfKind):
    """The name of a topic breaks the naming rules."""

    KIND = "topic name"


class InvalidServiceNameException(NameOfKind):
    """The name of a service breaks the naming rules."""

    KIND = "service name"


class ParameterException(Exception):
    """An operation on parameters has failed.

    Args:
        error_msg: Why the operation has failed.
        parameters: The names of the parameters.
    """

    def __init__(
        self, error_msg: str, parameters: str | list[str] | tuple[str, ...], *args: object
    ) -> None:
        names = [parameters] if isinstance(parameters, str) else list(parameters)
        super().__init__(error_msg, names, *args)


class _ParameterProblem(ParameterException):
    TEXT: ClassVar[str]

    def __init__(self, parameters: str | list[str], *args: object) -> None:
        super().__init__(self.TEXT, parameters, *args)


class ParameterNotDeclaredException(_ParameterProblem):
    """A parameter has not been declared."""

    TEXT = "Invalid access to undeclared parameter(s)"


class ParameterAlreadyDeclaredException(_ParameterProblem):
    """A parameter was declared a second time."""

    TEXT = "Parameter(s) already declared"


class InvalidParameterException(_ParameterProblem):
    """The name of a parameter is invalid."""

    TEXT = "Invalid parameter name"


class ParameterUninitializedException(_ParameterProblem):
    """A parameter was declared without a value, and has no value yet."""

    TEXT = "The parameter is not initialized"


class ParameterImmutableException(_ParameterProblem):
    """An operation has tried to change a read-only parameter."""

    TEXT = "Attempted to modify read-only parameter"


class InvalidParameterTypeException(ParameterException):
    """The value of a parameter does not have the declared type."""

    def __init__(self, desired_parameter: Anything, expected_type: str, *args: object) -> None:
        name, value = desired_parameter.name, desired_parameter.value
        super().__init__(
            f"Trying to set parameter '{name}' to '{value}' of type "
            f"'{desired_parameter.type_.name}', expecting type '{expected_type}'",
            name,
            *args,
        )


class InvalidParameterValueException(ParameterException):
    """A descriptor or a callback has refused the value of a parameter."""

    def __init__(self, parameter: str, value: object, reason: str, *args: object) -> None:
        text = f"Invalid parameter value ({value!r}) for parameter. Reason: {reason}"
        super().__init__(text, parameter, *args)
