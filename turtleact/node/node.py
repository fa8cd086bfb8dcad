"""A node: one participant of a graph, with its topics, services and actions.

The one place where the layers below are put together for a user. Everything that is opened on a
node is closed with it.

Source: rclpy ``node.py`` for names and meaning.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import TypeVar, Unpack, cast

from turtleact.body import ActionBody, ActionDeclaration, ActionType, ServerOptions
from turtleact.client import ActionClient
from turtleact.client.client_endpoints import ClientEndpoints
from turtleact.clock import Clock, check_timeout
from turtleact.errors import TurtleactError
from turtleact.graph import Graph, graph_of
from turtleact.interfaces import Action, Message, Service, WireFormat
from turtleact.names import ActionNames, action_names, resolve_name, validate_node_name
from turtleact.node.belongings import Belongings
from turtleact.server import ActionServer, ServerGoalHandle
from turtleact.server.claim import Claim
from turtleact.server.endpoints import ActionEndpoints
from turtleact.server.hooks import Transition
from turtleact.services import ServiceClient, ServiceServer, ServiceType
from turtleact.slot import Rules, Slot, Slots
from turtleact.tasks import current_tasks
from turtleact.topics import Matching, Publisher, Subscription
from turtleact.transports import MemoryTransport, QoS, Transport
from turtleact.transports.base import Endpoint, EndpointKind

__all__ = ["Node", "open_node"]

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)
M = TypeVar("M", bound=Message)
Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)


class Node:
    """One participant; made by `open_node`.

    Whatever opens something raises `TurtleactError` once the node is closed, and TypeError if what
    it is given is no interface of the kind. With ``on_demand``,
    other processes are told of it only once one of them has an endpoint of its name: for things by
    the thousand, few of which are ever used.

    Attributes:
        name: Its name.
        namespace: What its relative names begin with.
        clock: The time of its graph: what a body that waits should wait by.
        transport: How it talks with others.
    """

    def __init__(self, name: str, namespace: str, transport: Transport) -> None:
        validate_node_name(name)
        self.name = name
        self.namespace = resolve_name(namespace) if namespace != "/" else "/"
        self.clock: Clock = transport.clock
        self.transport = transport
        self._tasks = current_tasks()
        self._belongings = Belongings()
        self._slots = Slots[Claim]()
        self._hooks: list[Transition] = []
        self._membership = transport.enter(self.fully_qualified_name)

    @property
    def fully_qualified_name(self) -> str:
        """The namespace and the name."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def is_open(self) -> bool:
        """Whether something can be opened on it."""
        return self._belongings.is_open

    def serve(
        self,
        definition: ActionDeclaration[..., object],
        *,
        name: str | None = None,
        **overrides: Unpack[ServerOptions],
    ) -> ActionServer[Message, Message, Message]:
        """Serve an action that was declared with `turtleact.action`.

        Args:
            definition: The declared body.
            name: Another name than the declared one.
            **overrides: Other options than the declared ones; as for `action_server`.
        """
        if not isinstance(definition, ActionDeclaration):
            raise TypeError(f"{_named(definition)} is no action: declare it by @turtleact.action")
        options = cast("ServerOptions", {**definition.options, **overrides})
        execute = cast("ActionBody[Message, Message, Message, object]", definition.execute)
        return self.action_server(
            definition.action_type, name or definition.name, execute, **options
        )

    def action_server(
        self,
        action_type: ActionType[G, R, F],
        name: str,
        execute: ActionBody[G, F, R, ServerGoalHandle[G, R, F]],
        *,
        on_demand: bool = False,
        **options: Unpack[ServerOptions],
    ) -> ActionServer[G, R, F]:
        """Serve an action.

        Args:
            action_type: The action, a subclass of `turtleact.Action`.
            name: The action's name; a relative one is put below the node's namespace.
            execute: The body: an async generator or a coroutine function, which takes the goal
                and, if it wants, the `ServerGoalHandle`.
            on_demand: See `Node`.
            **options: ``goal_callback(goal)`` answers a `GoalResponse` or raises
                `turtleact.Reject`; ``cancel_callback(handle)`` answers a `CancelResponse`; both may
                be coroutine functions. ``policy`` says what becomes of a goal while another runs:
                "parallel", "reject", "queue" or "preempt"; under "parallel" at most ``max_active``
                run and the others wait; at most ``queue_limit`` wait. Servers of this node that
                are given the same ``slot`` share one policy and one place. ``result_timeout`` is
                how long a result is kept from the goal's end (s, 10 unless given; None keeps it
                for ever). ``on_client_lost`` is "keep", or "cancel" to cancel the goals of a client
                that is closed.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
            InvalidBody: if the function cannot be a body.
            InvalidOption: if an option has a value that it cannot have.
            TypeError: if there is no such option.
        """
        _expect(Action, action_type)
        for unknown in options.keys() - ServerOptions.__annotations__.keys():
            raise TypeError(f"an action server has no option '{unknown}'")
        names = self._action_names(name)
        server = ActionServer(
            self,
            action_type,
            names.name,
            execute,
            tasks=self._tasks,
            place=self._place(options),
            **options,
        )
        for hook in self._hooks:
            server.hooks.add(hook)
        endpoint = partial(self._endpoint, on_demand=on_demand)
        endpoints = ActionEndpoints(server, names, self.transport, endpoint, self._tasks)
        server.endpoints = endpoints
        server.registration = self._belongings.add(server, endpoints)
        return server

    def on_transition(self, hook: Transition) -> None:
        """Have ``hook(goal, old, new)`` called at each change of a goal served on this node.

        From now on, in the order of the changes, in the event loop; a goal comes from UNKNOWN. One
        hook for logs, metrics, journals and tests. What it raises is logged and does no harm.

        Args:
            hook: Takes the goal's `ServerGoalHandle` and two `GoalStatus`.
        """
        self._hooks.append(hook)
        for server in self._belongings.servers(ActionServer):
            server.hooks.add(hook)

    def action_client(
        self, action_type: ActionType[G, R, F], name: str, *, cancel_timeout: float | None = 6.0
    ) -> ActionClient[G, R, F]:
        """Open a client of an action; it need not be served yet.

        Args:
            action_type: The action, a subclass of `turtleact.Action`.
            name: The action's name; a relative one is put below the node's namespace.
            cancel_timeout: When a task that waits for a goal is cancelled, or leaves its block, the
                goal is canceled, and the task waits so long for its end (s, of the event loop's
                time; None for as long as it takes).

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
            InvalidOption: if ``cancel_timeout`` is not a number.
        """
        _expect(Action, action_type)
        check_timeout(cancel_timeout, "cancel_timeout")
        patience = math.inf if cancel_timeout is None else cancel_timeout
        names = self._action_names(name)
        endpoints = ClientEndpoints(self.transport, self._endpoint, names, action_type)
        client: ActionClient[G, R, F] = ActionClient(endpoints, self._tasks, patience)
        client.membership = self._belongings.add(client, endpoints)
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
        """Open the sending end of a topic.

        Args:
            message_type: What is sent.
            topic: The topic's name; a relative one is put below the node's namespace.
            qos: Quality of service; that of `QoS` if left out.
            on_demand: See `Node`; what is latched is there for all at once.
            on_matched: Called when the topic has got its first reader, perhaps before this returns,
                and when the last one has gone. Not for a latched topic.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        _expect(Message, message_type)
        name = resolve_name(topic, self.namespace, self.name)
        end = self._endpoint("publisher", name, message_type.type_name, qos, on_demand=on_demand)
        matching = None if on_matched is None else Matching(on_matched)
        publication = self.transport.advertise(end, WireFormat(message_type), matching)
        publisher = Publisher(name, message_type, publication)
        publisher.membership = self._belongings.add(publisher, publication)
        return publisher

    def subscription(
        self, message_type: type[M], topic: str, qos: QoS | None = None, *, on_demand: bool = False
    ) -> Subscription[M]:
        """Open the receiving end of a topic: an object for ``async for``; as `publisher`.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        _expect(Message, message_type)
        name = resolve_name(topic, self.namespace, self.name)
        end = self._endpoint("subscription", name, message_type.type_name, qos, on_demand=on_demand)
        subscription: Subscription[M] = Subscription(name, end.qos.depth, self._tasks.signal())
        deliver = cast("Callable[[object], None]", subscription.deliver)
        subscribed = self.transport.subscribe(end, WireFormat(message_type), deliver)
        subscription.membership = self._belongings.add(subscription, subscribed)
        return subscription

    def service(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        handler: Callable[[Req], Res | Awaitable[Res]],
        *,
        on_demand: bool = False,
    ) -> ServiceServer[Req, Res]:
        """Serve a service.

        Args:
            service_type: The service, a subclass of `turtleact.Service`.
            name: The service's name; a relative one is put below the node's namespace.
            handler: A function or coroutine function that takes a request and gives the response.
                Each request is handled in a task of its own, several side by side. What it raises
                reaches the caller as `ServiceError`.
            on_demand: See `Node`.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
        """
        _expect(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        server = ServiceServer(service_type, full_name, handler, tasks=self._tasks)
        endpoint = self._endpoint("service", full_name, service_type.type_name, on_demand=on_demand)
        format = WireFormat(cast("type[Service]", service_type))
        registration = self.transport.serve(endpoint, format, server)
        server.registration = self._belongings.add(server, registration)
        return server

    def service_client(
        self, service_type: ServiceType[Req, Res], name: str
    ) -> ServiceClient[Req, Res]:
        """Open a client of a service; it need not be served yet.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
        """
        _expect(Service, service_type)
        full_name = resolve_name(name, self.namespace, self.name)
        endpoint = self._endpoint("client", full_name, service_type.type_name)
        format = WireFormat(cast("type[Service]", service_type), asks=True)
        client = ServiceClient(self.transport, service_type, full_name, tasks=self._tasks)
        client.caller = self.transport.join(endpoint, format)
        client.membership = self._belongings.add(client, client.caller)
        return client

    def count_publishers(self, topic: str) -> int:
        """How many publishers there are of a topic, on all nodes.

        Raises:
            InvalidName: if the topic's name breaks ROS 2's rules.
        """
        name = resolve_name(topic, self.namespace, self.name)
        return sum(endpoint.kind == "publisher" for endpoint in self.transport.endpoints(name))

    def graph(self) -> Graph:
        """What exists on the graph now."""
        return graph_of(self.transport)

    async def aclose(self) -> None:
        """Close everything opened on the node; running goals end ABORTED, "shutdown".

        First the actions, all at once: their bodies have the rest for their clean-up. Then the
        services, then the rest, the newest first. A body or handler must not await this.
        """
        try:
            await self._belongings.aclose()
        finally:
            self._membership.close()

    def _place(self, options: ServerOptions) -> Slot[Claim] | None:
        """The slot that a server with these options uses; None if its goals need none."""
        policy = options.get("policy", "parallel")
        rules = Rules(policy, options.get("max_active"), options.get("queue_limit"))
        return self._slots.find(rules, options.get("slot"))

    def _action_names(self, name: str) -> ActionNames:
        return action_names(resolve_name(name, self.namespace, self.name))

    def _endpoint(
        self,
        kind: EndpointKind,
        name: str,
        type_name: str,
        qos: QoS | None = None,
        *,
        on_demand: bool = False,
    ) -> Endpoint:
        if not self.is_open:
            raise TurtleactError(f"node '{self.fully_qualified_name}' is closed: open another")
        own, qos = self.fully_qualified_name, qos or QoS()
        return Endpoint(kind, name, type_name, own, qos, on_demand=on_demand)


def _expect(kind: type, given: object) -> None:
    if not (isinstance(given, type) and issubclass(given, kind)):
        raise TypeError(f"expected a subclass of turtleact.{kind.__name__}, not {_named(given)}")


def _named(given: object) -> str:
    return getattr(given, "__qualname__", "") or repr(given)


@asynccontextmanager
async def open_node(
    name: str, *, namespace: str = "/", transport: Transport | None = None
) -> AsyncIterator[Node]:
    """A node for the length of a block.

    Args:
        name: The node's name.
        namespace: What its relative names begin with.
        transport: The graph it belongs to; one of its own, inside the process, if left out. Nodes
            that are given the same transport see each other.

    Raises:
        InvalidName: if the name or the namespace breaks ROS 2's rules.
    """
    node = Node(name, namespace, MemoryTransport() if transport is None else transport)
    try:
        yield node
    finally:
        await node.aclose()
