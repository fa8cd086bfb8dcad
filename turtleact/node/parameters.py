"""Serves the parameters of a node on the graph: six services, and an event for each change.

The services appear when the first parameter is declared, so a node without parameters costs
nothing. The services give the same answers as in rclcpp, with the same texts. For example, if one
of several requested parameters is not declared, the answer is an empty list.

Source: rclcpp 28.1 (ROS 2 Jazzy), ``parameter_service.cpp`` and ``node_parameters.cpp``.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar, cast

from turtleact.errors import InvalidParameter, TurtleactError, summary, text_of
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.definition import did_you_mean
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    ListParametersResult,
    ParameterEvent,
    ParameterValue,
    SetParametersResult,
)
from turtleact.interfaces.standard.rcl_interfaces.msg import Parameter as ParameterMessage
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from turtleact.node.parameter_rules import (
    ParameterDeclaration,
    Value,
    is_listed,
    message_of,
    misfit,
    out_of_range,
    parameter,
    value_of,
)
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.node.resources import Resources
    from turtleact.node.services import ServiceType
    from turtleact.node.topics import Publisher
    from turtleact.tasks import LoopGuard, Signal, Tasks
    from turtleact.tasks.clock import Clock

__all__ = ["Changes", "NodeParameters", "Parameter"]

logger = logging.getLogger("turtleact.parameters")

P = TypeVar("P", bound=Value)
M = TypeVar("M", bound=Message)
Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

EVENTS_QOS = QoS(depth=1000)

_REFUSED = "the node refuses this value"
_NO_PARAMETERS = (
    "parameter list cannot be empty, this might be due to pre_set_parameters_callback modifying"
    " the original parameters list."
)


class Host(Protocol):
    """The attributes and methods of a node that its parameters use."""

    clock: Clock
    initial_values: dict[str, object]

    @property
    def fully_qualified_name(self) -> str:
        """The namespace and the name of the node."""

    def publisher(self, message_type: type[M], topic: str, qos: QoS | None = None) -> Publisher[M]:
        """Open a publisher of a topic."""

    def service(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        handler: Callable[[Req], Res | Awaitable[Res]],
    ) -> object:
        """Serve a service."""


class NodeParameters:
    """The parameters of a node, and the services for them, such as ``<node>/get_parameters``.

    Args:
        node: The node.
        resources: Tracks everything that is open on the node.
        home: The event loop of the node.
        tasks: The functions for tasks on the node's event loop.
    """

    def __init__(self, node: Host, resources: Resources, home: LoopGuard, tasks: Tasks) -> None:
        self.resources = resources
        self._node = node
        self._home = home
        self._tasks = tasks
        self._declared: dict[str, Parameter[Any]] = {}
        self._events: Publisher[ParameterEvent] | None = None

    def open(self) -> Publisher[ParameterEvent]:
        """Open the services and the publisher of events, unless they are open already.

        Return the publisher.
        """
        if self._events is not None:
            return self._events
        node = self._node
        node.service(GetParameters, "~/get_parameters", self._get)
        node.service(GetParameterTypes, "~/get_parameter_types", self._get_types)
        node.service(SetParameters, "~/set_parameters", self._set)
        node.service(SetParametersAtomically, "~/set_parameters_atomically", self._set_all)
        node.service(DescribeParameters, "~/describe_parameters", self._describe)
        node.service(ListParameters, "~/list_parameters", self._list)
        self._events = node.publisher(ParameterEvent, "/parameter_events", EVENTS_QOS)
        return self._events

    def get(
        self, name: ParameterDeclaration[P] | str, default: P | None, options: Mapping[str, Any]
    ) -> Parameter[Any]:
        """Declare a parameter, or find a declared one; see `turtleact.Node.parameter`."""
        if isinstance(name, ParameterDeclaration):
            known = self._declared.get(name.name)
            return known if known and known.declaration is name else self._declare(name)
        if default is None:
            return self._find(name)
        return self._declare(parameter(name, default, **options))

    def _declare(self, declaration: ParameterDeclaration[P]) -> Parameter[P]:
        self.check_open()
        self.open()
        name, first = declaration.name, declaration.message
        if name in self._declared:
            raise InvalidParameter(name, "it is declared already: choose another name")
        if name in self._node.initial_values:
            first = message_of(name, self._node.initial_values[name], first.type)
        made = Parameter[P](self, declaration, first, self._tasks.signal())
        made.check(first)
        self._declared[name] = made
        self._tell(new=[ParameterMessage(name, first)])
        return made

    def _find(self, name: str) -> Parameter[Any]:
        if not self._declared:
            raise InvalidParameter(name, "it is not declared, nor is any other on this node")
        if name not in self._declared:
            hint = did_you_mean(str(name), self._declared)
            raise InvalidParameter(name, f"it is not declared{hint}")
        return self._declared[name]

    def remove(self, removed: Parameter[P]) -> None:
        """Remove a declared parameter."""
        self._home.check()
        del self._declared[removed.name]
        if self.resources.is_open:
            self._tell(deleted=[ParameterMessage(removed.name, removed.message)])

    def check_open(self) -> None:
        """Raise an error unless the node is open and belongs to this event loop."""
        self._home.check()
        if not self.resources.is_open:
            name = self._node.fully_qualified_name
            raise TurtleactError(f"node '{name}' is closed: open another")

    # the services

    def _all(self, names: Sequence[str]) -> list[Parameter[Any]]:
        """Return parameters, or an empty list if one of them is not declared."""
        found = [self._declared.get(name) for name in names]
        return [] if None in found else cast("list[Parameter[Any]]", found)

    def _get(self, request: GetParameters.Request) -> GetParameters.Response:
        return GetParameters.Response([each.message for each in self._all(request.names)])

    def _get_types(self, request: GetParameterTypes.Request) -> GetParameterTypes.Response:
        return GetParameterTypes.Response([each.message.type for each in self._all(request.names)])

    def _describe(self, request: DescribeParameters.Request) -> DescribeParameters.Response:
        found = self._all(request.names)
        return DescribeParameters.Response([each.declaration.descriptor for each in found])

    def _list(self, request: ListParameters.Request) -> ListParameters.Response:
        wanted = (request.prefixes, request.depth)
        names = [name for name in sorted(self._declared) if is_listed(name, *wanted)]
        groups = [name.rpartition(".")[0] for name in names if "." in name]
        listed = ListParametersResult(names, list(dict.fromkeys(groups)))
        return ListParameters.Response(listed)

    def _set(self, request: SetParameters.Request) -> SetParameters.Response:
        return SetParameters.Response([self._set_together([each]) for each in request.parameters])

    def _set_all(
        self, request: SetParametersAtomically.Request
    ) -> SetParametersAtomically.Response:
        if all(each.name in self._declared for each in request.parameters):
            result = self._set_together(request.parameters)
        else:
            reason = "One or more parameters were not declared before setting"
            result = SetParametersResult(reason=reason)
        return SetParametersAtomically.Response(result)

    def _set_together(self, parameters: Sequence[ParameterMessage]) -> SetParametersResult:
        """Set all of the parameters, or none if one of them cannot be set."""
        problems = [_NO_PARAMETERS] if not parameters else map(self._problem, parameters)
        if problem := next(filter(None, problems), ""):
            return SetParametersResult(reason=problem)
        self.apply(parameters)
        return SetParametersResult(successful=True)

    def _problem(self, given: ParameterMessage) -> str:
        """Return rclcpp's error text if a parameter cannot be set to a value; otherwise ""."""
        found = self._declared.get(given.name)
        if found is None:
            return f"parameter '{given.name}' cannot be set because it was not declared"
        return misfit(found.declaration.descriptor, given.value) or found.refusal(given.value)

    # changes

    def apply(self, parameters: Sequence[ParameterMessage]) -> None:
        """Set parameters to values that have been checked."""
        # All values are set before anybody hears of one: a hook that reads several parameters sees
        # the new value of each.
        before = [(found, found.message) for found in self._all([each.name for each in parameters])]
        for each in parameters:
            self._declared[each.name].message = each.value
        self._tell(changed=parameters)
        for found, message in before:
            if found.is_declared and found.message != message:  # a hook may undeclare others
                found.notify()

    def _tell(
        self,
        *,
        new: Sequence[ParameterMessage] = (),
        changed: Sequence[ParameterMessage] = (),
        deleted: Sequence[ParameterMessage] = (),
    ) -> None:
        events = self.open()
        # Most of the time nobody listens, and then no event is made.
        if events.has_subscriptions:
            stamp = stamp_of(self._node.clock.now())
            name = self._node.fully_qualified_name
            event = ParameterEvent(stamp, name, list(new), list(changed), list(deleted))
            events.publish(event)


class Parameter(Generic[P]):
    """One parameter of a node. `turtleact.Node.parameter` makes one.

    Attributes:
        name: The parameter's name.
        is_declared: Whether the parameter is still declared. It stays declared when the node
            closes.
        declaration: How the parameter was declared.
        message: The current value, as a message.
    """

    def __init__(
        self,
        parameters: NodeParameters,
        declaration: ParameterDeclaration[P],
        message: ParameterValue,
        changed: Signal,
    ) -> None:
        self.name = declaration.name
        self.is_declared = True
        self.declaration = declaration
        self.message = message
        self._parameters = parameters
        self._changed = changed
        self._count = 0
        self._hooks: list[Callable[[P], object]] = []

    def __repr__(self) -> str:
        return f"<Parameter '{self.name}': {self.value!r}>"

    @property
    def value(self) -> P:
        """The current value. A list is a copy: to change an array, assign a new list.

        After `undeclare`, this is the last value.

        Assigning raises:
            InvalidParameter: if the value is of another kind, out of range or refused by
                ``validate``; if the parameter is read-only or no longer declared.
            TurtleactError: if the node is closed.
        """
        return cast("P", value_of(self.message))

    @value.setter
    def value(self, value: P) -> None:
        if not self.is_declared:
            raise InvalidParameter(self.name, "it is no longer declared")
        self._parameters.check_open()
        descriptor = self.declaration.descriptor
        if descriptor.read_only:
            raise InvalidParameter(self.name, "it is read-only")
        made = message_of(self.name, value, descriptor.type)
        self.check(made)
        self._parameters.apply([ParameterMessage(self.name, made)])

    def check(self, message: ParameterValue) -> None:
        """Raise `InvalidParameter` if a value is out of range, or ``validate`` refuses it."""
        problem = out_of_range(self.declaration.descriptor, message) or self.refusal(message)
        if problem:
            raise InvalidParameter(self.name, problem)

    def refusal(self, message: ParameterValue) -> str:
        """Return why the user's ``validate`` refuses a value; "" if it does not."""
        validate = self.declaration.validate
        try:
            answer = validate is None or validate(cast("P", value_of(message)))
        except (ValueError, TurtleactError) as refusal:
            return text_of(refusal) or _REFUSED
        except Exception as error:
            logger.error("'validate' of parameter '%s' failed", self.name, exc_info=error)
            return f"its 'validate' failed: {summary(error)}"
        return _REFUSED if answer is False else ""

    def on_change(self, hook: Callable[[P], object]) -> None:
        """Call ``hook(value)`` after each change from now on, in the event loop.

        Setting a parameter to the value that it already has does not count as a change. An
        exception that the hook raises is logged and has no other effect.
        """
        self._parameters.check_open()
        self._hooks.append(hook)

    def changes(self) -> Changes[P]:
        """Return an async iterator over the values that the parameter gets from now on.

        A reader that falls behind gets only the newest value. The iterator ends when the node
        closes or the parameter is undeclared.

        Cancelling a read is safe: the next read still gets the newest value.
        """
        self._parameters.check_open()
        return Changes(self, self._count)

    def undeclare(self) -> None:
        """Remove the parameter from its node. A second call does nothing."""
        if self.is_declared:
            self._parameters.remove(self)
            self.is_declared = False
            self._changed.fire()

    def notify(self) -> None:
        """Call the hooks and wake the readers of `changes`, because the parameter has changed."""
        self._count += 1
        self._changed.fire()
        # A copy, because a hook may add another one, which must not hear of this change.
        for hook in list(self._hooks):
            try:
                hook(self.value)
            except Exception as error:
                logger.error("a hook of parameter '%s' failed", self.name, exc_info=error)

    async def wait_for_change(self, count: int) -> int:
        """Wait until the parameter has changed more than ``count`` times in all.

        Return how many times the parameter has changed. Return ``count`` if the node closes, or if
        the parameter is undeclared, before the next change.

        Cancelling: safe.
        """
        resources = self._parameters.resources
        # All three are looked at again after each wait, because closing the node only ends the
        # block of `waiting`, and undeclaring only fires the signal.
        while self._count == count and self.is_declared and resources.is_open:
            with resources.waiting():
                await self._changed.wait()
        return self._count


class Changes(Generic[P]):
    """An async iterator over a parameter's new values. `Parameter.changes` makes one."""

    def __init__(self, parameter: Parameter[P], count: int) -> None:
        self._parameter = parameter
        self._count = count

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> P:
        count = await self._parameter.wait_for_change(self._count)
        if count == self._count:
            raise StopAsyncIteration
        self._count = count
        return self._parameter.value
