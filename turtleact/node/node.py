"""Nodes: the participants of a graph, with their topics, services and actions.

This module assembles the layers below for users. Everything opened on a node is closed with it.

Source: rclpy ``node.py`` for names and behaviour.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, Unpack, cast, overload

from turtleact.body import (
    ActionBody,
    ActionDeclaration,
    ActionType,
    Body,
    ServerOptions,
    check_declaration,
    check_option_names,
)
from turtleact.client import ActionClient
from turtleact.client.client_endpoints import ClientEndpoints
from turtleact.clock import Clock, check_timeout
from turtleact.errors import TurtleactError
from turtleact.goal import Goal, GoalStatus
from turtleact.graph import Graph, graph_of
from turtleact.interfaces import Action, Message, Service, WireFormat
from turtleact.names import ActionNames, action_names, resolve_name, validate_node_name
from turtleact.node.conflicts import OnConflict, Rivals, ServedName, check_on_conflict
from turtleact.node.resources import Resources
from turtleact.node.timers import Timer
from turtleact.observers import Hook
from turtleact.server.endpoints import ActionEndpoints
from turtleact.server.execution import Execution, Served
from turtleact.server.goal_handle import GoalHandle
from turtleact.server.local_server import LocalActionServer, SlotRequest, restore_all
from turtleact.services import (
    LocalServiceServer,
    ServiceClient,
    ServiceServer,
    ServiceType,
    service_events,
)
from turtleact.slot import Rules, Slot, Slots
from turtleact.tasks import Home, current_tasks
from turtleact.topics import Matching, Publisher, Subscription
from turtleact.transports import MemoryTransport, QoS, Transport
from turtleact.transports.base import CallObserver, Closeable, Endpoint, EndpointKind
from turtleact.type_descriptions import offer_when_sought

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
    from turtleact.introspection import Introspection
    from turtleact.node.parameters import NodeParameters, Parameter
    from turtleact.parameters import Bounds, ParameterDeclaration, Value

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)
M = TypeVar("M", bound=Message)
V = TypeVar("V", bound="Value")
Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)


class Node:
    """One participant of a graph. `open_node` makes one.

    Methods that open something raise `TurtleactError` if the node is closed, and TypeError if a
    class is no interface of the right kind. With ``on_demand``, other processes learn of an
    endpoint only once one of them has an endpoint of the same name. Use it if you have thousands of
    endpoints that are mostly unused.

    With ``introspection="contents"``, requests and responses are published on the topics
    ``SERVICE/_service_event``, as in ROS 2; with "metadata", their contents are left out. None
    stands for the node's setting. With introspection, calls travel as messages even within a
    process, which is slower.

    Attributes:
        name: The node's name, without the namespace.
        namespace: The prefix of relative names.
        clock: The graph's clock. Bodies should wait with it.
        transport: The connection to other nodes.
        introspection: The introspection of everything that is opened on the node from now on.
        first_values: First values of parameters, by name, which replace the declared ones.
    """

    introspection: Introspection = "off"

    def __init__(self, name: str, namespace: str, transport: Transport) -> None:
        validate_node_name(name)
        self.name = name
        self.namespace = resolve_name(namespace) if namespace != "/" else "/"
        self.clock: Clock = transport.clock
        self.transport = transport
        self._tasks = current_tasks()
        self._home = Home(f"node '{self.fully_qualified_name}'")
        self._resources = Resources(self._home)
        self._slots = Slots[SlotRequest]()
        self._hooks: list[Transition] = []
        self._to_restore: list[LocalActionServer] = []
        self._parameters: NodeParameters | None = None
        self.first_values: dict[str, object] = {}
        self._presence = ExitStack()
        self._presence.callback(transport.enter(self.fully_qualified_name).close)
        self._presence.callback(offer_when_sought(transport, self.fully_qualified_name).close)

    @property
    def fully_qualified_name(self) -> str:
        """The namespace and the name, for example ``/lab/arm``."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def is_open(self) -> bool:
        """Whether the node is open, so that you can open something on it."""
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
            definition: The declared body.
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
            name: The action's name. A relative name is put below the node's namespace.
            execute: The body: an async generator or a coroutine function. It takes the goal and,
                if it has a second parameter, the `ServerGoalHandle`.
            on_demand: See `Node`.
            on_conflict: What to do if another node already serves the name. The node may be in this
                process or, as far as discovery shows, in another. "refuse" raises `ActionConflict`.
                "wait" begins to serve when the other node has gone. "withdraw" is for built-in
                actions: they withdraw while another node serves the name. When that node has gone,
                a new server with the same arguments takes the place of the withdrawn one.
            **options: ``goal_callback(goal)`` returns a `GoalResponse` or raises
                `turtleact.Reject`. ``cancel_callback(handle)`` returns a `CancelResponse`. These
                two callbacks may be coroutine functions. ``policy`` decides what happens to a new
                goal while another runs: "parallel", "reject", "queue" or "preempt". Under
                "parallel", at most ``max_active`` goals run, and the others wait. At most
                ``queue_limit`` goals may wait. Servers of this node with the same ``slot`` apply
                their policy together, like one server. ``result_timeout`` is how long a result is
                kept after the goal's end (s, 10 by default; None keeps it for ever).
                ``on_client_lost`` is "keep", or "cancel" to cancel a client's goals when the client
                closes. When the server closes, a cancelled body has ``grace`` seconds to clean up
                (event loop time, 5 by default). After that, the body is given up. ``journal`` keeps
                the goals on disk (see `turtleact.open_journal`). ``on_restart`` says what to do
                with goals that an earlier process left: "abort" or "resume". ``pausable=True``
                declares that a coroutine body awaits ``handle.checkpoint()``, where the body can be
                paused. ``on_pause(handle)`` and ``on_resume(handle)`` are coroutine functions that
                bring a robot to rest and let it go on. For ``introspection``, see `Node`.

        Raises:
            ActionConflict: if another node serves the name, or this node serves it with the same
                type.
            InvalidName: if the name breaks ROS 2's rules.
            InvalidBody: if the function cannot be a body.
            InvalidOption: if the value of an option is not allowed.
            TypeError: if an option does not exist.
        """
        self._home.check()
        _expect(Action, action_type)
        check_option_names(options)
        check_on_conflict(on_conflict)
        names = self._action_names(name)
        rivals = Rivals(self.transport, names.send_goal, self.fully_qualified_name)
        own_types = self._types_served(names.name)
        if on_conflict == "refuse" or action_type.type_name in own_types:
            rivals.check(names.name, action_type.type_name, own_types)
        served = Served(
            names.name,
            action_type,
            Body(names.name, execute),
            partial(ServerGoalHandle, self),
            self._home.of(f"the goal handle of action '{names.name}'"),
            self.fully_qualified_name,
        )
        local = LocalActionServer(
            served, options, self._tasks, self.clock.now, self._place(options)
        )
        if local.durable is not None:
            local.durable.is_built_in = on_conflict == "withdraw"
        endpoint = partial(self._endpoint, on_demand=on_demand)
        shown = options.get("introspection") or self.introspection
        endpoints = ActionEndpoints(local, names, self.transport, endpoint, self._tasks, shown)
        server: ActionServer[G, R, F] = ActionServer(self, action_type, local, endpoints, rivals)
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
        server._membership = self._resources.add_server(
            "action server", server, endpoints.stop_taking_goals
        )
        return server

    def _restore_soon(self, local: LocalActionServer) -> None:
        """Restore a server's goals on the loop's next turn, with the goals of its siblings."""
        if local.durable is not None:
            # Servers that share a slot must be restored together, in the order in which their goals
            # were accepted. A program opens them one after the other without an await, so on the
            # next turn of the loop all of them are there.
            if not self._to_restore:
                self._tasks.from_anywhere(self._restore)  # on the next turn, even on trio
            self._to_restore.append(local)

    def _restore(self) -> None:
        servers, self._to_restore = self._to_restore, []
        restore_all(servers)

    def on_transition(self, hook: Transition) -> None:
        """Call ``hook(goal, old, new)`` at each change of a goal served on this node.

        The hook is called from now on, in the event loop, in the order of the changes. For a new
        goal, ``old`` is UNKNOWN. If the hook raises an exception, that is logged and has no other
        effect.

        Args:
            hook: Takes the goal's `ServerGoalHandle` and two `GoalStatus`.
        """
        self._home.check()
        self._hooks.append(hook)
        for server in self._servers():
            server._watch(hook)

    def action_client(
        self,
        action_type: ActionType[G, R, F],
        name: str,
        *,
        cancel_timeout: float | None = 6.0,
        introspection: Introspection | None = None,
    ) -> ActionClient[G, R, F]:
        """Open a client of an action. The action need not be served yet.

        Args:
            action_type: The action, a subclass of `turtleact.Action`.
            name: The action's name. A relative name is put below the node's namespace.
            cancel_timeout: A goal is canceled if a task is cancelled while it waits for the goal,
                or if the task leaves the goal's ``async with`` block. The task then waits at most
                this long for the goal's end (s, event loop time; None for no limit).
            introspection: See `Node`.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
            InvalidOption: if the value of an option is not allowed.
        """
        _expect(Action, action_type)
        check_timeout(cancel_timeout, "cancel_timeout")
        patience = math.inf if cancel_timeout is None else cancel_timeout
        names = self._action_names(name)
        shown = introspection or self.introspection
        endpoints = ClientEndpoints(self.transport, self._endpoint, names, action_type, shown)
        return ActionClient(endpoints, self._tasks, self._home, self._resources, patience)

    def publisher(
        self,
        message_type: type[M],
        topic: str,
        qos: QoS | None = None,
        *,
        on_demand: bool = False,
        on_matched: Callable[[], object] | None = None,
    ) -> Publisher[M]:
        """Open the sending end of a topic.

        Args:
            message_type: The type of the messages.
            topic: The topic's name. A relative name is put below the node's namespace.
            qos: Quality of service. If left out, the defaults of `QoS` apply.
            on_demand: See `Node`. Latched topics are visible to every process at once.
            on_matched: Called when the topic gets its first reader and when the last reader has
                left. The first call may come before this method returns. Latched topics cannot have
                it.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        _expect(Message, message_type)
        name = resolve_name(topic, self.namespace, self.name)
        end = self._endpoint("publisher", name, message_type.type_name, qos, on_demand=on_demand)
        matching = None if on_matched is None else Matching(on_matched)
        publication = self.transport.advertise(end, WireFormat(message_type), matching)
        return Publisher(name, message_type, publication, self._resources)

    def subscription(
        self, message_type: type[M], topic: str, qos: QoS | None = None, *, on_demand: bool = False
    ) -> Subscription[M]:
        """Open the receiving end of a topic.

        Read it with ``async for``. For the arguments, see `publisher`.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        _expect(Message, message_type)
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
            name: The service's name. A relative name is put below the node's namespace.
            handler: A function or coroutine function that takes a request and returns the response.
                Each request is handled in its own task, and several tasks run side by side. If the
                handler raises an exception, the caller gets `ServiceError`.
            on_demand: See `Node`.
            introspection: See `Node`.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
        """
        _expect(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        server = LocalServiceServer(service_type, full_name, handler, tasks=self._tasks)
        endpoint = self._endpoint("service", full_name, service_type.type_name, on_demand=on_demand)
        format = WireFormat(cast("type[Service]", service_type))
        with self._events(endpoint, service_type, introspection) as server.observer:
            registration = self.transport.serve(endpoint, format, server)
        return ServiceServer(server, self._resources, registration)

    def service_client(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        *,
        introspection: Introspection | None = None,
    ) -> ServiceClient[Req, Res]:
        """Open a client of a service, which need not be served yet. For arguments, see `service`.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
        """
        _expect(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        endpoint = self._endpoint("client", full_name, service_type.type_name)
        format = WireFormat(cast("type[Service]", service_type), asks=True)
        with self._events(endpoint, service_type, introspection) as observer:
            caller = self.transport.join(endpoint, format)
        caller.observer = observer
        return ServiceClient(
            service_type, full_name, self.transport, caller, self._resources, self._tasks
        )

    def every(self, seconds: float) -> Timer:
        """Make a timer: ``async for tick in node.every(0.5)``; see `Timer`.

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

        The first declaration opens the six parameter services of the node and a publisher on
        ``/parameter_events``, so ``param list`` and programs in ROS 2 see the parameter.

        Args:
            name: The parameter's name; dots group parameters. With a name alone, this finds a
                parameter that was declared before. With a declaration of `turtleact.parameter`,
                this declares the parameter if the node does not have it yet.
            default: The first value. For ``default`` and the options, see `turtleact.parameter`.

        Raises:
            InvalidParameter: if the parameter is declared already; if ``default`` has an
                unsupported type, is out of range or is refused; if you give only the name of an
                undeclared parameter.
            InvalidOption: if ``range`` or ``validate`` is not allowed.
        """
        from turtleact.node.parameters import NodeParameters

        self._home.check()
        if self._parameters is None:
            self._parameters = NodeParameters(self, self._resources, self._home, self._tasks)
        return self._parameters.get(name, default, options)

    def count_publishers(self, topic: str) -> int:
        """Count the publishers of a topic on all nodes.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        name = resolve_name(topic, self.namespace, self.name)
        return sum(endpoint.kind == "publisher" for endpoint in self.transport.endpoints(name))

    def graph(self) -> Graph:
        """Return what exists on the graph now."""
        return graph_of(self.transport)

    async def aclose(self) -> None:
        """Close everything opened on the node. Running goals end ABORTED with reason "shutdown".

        Actions close first, all at once, so that their bodies can still use everything else while
        they clean up. Then services close, then the rest, newest first. A body or handler must not
        await this.
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

    def _place(self, options: ServerOptions) -> Slot[SlotRequest] | None:
        """Return the slot for a server with these options; None if its goals need no slot."""
        policy = options.get("policy", "parallel")
        rules = Rules(policy, options.get("max_active"), options.get("queue_limit"))
        return self._slots.find(rules, options.get("slot"))

    def _servers(self) -> list[ActionServer[Any, Any, Any]]:
        """The action servers of this node, including those that are closing."""
        return cast("list[ActionServer[Any, Any, Any]]", self._resources.action_servers())

    def _types_served(self, action: str) -> set[str]:
        """The types that this node serves under an action name."""
        servers = [each for each in self._servers() if each.name == action and each.is_open]
        return {server.action_type.type_name for server in servers}

    def _action_names(self, name: str) -> ActionNames:
        return action_names(resolve_name(name, self.namespace, self.name))

    @contextmanager
    def _events(
        self, service: Endpoint, service_type: object, introspection: Introspection | None
    ) -> Iterator[CallObserver | None]:
        """Give the publisher of a service's events to the block that opens the service."""
        find_type, shown = (lambda: service_type), introspection or self.introspection
        events = service_events(self.transport, self._endpoint, service, find_type, shown)
        try:
            yield events
        except BaseException:  # else the topic would stay on the graph
            if events is not None:
                events.close()
            raise

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
        own = self.fully_qualified_name
        return Endpoint(kind, name, type_name, own, qos or QoS(), on_demand=on_demand)


class ServerGoalHandle(GoalHandle[G, R, F]):
    """The handle of a goal for the server's bodies, callbacks and hooks.

    Attributes:
        node: The node that serves the goal.
    """

    __slots__ = ("node",)

    def __init__(self, node: Node, execution: Execution, goal: Goal) -> None:
        super().__init__(execution, goal)
        self.node = node


Transition: TypeAlias = Callable[[ServerGoalHandle[Any, Any, Any], GoalStatus, GoalStatus], object]


class ActionServer(Generic[G, R, F]):
    """Serves one action under one name. `Node.action_server` makes one.

    Attributes:
        name: The fully qualified name.
        action_type: The action.
        node: The node that serves it.
    """

    def __init__(
        self,
        node: Node,
        action_type: ActionType[G, R, F],
        local: LocalActionServer,
        endpoints: ActionEndpoints,
        rivals: Rivals,
    ) -> None:
        self.name = local.name
        self.action_type = action_type
        self.node = node
        self._membership: Closeable | None = None
        self._local = local
        self._endpoints = endpoints
        types_served = partial(node._types_served, self.name)
        restore = partial(node._restore_soon, local)
        self._served_name = ServedName(local, endpoints, rivals, types_served, restore)

    @property
    def is_open(self) -> bool:
        """Whether the server accepts goals, or will accept them when the name is free."""
        return self._local.is_open

    @property
    def is_serving(self) -> bool:
        """Whether the server is on the graph under its name.

        This is False while the server waits for another node to give up the name, and after it has
        made way for another node.
        """
        return self._served_name.is_serving

    @property
    def is_idle(self) -> bool:
        """Whether no goal waits or runs, and no request waits for an answer."""
        return self._local.is_idle and not self._endpoints.is_asked

    async def aclose(self, reason: str = "shutdown") -> None:
        """Stop accepting goals, end the existing ones, and leave the graph.

        Running goals end ABORTED. A body that ignores its cancellation for ``grace`` seconds is
        given up, and the log says where it stands. asyncio can abandon the task of such a body.
        trio cannot, so on trio this method keeps waiting. Every waiter gets its answer.

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
        """Wait until the server serves its name. False if it closes or makes way first.

        Cancelling: safe, the server goes on waiting for its name.
        """
        return await self._served_name.wait()

    def _watch(self, hook: Transition) -> None:
        self._local.observers.add(Hook(hook, self._local.execution.make_handle))

    def _take_name(self, on_conflict: OnConflict, again: Callable[[], object]) -> None:
        """Serve the name, now or later. ``again`` opens another server like this one."""

        def replace() -> None:
            if self._membership is not None:
                self._membership.close()
            again()

        self._served_name.take(on_conflict, replace)


@asynccontextmanager
async def open_node(
    name: str, *, namespace: str = "/", transport: Transport | None = None
) -> AsyncIterator[Node]:
    """Open a node for the length of a block.

    On trio, leave the block in the same task that entered it.

    Args:
        name: The node's name.
        namespace: The prefix of relative names.
        transport: The graph that the node joins. If left out, it is a new graph inside the process.
            Nodes with the same transport see each other.

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
    """Return the tracker of everything open on a node, for code that runs beside the node."""
    return node._resources


async def close_withdrawn(node: Node) -> None:
    """Close a node's action servers that have made way for others, so that none comes back."""
    for server in node._servers():
        if not server.is_open:
            await server.aclose()


def local_server_of(server: ActionServer[Any, Any, Any]) -> LocalActionServer:
    """Return the object that holds and runs a server's goals, for code that observes them."""
    return server._local


def _expect(kind: type, given: object) -> None:
    """Raise TypeError unless an object is a subclass of ``kind``."""
    if not (isinstance(given, type) and issubclass(given, kind)):
        named = getattr(given, "__qualname__", "") or repr(given)
        raise TypeError(f"expected a subclass of turtleact.{kind.__name__}, not {named}")
