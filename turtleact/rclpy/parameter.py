"""Parameters: their types and values, and reading, setting and hearing of those of other nodes."""

from __future__ import annotations

import array
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeAlias

from turtleact.names import PARAMETER_SERVICES
from turtleact.node.parameter_rules import KINDS
from turtleact.rclpy.impl.arguments import Arguments, parse_value, read_parameters
from turtleact.rclpy.impl.entity import CallbackGroup, wait_until
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_services_default,
)
from turtleact.rclpy.task import Future

__all__ = [
    "PARAMETER_SEPARATOR_STRING",
    "AsyncParameterClient",
    "Parameter",
    "ParameterCallbackHandle",
    "ParameterEventCallbackHandle",
    "ParameterEventHandler",
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
            is_array = isinstance(parameter_value, list | tuple | array.array)
            values: Anything = parameter_value if is_array else [parameter_value]
            if is_array and all(isinstance(each, bytes) for each in values):
                return cls.BYTE_ARRAY  # also for an empty list
            for number, kind in enumerate((bool, int, float, str), start=1):
                if all(isinstance(each, kind) for each in values):
                    return cls(number + cls.BYTE_ARRAY.value if is_array else number)
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
        field = KINDS[self.type_.value].field
        given = {field: self.value} if field else {}
        return interface_class("rcl_interfaces/msg/ParameterValue")(type=self.type_.value, **given)

    def to_parameter_msg(self) -> Anything:
        """Return the parameter as a ``rcl_interfaces.msg.Parameter``."""
        value = self.get_parameter_value()
        return interface_class("rcl_interfaces/msg/Parameter")(name=self.name, value=value)


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


# --- the parameters of other nodes --------------------------------------------------------------

WhenDone: TypeAlias = Callable[[Future], object] | None
"""A function that gets the future of a response when the future is done."""


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
        node: Anything,
        remote_node_name: str,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.remote_node_name = remote_node_name
        self.node = node
        self._clients = {
            name: node.create_client(
                interface_class(f"rcl_interfaces/srv/{name.title().replace('_', '')}"),
                f"{remote_node_name}/{name}",
                qos_profile=qos_profile,
                callback_group=callback_group,
            )
            for name in PARAMETER_SERVICES
        }

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
        callback: WhenDone = None,
    ) -> Future:
        """Request the names of all parameters, or only of those with one of the prefixes."""
        return self._call(
            "list_parameters", callback, prefixes=list(prefixes or ()), depth=depth or 0
        )

    def get_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the values of parameters."""
        return self._call("get_parameters", callback, names=list(names))

    def set_parameters(self, parameters: Sequence[Anything], callback: WhenDone = None) -> Future:
        """Set parameters one by one. Each is a `Parameter` or a message."""
        return self._call("set_parameters", callback, parameters=_messages(parameters))

    def set_parameters_atomically(
        self, parameters: Sequence[Anything], callback: WhenDone = None
    ) -> Future:
        """Set all the given parameters, or none. Each is a `Parameter` or a message."""
        return self._call("set_parameters_atomically", callback, parameters=_messages(parameters))

    def describe_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the descriptors of parameters."""
        return self._call("describe_parameters", callback, names=list(names))

    def get_parameter_types(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Request the types of parameters."""
        return self._call("get_parameter_types", callback, names=list(names))

    def delete_parameters(self, names: Sequence[str], callback: WhenDone = None) -> Future:
        """Ask the node to delete parameters.

        The node deletes a declared parameter only if the parameter has a dynamic type.
        """
        return self.set_parameters([Parameter(name) for name in names], callback)

    def load_parameter_file(
        self, parameter_file: str, use_wildcard: bool = False, callback: WhenDone = None
    ) -> Future:
        """Set the parameters in a file, one by one."""
        loaded = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters(list(loaded.values()), callback)

    def load_parameter_file_atomically(
        self, parameter_file: str, use_wildcard: bool = False, callback: WhenDone = None
    ) -> Future:
        """Set all the parameters in a file, or none."""
        loaded = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters_atomically(list(loaded.values()), callback)

    def on_parameter_event(
        self,
        callback: Callable[[Anything], object],
        qos_profile: QoSProfile = qos_profile_parameter_events,
        *,
        callback_group: CallbackGroup | None = None,
    ) -> Anything:
        """Call ``callback(event)`` when parameters of any node change; return the subscription."""
        return _subscribe(self.node, callback, qos_profile, callback_group)

    def _call(self, service: str, callback: WhenDone, **fields: Anything) -> Future:
        client = self._clients[service]
        future: Future = client.call_async(client.srv_type.Request(**fields))
        if callback is not None:
            future.add_done_callback(callback)
        return future


def _messages(parameters: Sequence[Anything]) -> list[Anything]:
    return [each.to_parameter_msg() if isinstance(each, Parameter) else each for each in parameters]


def _subscribe(
    node: Anything,
    callback: Callable[[Anything], object],
    qos_profile: QoSProfile,
    callback_group: CallbackGroup | None,
) -> Anything:
    return node.create_subscription(
        interface_class("rcl_interfaces/msg/ParameterEvent"),
        "/parameter_events",
        callback,
        qos_profile,
        callback_group=callback_group,
    )


class ParameterCallbackHandle(NamedTuple):
    """A callback for one parameter of one node."""

    parameter_name: str
    node_name: str
    callback: Callable[[Anything], object]


class ParameterEventCallbackHandle(NamedTuple):
    """A callback for all parameter events."""

    callback: Callable[[Anything], object]


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
            self.parameter_callbacks: dict[tuple[str, str], list[ParameterCallbackHandle]] = {}
            self.event_callbacks: list[ParameterEventCallbackHandle] = []

        def event_callback(self, event: Anything) -> None:
            """Call the callbacks for the parameters in an event, then those for all events."""
            # Copies, because a callback may add or remove others.
            for (name, node), handles in list(self.parameter_callbacks.items()):
                found = ParameterEventHandler.get_parameter_from_event(event, name, node)
                for handle in [] if found is None else list(handles):
                    handle.callback(found)
            for each in list(self.event_callbacks):
                each.callback(event)

    def __init__(
        self,
        node: Anything,
        qos_profile: QoSProfile = qos_profile_parameter_events,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.node = node
        self._callbacks = self.Callbacks()
        self.parameter_event_subscription = _subscribe(
            node, self._callbacks.event_callback, qos_profile, callback_group
        )

    def destroy(self) -> None:
        """Close the subscription."""
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
        self._callbacks.parameter_callbacks.setdefault(handle[:2], []).insert(0, handle)
        return handle

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        _remove(self._callbacks.parameter_callbacks.get(handle[:2], []), handle)

    def add_parameter_event_callback(
        self, callback: Callable[[Anything], object]
    ) -> ParameterEventCallbackHandle:
        """Call ``callback(event)`` on every event about parameters of any node."""
        handle = ParameterEventCallbackHandle(callback)
        self._callbacks.event_callbacks.insert(0, handle)
        return handle

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Remove a callback.

        Raises:
            RuntimeError: if the callback is not registered.
        """
        _remove(self._callbacks.event_callbacks, handle)

    def _resolve_path(self, node_path: str = "") -> str:
        """Return the full name of a node; by default, of the node of this handler."""
        if node_path.startswith("/"):
            return node_path
        if not node_path:
            return str(self.node.get_fully_qualified_name())
        return f"{self.node.get_namespace().rstrip('/')}/{node_path}"


def _remove(handles: list[Anything], handle: object) -> None:
    if handle not in handles:
        raise RuntimeError("Callback doesn't exist")
    handles.remove(handle)
