"""The parameters of a node: their declarations, values, descriptors, callbacks and services.

`set_parameters` sets each parameter on its own. `set_parameters_atomically` sets all parameters or
none. Before checking values, both methods call the pre-set callbacks, which may change the list of
parameters. Then, the descriptors and the on-set callbacks may refuse the values. If all values are
allowed, the values change, the change is published, and the post-set callbacks are called.

Source: the ROS 2 design article "ROS 2 Parameters"; rclpy ``node.py`` for names and texts.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TypeAlias

from turtleact.names import PARAMETER_SERVICES
from turtleact.node.parameter_rules import is_listed, out_of_range
from turtleact.rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.names import validate_parameter_name
from turtleact.rclpy.parameter import (
    PARAMETER_SEPARATOR_STRING,
    Parameter,
    parameter_value_to_python,
)
from turtleact.rclpy.qos import qos_profile_parameters

__all__ = ["NodeParameters", "ParameterService"]

PreCallback: TypeAlias = Callable[[list[Parameter]], list[Parameter]]
OnCallback: TypeAlias = Callable[[list[Parameter]], Anything]
PostCallback: TypeAlias = Callable[[list[Parameter]], object]


def _result(*, successful: bool, reason: str = "") -> Anything:
    return interface_class("rcl_interfaces/msg/SetParametersResult")(
        successful=successful, reason=reason
    )


def _descriptor(**fields: object) -> Anything:
    return interface_class("rcl_interfaces/msg/ParameterDescriptor")(**fields)


class NodeParameters:
    """The part of a node that manages parameters.

    Args:
        overrides: The initial values that the command line, a file or the program gives, by name.
        allow_undeclared: Whether a parameter may be set and read without being declared.
    """

    def _init_parameters(self, overrides: dict[str, Parameter], *, allow_undeclared: bool) -> None:
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, Anything] = {}
        self._parameter_overrides = overrides
        self._allow_undeclared_parameters = allow_undeclared
        self._pre_set_parameters_callbacks: list[PreCallback] = []
        self._on_set_parameters_callbacks: list[OnCallback] = []
        self._post_set_parameters_callbacks: list[PostCallback] = []

    def _publish_event(self, **changes: list[Anything]) -> None:
        """Publish the parameters that are new, changed and deleted."""
        raise NotImplementedError

    # declaring

    def declare_parameter(
        self,
        name: str,
        value: Anything = None,
        descriptor: Anything = None,
        ignore_override: bool = False,  # rclpy's signature
    ) -> Parameter:
        """Declare a parameter, and return it.

        Args:
            name: The name of the parameter.
            value: The parameter's value, unless an override replaces it. Give a `Parameter.Type` to
                declare a parameter without a value.
            descriptor: A ``rcl_interfaces.msg.ParameterDescriptor``.
            ignore_override: Whether to use ``value`` even if there is an override.

        Raises:
            ParameterAlreadyDeclaredException: if the parameter was declared before.
            InvalidParameterException: if the name is empty.
            InvalidParameterValueException: if the descriptor or a callback refuses the value.
            InvalidParameterTypeException: if an override does not have the type of ``value``.
        """
        declaration: tuple[Anything, ...] = (name, value, descriptor)
        if descriptor is None:
            declaration = (name,) if value is None else (name, value)
        return self.declare_parameters("", [declaration], ignore_override)[0]

    def declare_parameters(
        self,
        namespace: str,
        parameters: Sequence[tuple[Anything, ...]],
        ignore_override: bool = False,  # rclpy's signature
    ) -> list[Parameter]:
        """Declare several parameters, and return them; see `declare_parameter`.

        Args:
            namespace: The prefix of each name.
            parameters: Tuples of a name and, optionally, a value and a descriptor.
            ignore_override: Whether to use the given values even if there are overrides.
        """
        declared = [self._declaration(each, namespace, ignore_override) for each in parameters]
        names = [parameter.name for parameter, _ in declared]
        for name in names:
            validate_parameter_name(name)
        known = [name for name in names if name in self._parameters]
        if known:
            raise ParameterAlreadyDeclaredException(known)
        for parameter, descriptor in declared:
            self._declare(parameter, descriptor)
        return [self._parameters[name] for name in names if name in self._parameters]

    def _declaration(
        self, given: tuple[Anything, ...], namespace: str, ignore_override: bool
    ) -> tuple[Parameter, Anything]:
        """Return the parameter that a tuple declares, with its initial value and descriptor."""
        name, value, descriptor = (*given, None, None)[:3]
        if isinstance(value, interface_class("rcl_interfaces/msg/ParameterValue")):
            value = parameter_value_to_python(value)
        full = f"{namespace}{PARAMETER_SEPARATOR_STRING}{name}" if namespace else name
        if len(given) == 1:
            warnings.warn(
                f"parameter '{full}' is declared without a type: give a value, a Parameter.Type, "
                "or a descriptor with dynamic_typing",
                stacklevel=3,
            )
            descriptor = _descriptor(dynamic_typing=True)
        descriptor = _descriptor() if descriptor is None else descriptor
        if not isinstance(descriptor, interface_class("rcl_interfaces/msg/ParameterDescriptor")):
            raise TypeError(f"expected a ParameterDescriptor, not {type(descriptor)}")
        is_typed = isinstance(value, Parameter.Type)
        if descriptor.dynamic_typing and is_typed:
            raise ValueError(
                f"Parameter '{full}' has a descriptor with dynamic_typing, so it can have no type"
            )
        if not descriptor.dynamic_typing:
            kind = value if is_typed else Parameter.Type.from_parameter_value(value)
            if kind is Parameter.Type.NOT_SET:
                raise ValueError(
                    f"Cannot declare a statically typed parameter '{full}' with default value "
                    "of type PARAMETER_NOT_SET"
                )
            descriptor.type = kind.value
        default = None if is_typed else value
        if not ignore_override and full in self._parameter_overrides:
            default = self._parameter_overrides[full].value
        return Parameter(full, value=default), descriptor

    def _declare(self, parameter: Parameter, descriptor: Anything) -> None:
        """Declare a parameter with its initial value, which callbacks may refuse."""
        descriptor.name = parameter.name
        is_empty = parameter.type_ is Parameter.Type.NOT_SET and not descriptor.dynamic_typing
        if is_empty:
            self._parameters[parameter.name] = parameter
            self._descriptors[parameter.name] = descriptor
            return
        if not descriptor.dynamic_typing and parameter.type_.value != descriptor.type:
            raise InvalidParameterTypeException(parameter, Parameter.Type(descriptor.type).name)
        result = self._apply([parameter], {parameter.name: descriptor}, is_declared_now=True)
        if not result.successful:
            raise InvalidParameterValueException(parameter.name, parameter.value, result.reason)

    def undeclare_parameter(self, name: str) -> None:
        """Undeclare a parameter.

        Raises:
            ParameterNotDeclaredException: if the parameter is not declared.
            ParameterImmutableException: if the parameter is read-only.
        """
        if not self.has_parameter(name):
            raise ParameterNotDeclaredException(name)
        if self._descriptors[name].read_only:
            raise ParameterImmutableException(name)
        del self._parameters[name]
        del self._descriptors[name]

    def has_parameter(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return name in self._parameters

    # reading

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter.

        Raises:
            ParameterNotDeclaredException: if the parameter is not declared, and undeclared
                parameters are not allowed.
            ParameterUninitializedException: if the parameter has no value yet.
        """
        found = self._parameters.get(name)
        if found is not None:
            is_empty = found.type_ is Parameter.Type.NOT_SET
            if is_empty and not self._descriptors[name].dynamic_typing:
                raise ParameterUninitializedException(name)
            return found
        if self._allow_undeclared_parameters:
            return Parameter(name, Parameter.Type.NOT_SET, None)
        raise ParameterNotDeclaredException(name)

    def get_parameters(self, names: list[str]) -> list[Parameter]:
        """Return several parameters; see `get_parameter`."""
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """Return a parameter, or the alternative if the parameter is undeclared or has no value."""
        if alternative_value is None:
            alternative_value = Parameter(name, Parameter.Type.NOT_SET)
        if not self.has_parameter(name):
            return alternative_value
        found = self._parameters[name]
        return alternative_value if found.type_ is Parameter.Type.NOT_SET else found

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters below a prefix, keyed by their names without the prefix."""
        start = f"{prefix}{PARAMETER_SEPARATOR_STRING}" if prefix else ""
        return {
            name.removeprefix(start): self.get_parameter_or(name)
            for name in self._parameters
            if name.startswith(start)
        }

    def get_parameter_type(self, name: str) -> Parameter.Type:
        """Return the type of a parameter.

        Raises:
            ParameterNotDeclaredException: if the parameter is not declared, and undeclared
                parameters are not allowed.
        """
        if self.has_parameter(name):
            return self._parameters[name].type_
        if self._allow_undeclared_parameters:
            return Parameter.Type.NOT_SET
        raise ParameterNotDeclaredException(name)

    def get_parameter_types(self, names: list[str]) -> list[Parameter.Type]:
        """Return the types of several parameters; see `get_parameter_type`."""
        return [self.get_parameter_type(name) for name in names]

    def list_parameters(self, prefixes: list[str], depth: int) -> Anything:
        """Return a ``ListParametersResult`` with the names of the parameters below some prefixes.

        Args:
            prefixes: The prefixes. An empty list means all parameters.
            depth: How many parts, separated by dots, a name may have after the prefix; 0 for any
                number.

        Raises:
            TypeError: if the prefixes are one string.
            ValueError: if the depth is negative.
        """
        if isinstance(prefixes, str):
            raise TypeError("the prefixes must be a list of strings")
        if depth < 0:
            raise ValueError("depth must be greater than or equal to zero")
        result = interface_class("rcl_interfaces/msg/ListParametersResult")()
        for name in sorted(self._parameters):
            if is_listed(name, prefixes, depth):
                result.names.append(name)
                above = name.rpartition(PARAMETER_SEPARATOR_STRING)[0]
                if above and above not in result.prefixes:
                    result.prefixes.append(above)
        return result

    # setting

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Anything]:
        """Set parameters one by one, and return a ``SetParametersResult`` for each.

        Raises:
            ParameterNotDeclaredException: if a parameter is not declared, and undeclared parameters
                are not allowed. The parameters that precede it in the list stay set.
        """
        results: list[Anything] = []
        for parameter in parameter_list:
            self._check_declared([parameter])
            results.append(self._set_atomically([parameter]))
        return results

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Anything:
        """Set all parameters or none, and return a ``SetParametersResult``.

        Raises:
            ParameterNotDeclaredException: if a parameter is not declared, and undeclared parameters
                are not allowed. In this case, no parameter is set.
        """
        self._check_declared(parameter_list)
        return self._set_atomically(parameter_list)

    def _check_declared(self, parameters: list[Parameter]) -> None:
        if not all(isinstance(each, Parameter) for each in parameters):
            raise TypeError("parameter must be instance of type 'Parameter'")
        unknown = [each.name for each in parameters if each.name not in self._parameters]
        if unknown and not self._allow_undeclared_parameters:
            raise ParameterNotDeclaredException(unknown)

    def _set_atomically(self, parameters: list[Parameter]) -> Anything:
        for callback in self._pre_set_parameters_callbacks:
            parameters = callback(parameters)
            if not parameters:
                return _result(
                    successful=False,
                    reason="parameter list cannot be empty, this might be due to "
                    "pre_set_parameters_callback modifying the original parameters list.",
                )
            self._check_declared(parameters)
        descriptors = {
            each.name: self._descriptors.get(each.name, _descriptor(dynamic_typing=True))
            for each in parameters
        }
        return self._apply(parameters, descriptors)

    def _apply(
        self,
        parameters: list[Parameter],
        descriptors: dict[str, Anything],
        *,
        is_declared_now: bool = False,
    ) -> Anything:
        """Set parameters if their descriptors and the on-set callbacks allow the values.

        A parameter that is declared now may be read-only, or have no value yet. Otherwise, a
        parameter without a value is deleted.
        """
        for parameter in parameters:
            descriptor = descriptors[parameter.name]
            if descriptor.read_only and not is_declared_now:
                reason = f"Trying to set a read-only parameter: {parameter.name}."
            else:
                reason = _misfit(parameter, descriptor)
            if reason:
                return _result(successful=False, reason=reason)
        for callback in list(self._on_set_parameters_callbacks):
            result = callback(parameters)
            if not result.successful:
                return result
        self._change(parameters, descriptors, is_declared_now=is_declared_now)
        for post in list(self._post_set_parameters_callbacks):
            post(parameters)
        return _result(successful=True)

    def _change(
        self,
        parameters: list[Parameter],
        descriptors: dict[str, Anything],
        *,
        is_declared_now: bool,
    ) -> None:
        """Set parameters, and publish which of them are new, changed and deleted."""
        new: list[Anything] = []
        changed: list[Anything] = []
        deleted: list[Anything] = []
        for parameter in parameters:
            name = parameter.name
            held = self._parameters.get(name)
            if parameter.type_ is Parameter.Type.NOT_SET and not is_declared_now:
                if held is not None:
                    deleted.append(held.to_parameter_msg())
                    del self._parameters[name], self._descriptors[name]
                continue
            had_value = held is not None and held.type_ is not Parameter.Type.NOT_SET
            (changed if had_value else new).append(parameter.to_parameter_msg())
            self._parameters[name] = parameter
            descriptor = self._descriptors[name] = descriptors[name]
            descriptor.name = name
            if descriptor.dynamic_typing:
                descriptor.type = parameter.type_.value
        self._publish_event(
            new_parameters=new, changed_parameters=changed, deleted_parameters=deleted
        )

    # callbacks

    def add_pre_set_parameters_callback(self, callback: PreCallback) -> None:
        """Call ``callback(parameters)`` before parameters are checked.

        The callback returns the list of parameters to set.
        """
        self._pre_set_parameters_callbacks.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: OnCallback) -> None:
        """Call ``callback(parameters)`` before parameters are set.

        The callback returns a ``SetParametersResult``, which may refuse the parameters.
        """
        self._on_set_parameters_callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: PostCallback) -> None:
        """Call ``callback(parameters)`` after parameters were set."""
        self._post_set_parameters_callbacks.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: PreCallback) -> None:
        """Remove a callback. Raises ValueError if the callback is not registered."""
        self._pre_set_parameters_callbacks.remove(callback)

    def remove_on_set_parameters_callback(self, callback: OnCallback) -> None:
        """Remove a callback. Raises ValueError if the callback is not registered."""
        self._on_set_parameters_callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: PostCallback) -> None:
        """Remove a callback. Raises ValueError if the callback is not registered."""
        self._post_set_parameters_callbacks.remove(callback)

    # descriptors

    def describe_parameter(self, name: str) -> Anything:
        """Return the descriptor of a parameter.

        Raises:
            ParameterNotDeclaredException: if the parameter is not declared, and undeclared
                parameters are not allowed.
        """
        if name in self._descriptors:
            return self._descriptors[name]
        if self._allow_undeclared_parameters:
            return _descriptor()
        raise ParameterNotDeclaredException(name)

    def describe_parameters(self, names: list[str]) -> list[Anything]:
        """Return several descriptors; see `describe_parameter`."""
        return [self.describe_parameter(name) for name in names]

    def set_descriptor(
        self, name: str, descriptor: Anything, alternative_value: Anything = None
    ) -> Anything:
        """Replace the descriptor of a parameter, and return the value as a ``ParameterValue``.

        Args:
            name: The name of the parameter.
            descriptor: The new descriptor. Its name is ignored.
            alternative_value: A ``ParameterValue`` to set if the descriptor forbids the present
                value.

        Raises:
            ParameterNotDeclaredException: if the parameter is not declared, and undeclared
                parameters are not allowed.
            ParameterImmutableException: if the parameter is read-only.
            InvalidParameterValueException: if the descriptor forbids both values.
        """
        wanted = self.get_parameter(name)
        if not self.has_parameter(name):
            return wanted.get_parameter_value()
        if self._descriptors[name].read_only:
            raise ParameterImmutableException(name)
        result = self._apply([wanted], {name: descriptor}, is_declared_now=True)
        if not result.successful and alternative_value is not None:
            wanted = Parameter(name, value=parameter_value_to_python(alternative_value))
            result = self._apply([wanted], {name: descriptor}, is_declared_now=True)
        if not result.successful:
            raise InvalidParameterValueException(name, wanted.value, result.reason)
        return wanted.get_parameter_value()


class ParameterService:
    """Creates the six parameter services on a node.

    Args:
        node: The node.
    """

    def __init__(self, node: Anything) -> None:
        self._node = node
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
        for name in request.names:
            try:
                descriptor = self._node.describe_parameter(name)
            except ParameterNotDeclaredException:
                descriptor = _descriptor(name=name)
            response.descriptors.append(descriptor)
        return response

    def _get(self, request: Anything, response: Anything) -> Anything:
        found = [self._node.get_parameter_or(name) for name in request.names]
        # One unknown name leaves the answer empty, as in rclpy.
        if not any(each.type_ is Parameter.Type.NOT_SET for each in found):
            response.values = [each.get_parameter_value() for each in found]
        return response

    def _get_types(self, request: Anything, response: Anything) -> Anything:
        try:
            found = self._node.get_parameter_types(list(request.names))
        except ParameterNotDeclaredException:
            found = []
        response.types = [kind.value for kind in found]
        return response

    def _list(self, request: Anything, response: Anything) -> Anything:
        response.result = self._node.list_parameters(list(request.prefixes), request.depth)
        return response

    def _set(self, request: Anything, response: Anything) -> Anything:
        response.results = [self._set_together([each]) for each in request.parameters]
        return response

    def _set_atomically(self, request: Anything, response: Anything) -> Anything:
        response.result = self._set_together(request.parameters)
        return response

    def _set_together(self, messages: Sequence[Anything]) -> Anything:
        parameters = [Parameter.from_parameter_msg(each) for each in messages]
        try:
            return self._node.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException as error:
            return _result(successful=False, reason=str(error))


def _misfit(parameter: Parameter, descriptor: Anything) -> str:
    """Return rclpy's error text if a descriptor forbids a value; otherwise an empty string."""
    if not descriptor.dynamic_typing and descriptor.type != parameter.type_.value:
        if parameter.type_ is Parameter.Type.NOT_SET:
            return "Static parameter cannot be undeclared"
        return (
            f"Wrong parameter type, expected '{Parameter.Type(descriptor.type)}' "
            f"got '{parameter.type_}'"
        )
    misfit = out_of_range(descriptor, parameter.get_parameter_value())
    return f"Parameter {parameter.name} out of range: {misfit}" if misfit else ""
