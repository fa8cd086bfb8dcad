"""Nodes: the participants of a graph, with their topics, services and actions.

Closing a node closes everything that was opened on it.

Source: rclpy ``node.py`` for names and behaviour.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import ExitStack
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, Unpack, cast, overload

from turtleact.errors import TurtleactError
from turtleact.goals.body import (
    ActionBody,
    ActionDeclaration,
    ActionType,
    Body,
    ServerOptions,
    check_declaration,
    check_option_names,
)
from turtleact.goals.client import ActionClient
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.durable import Restoring
from turtleact.goals.observers import Hook
from turtleact.goals.options import PlaceRequest, open_server
from turtleact.goals.policies import Slots
from turtleact.goals.running import GoalHandle
from turtleact.goals.server import LocalActionServer, ServerSpec
from turtleact.goals.server_endpoints import ActionEndpoints
from turtleact.goals.service_server import LocalServiceServer, service_events
from turtleact.goals.state import Goal, GoalStatus
from turtleact.interfaces import Action, Message, Service, WireFormat
from turtleact.interfaces.types import expect_interface
from turtleact.names import (
    DESCRIBE,
    PARAMETER_SERVICES,
    action_names,
    resolve_name,
    validate_node_name,
)
from turtleact.node.conflicts import OnConflict, Rivals, ServedName, check_on_conflict
from turtleact.node.resources import Resources
from turtleact.node.services import ServiceClient, ServiceServer, ServiceType
from turtleact.node.timers import Timer
from turtleact.node.topics import Matching, Publisher, Subscription
from turtleact.tasks import LoopGuard, current_tasks, opening
from turtleact.tasks.clock import Clock, check_timeout
from turtleact.transports import MemoryTransport, QoS, Transport
from turtleact.transports.base import CallObserver, Closeable, Endpoint, EndpointKind
from turtleact.transports.graph import Graph, Kind, graph_of

__all__ = [
    "ActionServer",
    "Node",
    "ServerGoalHandle",
    "Transition",
    "close_withdrawn",
    "local_server_of",
    "open_node",
    "resources_of",
]

if TYPE_CHECKING:  # few nodes have parameters or introspection; the modules import slowly
    from turtleact.goals.service_server import Introspection
    from turtleact.node import untyped as by_name
    from turtleact.node.learning import Learner
    from turtleact.node.parameter_rules import Bounds, ParameterDeclaration, Value
    from turtleact.node.parameters import NodeParameters, Parameter

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)
M = TypeVar("M", bound=Message)
V = TypeVar("V", bound="Value")
Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)


class Node:
    """A participant of a graph. `open_node` makes one.

    Methods that open something raise `TurtleactError` if the node is closed, `InvalidName` if a
    name breaks ROS 2's rules, and TypeError if you pass a wrong class, for example a message class
    as ``action_type``. Relative names are resolved in the node's namespace.

    A client or subscription that is opened with a name alone learns its type from the graph when it
    is first awaited or read; see `turtleact.node.untyped`.

    With ``on_demand=True``, an endpoint stays hidden from other processes until one of them opens
    an endpoint of the same name.

    With ``introspection="contents"``, requests and responses are published on the topics
    ``SERVICE/_service_event``, as in ROS 2. "metadata" leaves out the contents of requests and
    responses. If the argument is None, the node's attribute ``introspection`` decides.

    Attributes:
        name: The node's name, without the namespace.
        namespace: The namespace in which the node resolves relative names.
        clock: The graph's clock. Bodies should wait on this clock.
        transport: The connection to the graph.
        introspection: The default ``introspection`` of everything that is opened from now on.
        initial_values: Values, by parameter name, that replace the defaults of parameters declared
            later.
    """

    introspection: Introspection = "off"

    def __init__(self, name: str, namespace: str, transport: Transport) -> None:
        validate_node_name(name)
        self.name = name
        self.namespace = resolve_name(namespace) if namespace != "/" else "/"
        self.clock: Clock = transport.clock
        self.transport = transport
        self._tasks = current_tasks()
        self._home = LoopGuard(f"node '{self.fully_qualified_name}'")
        self._resources = Resources(self._home)
        self._slots = Slots[PlaceRequest]()
        self._hooks: list[Transition] = []
        self._restoring = Restoring(self._tasks)
        self._servers_of = defaultdict[str, dict[ActionServer[Any, Any, Any], None]](dict)
        self._parameters: NodeParameters | None = None
        self.initial_values: dict[str, object] = {}
        self._presence = ExitStack()
        self._presence.callback(transport.enter(self.fully_qualified_name).close)
        self._offer(DESCRIBE, self._offer_descriptions)
        for service in PARAMETER_SERVICES:
            self._offer(service, self._offer_parameters)

    @property
    def fully_qualified_name(self) -> str:
        """The namespace and the name, for example ``/lab/arm``."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @cached_property
    def learner(self) -> Learner:
        """Learns types from other nodes; see `turtleact.learn_interface`."""
        from turtleact.node.learning import Learner  # few programs need it

        return Learner(self.transport, self.fully_qualified_name)

    @property
    def is_open(self) -> bool:
        """Whether the node is open. On a closed node, you cannot open anything."""
        return self._resources.is_open

    def serve(
        self,
        definition: ActionDeclaration[..., object],
        *,
        name: str | None = None,
        on_conflict: OnConflict = "refuse",
        **overrides: Unpack[ServerOptions],
    ) -> ActionServer[Message, Message, Message]:
        """Serve an action declared with `turtleact.action`.

        Args:
            definition: The body, declared with `turtleact.action`.
            name: The name under which to serve the action, instead of the declared name.
            on_conflict: See `action_server`.
            **overrides: Options that replace the declared options; see `action_server`.
        """
        check_declaration(definition)
        options = cast("ServerOptions", {**definition.options, **overrides})
        execute = cast("ActionBody[Message, Message, Message, object]", definition.execute)
        return self.action_server(
            definition.action_type,
            name or definition.name,
            execute,
            on_conflict=on_conflict,
            **options,
        )

    def action_server(
        self,
        action_type: ActionType[G, R, F],
        name: str,
        execute: ActionBody[G, F, R, ServerGoalHandle[G, R, F]],
        *,
        on_demand: bool = False,
        on_conflict: OnConflict = "refuse",
        **options: Unpack[ServerOptions],
    ) -> ActionServer[G, R, F]:
        """Serve an action.

        Args:
            action_type: The action, a subclass of `turtleact.Action`.
            name: The action's name.
            execute: The body: an async generator function or a coroutine function. It takes the
                goal and, if it has a second parameter, the `ServerGoalHandle`.
            on_demand: See `Node`.
            on_conflict: What to do if another node serves the name. "refuse" raises
                `ActionConflict`. "wait" begins to serve when no other node serves the name.
                "withdraw" is for built-in actions: the server withdraws while another node serves
                the name, and a new one replaces it when the name is free again.
            **options: See `turtleact.goals.body.ServerOptions`.

        Raises:
            ActionConflict: if this node, or with "refuse" another one, serves the name already.
            InvalidBody: if ``execute`` cannot be a body.
            InvalidOption: if the value of an option is not allowed.
        """
        self._home.check()
        expect_interface(Action, action_type)
        check_option_names(options)
        check_on_conflict(on_conflict)
        names = action_names(resolve_name(name, self.namespace, self.name))
        rivals = Rivals(self.transport, names.send_goal, self.fully_qualified_name)
        own_types = self._types_served(names.name)
        if on_conflict == "refuse" or action_type.type_name in own_types:
            rivals.check(names.name, action_type.type_name, own_types)
        spec = ServerSpec(
            names.name,
            action_type,
            Body(names.name, execute),
            partial(ServerGoalHandle, self),
            self._home.of(f"the goal handle of action '{names.name}'"),
            self.fully_qualified_name,
        )
        local, durable = open_server(spec, options, self._tasks, self.clock.now, self._slots)
        if durable is not None:
            durable.is_built_in = on_conflict == "withdraw"
        endpoint = partial(self._endpoint, on_demand=on_demand)
        shown = options.get("introspection") or self.introspection
        endpoints = ActionEndpoints(local, names, self.transport, endpoint, shown)
        server: ActionServer[G, R, F] = ActionServer(
            self, action_type, local, endpoints, rivals, partial(self._restoring.add, durable)
        )
        # Before the server takes its name: from then on goals may come, and hooks hear of all.
        for hook in self._hooks:
            server._watch(hook)
        again = partial(
            self.action_server,
            *(action_type, name, execute),
            on_demand=on_demand,
            on_conflict=on_conflict,
            **options,
        )
        server._take_name(on_conflict, again)
        self._servers_of[names.name][server] = None
        close = partial(self._stop_serving, server)
        server._membership = self._resources.add(server, close, "action server")
        return server

    def on_transition(self, hook: Transition) -> None:
        """Call ``hook(goal, old, new)`` when a goal that this node serves changes its state.

        The hook takes the `ServerGoalHandle`, the old `GoalStatus` (UNKNOWN for a new goal) and the
        new one. It is called in the event loop, and an exception that it raises is logged.
        """
        self._home.check()
        self._hooks.append(hook)
        for server in self._servers():
            server._watch(hook)

    @overload
    def action_client(
        self, action_type: ActionType[G, R, F], name: str, **options: Unpack[by_name.ClientOptions]
    ) -> ActionClient[G, R, F]: ...
    @overload
    def action_client(
        self, action_type: str, **options: Unpack[by_name.ClientOptions]
    ) -> by_name.UntypedActionClient: ...
    def action_client(
        self,
        action_type: Any,  # see the overloads
        name: str | None = None,
        *,
        cancel_timeout: float | None = 6.0,
        introspection: Introspection | None = None,
    ) -> Any:
        """Open a client of an action. The action need not be served yet.

        Args:
            action_type: The action, a subclass of `turtleact.Action`. You may leave it out.
            name: The action's name.
            cancel_timeout: How long a task waits for the end of a goal after canceling the goal (s,
                event loop time; None for no limit). A goal is canceled if its task is cancelled, or
                leaves the goal's ``async with`` block early.
            introspection: See `Node`.

        Raises:
            InvalidOption: if the value of an option is not allowed.
        """
        check_timeout(cancel_timeout, "cancel_timeout")
        if name is None:
            options = {"cancel_timeout": cancel_timeout, "introspection": introspection}
            return self._untyped(action_type, "action", partial(self.action_client, **options))
        expect_interface(Action, action_type)
        patience = math.inf if cancel_timeout is None else cancel_timeout
        names = action_names(resolve_name(name, self.namespace, self.name))
        shown = introspection or self.introspection
        endpoints = ClientEndpoints(self.transport, self._endpoint, names, action_type, shown)
        client: Any = ActionClient(endpoints, self._tasks, self._home, self._resources, patience)
        client.find_difference = lambda: self.learner.difference(names.name, "action", action_type)
        return client

    def publisher(
        self,
        message_type: type[M],
        topic: str,
        qos: QoS | None = None,
        *,
        on_demand: bool = False,
        on_matched: Callable[[], object] | None = None,
    ) -> Publisher[M]:
        """Open a publisher of a topic.

        Args:
            message_type: The class of the messages.
            topic: The topic's name.
            qos: Quality of service.
            on_demand: See `Node`. This argument has no effect on a latched publisher.
            on_matched: Called when the topic gets its first reader, perhaps before this method
                returns, and when the last reader has left. Not for latched topics.
        """
        expect_interface(Message, message_type)
        name = resolve_name(topic, self.namespace, self.name)
        end = self._endpoint("publisher", name, message_type.type_name, qos, on_demand=on_demand)
        matching = None if on_matched is None else Matching(on_matched)
        publication = self.transport.advertise(end, WireFormat(message_type), matching)
        return Publisher(name, message_type, publication, self._resources)

    @overload
    def subscription(
        self, message_type: type[M], topic: str, qos: QoS | None = None, *, on_demand: bool = False
    ) -> Subscription[M]: ...
    @overload
    def subscription(
        self, message_type: str, *, qos: QoS | None = None, on_demand: bool = False
    ) -> by_name.UntypedSubscription: ...
    def subscription(
        self,
        message_type: Any,  # see the overloads
        topic: str | None = None,
        qos: QoS | None = None,
        *,
        on_demand: bool = False,
    ) -> Any:
        """Open a subscription to a topic. Read its messages with ``async for``.

        For the arguments, see `publisher`. You may leave out ``message_type``.
        """
        if topic is None:
            open = partial(self.subscription, qos=qos, on_demand=on_demand)
            return self._untyped(message_type, "topic", open)
        expect_interface(Message, message_type)
        name = resolve_name(topic, self.namespace, self.name)
        end = self._endpoint("subscription", name, message_type.type_name, qos, on_demand=on_demand)
        signal = self._tasks.signal()
        return Subscription(end, message_type, self.transport, self._resources, signal)

    def service(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        handler: Callable[[Req], Res | Awaitable[Res]],
        *,
        on_demand: bool = False,
        introspection: Introspection | None = None,
    ) -> ServiceServer[Req, Res]:
        """Serve a service.

        Args:
            service_type: The service, a subclass of `turtleact.Service`.
            name: The service's name.
            handler: A function or coroutine function that takes a request and returns the response.
                Each request has its own task. If the handler raises, the caller gets
                `ServiceError`.
            on_demand: See `Node`.
            introspection: See `Node`.
        """
        expect_interface(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        server = LocalServiceServer(service_type, full_name, handler, tasks=self._tasks)
        endpoint = self._endpoint("service", full_name, service_type.type_name, on_demand=on_demand)
        format = WireFormat(cast("type[Service]", service_type))
        server.observer = self._events(endpoint, service_type, introspection)
        registration = self.transport.serve(endpoint, format, server)
        return ServiceServer(server, self._resources, registration)

    @overload
    def service_client(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        *,
        introspection: Introspection | None = None,
    ) -> ServiceClient[Req, Res]: ...
    @overload
    def service_client(
        self, service_type: str, *, introspection: Introspection | None = None
    ) -> by_name.UntypedServiceClient: ...
    def service_client(
        self, service_type: Any, name: str | None = None, *, introspection: Any = None
    ) -> Any:
        """Open a client of a service. The service need not be served yet.

        For the arguments, see `service`. You may leave out ``service_type``.
        """
        if name is None:
            open = partial(self.service_client, introspection=introspection)
            return self._untyped(service_type, "service", open)
        expect_interface(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        endpoint = self._endpoint("client", full_name, service_type.type_name)
        format = WireFormat(cast("type[Service]", service_type), asks=True)
        events = self._events(endpoint, service_type, introspection)
        caller = self.transport.join(endpoint, format)
        caller.observer = events
        client = ServiceClient(
            service_type, full_name, self.transport, caller, self._resources, self._tasks
        )
        client.find_difference = lambda: self.learner.difference(full_name, "service", service_type)
        return client

    def every(self, seconds: float) -> Timer:
        """Make a `Timer`. Use it like this: ``async for tick in node.every(0.5)``.

        Args:
            seconds: The time between two ticks (s, by the graph's clock), above zero.

        Raises:
            InvalidOption: if ``seconds`` is not a finite number above zero.
        """
        self._check_open()
        return Timer(seconds, self.clock, self._resources)

    @overload
    def parameter(self, name: ParameterDeclaration[V]) -> Parameter[V]: ...
    @overload
    def parameter(self, name: str) -> Parameter[Any]: ...
    @overload
    def parameter(
        self,
        name: str,
        default: V,
        *,
        description: str = "",
        range: Bounds | None = None,
        read_only: bool = False,
        validate: Callable[[V], object] | None = None,
    ) -> Parameter[V]: ...
    def parameter(
        self, name: ParameterDeclaration[Any] | str, default: Any = None, **options: Any
    ) -> Parameter[Any]:
        """Declare a parameter, or find a declared one.

        The first declaration opens the node's six parameter services.

        Args:
            name: The parameter's name; alone, it finds a declared parameter. A declaration of
                `turtleact.parameter` declares the parameter, unless the node already has it.
            default: The initial value. For ``default`` and the options, see `turtleact.parameter`.

        Raises:
            InvalidParameter: if the parameter is declared already, if ``default`` is not allowed,
                or if you give only the name of an undeclared parameter.
            InvalidOption: if ``range`` or ``validate`` is not allowed.
        """
        self._home.check()
        return self._node_parameters().get(name, default, options)

    def count_publishers(self, topic: str) -> int:
        """Count the publishers of a topic on all nodes of the graph."""
        name = resolve_name(topic, self.namespace, self.name)
        return sum(endpoint.kind == "publisher" for endpoint in self.transport.endpoints(name))

    def graph(self) -> Graph:
        """Return the nodes, topics, services and actions that are on the graph now."""
        return graph_of(self.transport)

    async def aclose(self) -> None:
        """Close everything opened on the node. Running goals end ABORTED with reason "shutdown".

        All action servers close first, and their bodies can use everything else while they clean
        up; then the services, then the rest. A body or handler must not await this method.
        """
        self._home.check()
        try:
            await self._resources.aclose()
        finally:
            self._presence.close()

    def _check_open(self) -> None:
        self._home.check()
        if not self.is_open:
            raise TurtleactError(f"node '{self.fully_qualified_name}' is closed: open another")

    def _servers(self) -> list[ActionServer[Any, Any, Any]]:
        return cast("list[ActionServer[Any, Any, Any]]", self._resources.action_servers())

    def _types_served(self, action: str) -> set[str]:
        """The types of the actions that this node's open servers serve under one name."""
        return {each.action_type.type_name for each in self._servers_of[action] if each.is_open}

    def _stop_serving(self, server: ActionServer[Any, Any, Any]) -> None:
        """Remove a server from the graph. A second call does nothing."""
        server._endpoints.stop_taking_goals()
        self._servers_of[server.name].pop(server, None)

    def _offer(self, service: str, act: Callable[[], object]) -> None:
        """Call ``act`` as soon as another process looks for a service of this node."""
        name = f"{self.fully_qualified_name}/{service}"
        self._presence.callback(self.transport.call_when_sought(name, act).close)

    def _offer_descriptions(self) -> None:
        from turtleact.node.learning import offer_descriptions  # slow to import

        self._presence.callback(offer_descriptions(self.transport, self.fully_qualified_name).close)

    def _offer_parameters(self) -> None:
        if self.is_open:
            self._node_parameters().open()

    def _node_parameters(self) -> NodeParameters:
        from turtleact.node.parameters import NodeParameters  # slow to import, and rarely needed

        if self._parameters is None:
            self._parameters = NodeParameters(self, self._resources, self._home, self._tasks)
        return self._parameters

    def _untyped(self, name: str, kind: Kind, open: Callable[..., Any]) -> Any:  # noqa: ANN401  # see there
        """Return a client or subscription that learns its type, and then calls ``open``."""
        from turtleact.node.untyped import CLASSES  # few programs need it

        self._check_open()
        full_name = resolve_name(name, self.namespace, self.name)
        return CLASSES[kind](kind, full_name, self.learner, self._resources, open)

    def _events(
        self, service: Endpoint, service_type: object, introspection: Introspection | None
    ) -> CallObserver | None:
        """Open a service's event publisher, unless introspection is off."""
        find_type, shown = (lambda: service_type), introspection or self.introspection
        return service_events(self.transport, self._endpoint, service, find_type, shown)

    def _endpoint(
        self,
        kind: EndpointKind,
        name: str,
        type_name: str,
        qos: QoS | None = None,
        *,
        on_demand: bool = False,
    ) -> Endpoint:
        self._check_open()
        if not isinstance(qos, QoS | None):  # rclpy takes a depth alone
            raise TypeError(f"expected a QoS, such as QoS(depth=10), not {qos!r}")
        own = self.fully_qualified_name
        return Endpoint(kind, name, type_name, own, qos or QoS(), on_demand=on_demand)


class ServerGoalHandle(GoalHandle[G, R, F]):
    """The goal handle that a server gives to its bodies, callbacks and hooks.

    Attributes:
        node: The node that serves the goal.
    """

    __slots__ = ("node",)

    def __init__(self, node: Node, server: LocalActionServer, goal: Goal) -> None:
        super().__init__(server, goal)
        self.node = node


Transition: TypeAlias = Callable[[ServerGoalHandle[Any, Any, Any], GoalStatus, GoalStatus], object]


class ActionServer(Generic[G, R, F]):
    """Serves one action under one name. `Node.action_server` makes one.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action, a subclass of `turtleact.Action`.
        node: The node that serves the action.
    """

    def __init__(
        self,
        node: Node,
        action_type: ActionType[G, R, F],
        local: LocalActionServer,
        endpoints: ActionEndpoints,
        rivals: Rivals,
        restore: Callable[[], object],
    ) -> None:
        self.name = local.name
        self.action_type = action_type
        self.node = node
        self._membership: Closeable | None = None
        self._local = local
        self._endpoints = endpoints
        types_served = partial(node._types_served, self.name)
        self._served_name = ServedName(local, endpoints, rivals, types_served, restore)

    @property
    def is_open(self) -> bool:
        """Whether the server accepts goals, or waits for its name before it accepts goals."""
        return self._local.is_open

    @property
    def is_serving(self) -> bool:
        """Whether the server has its name on the graph, neither waiting nor withdrawn."""
        return self._served_name.is_serving

    @property
    def is_idle(self) -> bool:
        """Whether the server has no waiting or running goals and no unanswered requests."""
        return self._local.is_idle and not self._endpoints.is_asked

    async def aclose(self, reason: str = "shutdown") -> None:
        """Stop accepting goals, end the existing goals, and leave the graph.

        Running goals end ABORTED, and waiting clients get the results. With
        ``on_restart="resume"``, running goals continue after a restart, and waiting clients get
        `ServerUnavailable`. If a body ignores its cancellation for ``grace`` seconds, its goal ends
        anyway, and the log names the line at which it waits. asyncio then abandons the body's task;
        trio cannot, so this method waits there.

        Args:
            reason: The reason that clients get for goals that end now.
        """
        self._local.closing_reason = reason
        await self._served_name.aclose()
        if self._membership is not None:
            self._membership.close()
        await self._local.aclose()
        await self._endpoints.aclose()

    async def wait_until_serving(self) -> bool:
        """Wait until the server is on the graph; return False if it closes or withdraws first."""
        return await self._served_name.wait()

    def _watch(self, hook: Transition) -> None:
        self._local.observers.add(Hook(hook, self._local.make_handle))

    def _take_name(self, on_conflict: OnConflict, again: Callable[[], object]) -> None:
        """Serve the action as soon as its name is free. ``again`` replaces a withdrawn server."""

        def replace() -> None:
            if self._membership is not None:
                self._membership.close()
            again()

        self._served_name.take(on_conflict, replace)


@opening
async def open_node(
    name: str, *, namespace: str = "/", transport: Transport | None = None
) -> AsyncIterator[Node]:
    """Open a node for an ``async with`` block, and close the node at the block's end.

    On trio, leave the block in the same task that entered it.

    Args:
        name: The node's name.
        namespace: The namespace in which the node resolves relative names.
        transport: The graph that the node joins; by default, a new one inside the process.

    Raises:
        InvalidName: if the name or the namespace breaks ROS 2's rules.
    """
    node = Node(name, namespace, MemoryTransport() if transport is None else transport)
    with node._tasks.stoppable():  # a body may raise SystemExit; only trio needs this
        try:
            yield node
        finally:
            await node.aclose()


def check_open(node: Node) -> None:
    """Raise `TurtleactError` if a node is closed, or belongs to another event loop."""
    node._check_open()


def resources_of(node: Node) -> Resources:
    """Return the `Resources` of a node, which track everything open on it."""
    return node._resources


async def close_withdrawn(node: Node) -> None:
    """Close a node's withdrawn action servers, so that none of them serves its name again."""
    for server in node._servers():
        if not server.is_open:
            await server.aclose()


def local_server_of(server: ActionServer[Any, Any, Any]) -> LocalActionServer:
    """Return the object that holds and runs a server's goals, for code that observes the goals."""
    return server._local
