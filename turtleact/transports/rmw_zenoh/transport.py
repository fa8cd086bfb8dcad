"""Connects processes, including ROS 2 nodes, to one graph over Zenoh, as rmw_zenoh does.

Nodes in one process that share a transport exchange objects, as on a `MemoryTransport`. Messages
between processes travel over Zenoh, as bytes that ROS 2 can read.

- Calls into Zenoh may block. A single thread makes all calls into Zenoh, in order.
- Zenoh runs callbacks in its own threads. The callbacks pass the received data to the event loop.
- A process that stops reading can delay senders of reliable topics only once, by at most one
  second. After this delay, Zenoh disconnects the process. The process reconnects by itself when it
  reads again.

Source: rmw_zenoh_cpp, ``docs/design.md``.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from functools import partial
from itertools import count
from time import perf_counter
from typing import TypeVar
from weakref import WeakValueDictionary

import anyio
import anyio.to_thread
import msgspec

from turtleact.errors import TurtleactError
from turtleact.tasks import current_tasks, opening
from turtleact.tasks.clock import Clock, check_timeout
from turtleact.transports.base import (
    EVERY_SERVER,
    Caller,
    Closeable,
    Deliver,
    Endpoint,
    Format,
    Publication,
    ServiceHandler,
    Source,
    Target,
)
from turtleact.transports.memory import MemoryTransport
from turtleact.transports.rmw_zenoh.config import Mode, domain_of, session_config
from turtleact.transports.rmw_zenoh.context import Context, Declaration, Named, Opened
from turtleact.transports.rmw_zenoh.services import Calls, WireCaller, WireService
from turtleact.transports.rmw_zenoh.session import Session
from turtleact.transports.rmw_zenoh.topics import WirePublication, WireSubscription
from turtleact.transports.rmw_zenoh.wire import (
    all_nodes,
    all_tokens,
    data_key,
    domain_of_node,
    endpoint_token,
    gid_of,
    node_token,
)

__all__ = ["ZenohTransport", "open_zenoh"]

T = TypeVar("T")


class ZenohTransport:
    """The transport between processes. `open_zenoh` opens and closes it.

    Attributes:
        clock: The clock of all nodes in this process that use the transport.
        round_trip: How long other processes took to answer the last `explore` (s); 0 at first.
        context: Data that the transport shares with its endpoints. No other code may use the data.
        graph: The nodes and endpoints of other sessions.
        discovery_ends: The time until which clients wait for servers that are not known yet (s,
            event loop time).
    """

    def __init__(
        self, session: Session, domain: int, clock: Clock | None = None, discovery: float = 0.0
    ) -> None:
        near = MemoryTransport(clock)
        self.clock: Clock = near.clock
        self.round_trip = 0.0
        self.discovery_ends = anyio.current_time() + discovery
        self._near = near
        self.context = Context(session, near, current_tasks(), domain)
        self.graph = self.context.graph
        self._numbers: dict[str, int] = {}
        self._services: WeakValueDictionary[tuple[str, str, str], WireService] = (
            WeakValueDictionary()
        )
        self._calls = Calls(self.context.crew)
        self._count = count()  # numbers nodes and endpoints
        self._gone_since: dict[object, set[str]] = {}  # tokens gone during each exploration
        self._awaited: set[anyio.Event] = set()  # set when they end, or at the close
        self.context.send_queue.post(partial(self._watch, session))

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open the sending end of a topic.

        With a ``source``, a new reader of a latched topic gets the messages that the source
        returns, instead of messages passed to `Publication.publish`. Messages to other processes
        wait for a thread that sends them; see `Publication.is_congested`. Messages are encoded only
        while another process reads the topic, or if the topic is latched.

        Raises:
            InvalidInterface: if the message class has no type name.
            TurtleactError: if the transport is closed.
        """
        return WirePublication(self.context, self._name(endpoint, format), format, source)

    def subscribe(
        self,
        endpoint: Endpoint,
        format: Format,
        deliver: Deliver,
        *,
        in_any_thread: bool = False,
        on_gap: Callable[[int], None] | None = None,
    ) -> Closeable:
        """Open the receiving end of a topic. This raises the same errors as `advertise`.

        With ``in_any_thread``, one of Zenoh's threads decodes each message from another process and
        calls ``deliver``. With ``in_any_thread``, ``deliver`` must return quickly, because no other
        message arrives until ``deliver`` has returned.
        """
        named = self._name(endpoint, format)
        return WireSubscription(
            self.context, named, format, deliver, on_gap, in_any_thread=in_any_thread
        )

    def serve(self, endpoint: Endpoint, format: Format, handler: ServiceHandler) -> Closeable:
        """Offer ``handler`` as the server of a service. This raises the same errors as `advertise`.

        An exception of the handler is sent to the client. Clients of ROS 2 log the error.
        """
        self._check_open()
        key = (endpoint.node, endpoint.name, endpoint.type_name)
        service = self._services.get(key)
        if service is None or not service.is_open:
            named = self._name(endpoint, format)
            service = self._services[key] = WireService(self.context, named, format)
        return service.add(handler)

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Show a client of a service on the graph, and return the object that calls the service.

        If a server in this process exists, it gets all requests. A cancelled call ends at once in
        this process, but a server in another process learns of the cancellation only when the
        `Caller` is closed. If a server hangs without dying, the call raises `ServiceTimeout` after
        ten minutes. This method raises the same errors as `advertise`.
        """
        named = self._name(endpoint, format)
        return WireCaller(self.context, named, format, target, self._calls)

    def local(self, name: str, type_name: str) -> tuple[ServiceHandler, ...]:
        """All handlers that serve a service in this process, oldest first."""
        return self._near.local(name, type_name)

    def enter(self, node: str) -> Closeable:
        """Show a node with this fully qualified name on the graph."""
        self._check_open()
        number = self._numbers[node] = next(self._count)
        token = node_token(self.context.domain, self.context.session.zid, number, node)
        return Opened(self.context, self._near.enter(node), Declaration(self.context, token))

    def call_when_sought(self, name: str, act: Callable[[], object]) -> Closeable:
        """Call ``act`` once, as soon as another process has an endpoint with this name."""
        return self.context.demand.call_when_sought(name, act)

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints, this transport's own first.

        With a ``name``, only endpoints of that name.
        """
        return (*self._near.endpoints(name), *self.graph.endpoints(name))

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints opened on this transport. With a ``name``, only endpoints of that name."""
        return self._near.endpoints(name)

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, those of this transport first. A name may occur twice."""
        return (*self._near.nodes(), *self.graph.nodes())

    @property
    def changes(self) -> int:
        """How many times the graph has changed, in this process or in others."""
        return self._near.changes

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint appears or disappears in any process. Cancelling: safe."""
        await self._near.wait_for_change()

    async def flush(self) -> None:
        """Wait until all earlier messages and declarations were passed to Zenoh. Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed before or during the call.
        """
        await self._ask(lambda: None, None)

    async def explore(self) -> None:
        """Ask which nodes and endpoints are on the graph, and wait for the answer.

        Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed before or during the call.
        """
        began, exploration = perf_counter(), object()
        gone = self._gone_since[exploration] = set()
        try:
            key = all_tokens(self.context.domain)
            tokens = await self._ask(lambda: self.context.session.tokens(key), list[str]())
            for token in tokens:
                if token not in gone:  # a node that died meanwhile would otherwise stay for ever
                    self.token_appeared(token)
            self.round_trip = perf_counter() - began
        finally:
            del self._gone_since[exploration]

    async def domains(self) -> tuple[int, ...]:
        """The ROS domains in which other sessions have nodes. Hidden nodes do not count.

        Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed before or during the call.
        """
        tokens = await self._ask(lambda: self.context.session.tokens(all_nodes()), list[str]())
        found = {domain_of_node(token) for token in tokens}
        return tuple(sorted(domain for domain in found if domain is not None))

    async def routers(self) -> dict[str, str]:
        """The ids of the connected routers, each with the router's own description as JSON.

        The description is empty if the router's admin space is off. Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed before or during the call.
        """
        return await self._ask(self.context.session.routers, dict[str, str]())

    async def aclose(self) -> None:
        """Send the waiting messages, then close the session. A second call does nothing.

        Calls under way end with an error, and running handlers are cancelled.
        """
        context = self.context
        if not context.is_open:
            return
        context.is_open = False
        with anyio.CancelScope(shield=True):
            self._calls.end()
            await context.crew.aclose()
            for each in tuple(context.opened):
                each.close()
            await context.send_queue.aclose()
            await anyio.to_thread.run_sync(context.session.close)
        self._near.tell_change()
        for event in self._awaited:  # the send_queue may have ended without setting them
            event.set()

    async def _ask(self, ask: Callable[[], T], otherwise: T) -> T:
        """Call ``ask`` in the thread of the send queue, and return its result.

        If ``ask`` fails, the failure is logged there, and the result is ``otherwise``.
        """
        self._check_open()
        found, answered = otherwise, anyio.Event()

        def work() -> None:
            nonlocal found
            try:
                found = ask()
            finally:
                self.context.tasks.from_anywhere(answered.set)

        self.context.send_queue.post(work)
        self._awaited.add(answered)
        try:
            await answered.wait()
        finally:
            self._awaited.discard(answered)
        self._check_open()
        return found

    # names

    def _name(self, endpoint: Endpoint, format: Format) -> Named:
        """Give an endpoint its type hash, gid, key and token."""
        self._check_open()
        if (node_id := self._numbers.get(endpoint.node)) is None:
            node_id = self._numbers[endpoint.node] = next(self._count)
        hashed = msgspec.structs.replace(endpoint, type_hash=format.type_hash)
        domain, zid = self.context.domain, self.context.session.zid
        token = endpoint_token(domain, zid, node_id, next(self._count), hashed)
        named = msgspec.structs.replace(hashed, gid=gid_of(token))
        return Named(named, data_key(domain, named), token)

    def _check_open(self) -> None:
        if not self.context.is_open:
            raise TurtleactError("the Zenoh transport is closed: open another")

    # other sessions

    def _watch(self, session: Session) -> None:
        """Watch the tokens of other sessions. The thread of the send queue calls this method."""
        receive_queue = self.context.receive_queue
        session.watch_tokens(
            all_tokens(self.context.domain),
            lambda key: receive_queue.push(partial(self.token_appeared, key)),
            lambda key: receive_queue.push(partial(self.token_gone, key)),
        )

    def token_appeared(self, key: str) -> None:
        """Handle a new token of another session."""
        token = self.graph.add(key)
        if token is None:
            return
        if token.endpoint is not None:
            self.context.demand.appeared(token.endpoint.name)
        self._near.tell_change()

    def token_gone(self, key: str) -> None:
        """Handle the disappearance of another session's token."""
        for gone in self._gone_since.values():
            gone.add(key)
        token = self.graph.remove(key)
        if token is None:
            return
        if (endpoint := token.endpoint) is not None:
            if endpoint.kind == "client":
                self._near.client_lost(endpoint.name, endpoint.gid)
            if endpoint.kind == "service":
                self._calls.doubt(endpoint.name)
        self._near.tell_change()


@opening
async def open_zenoh(
    connect: Sequence[str] | None = None,
    *,
    listen: Sequence[str] | None = None,
    mode: Mode = "peer",
    domain: int | None = None,
    config: Mapping[str, object] | str = "",
    clock: Clock | None = None,
    discovery: float = 1.0,
) -> AsyncIterator[ZenohTransport]:
    """Open a transport between processes, which is closed at the end of the ``async with`` block.

    If an endpoint cannot be reached or is already in use, this raises an error within a few
    seconds. A connection that is lost later is restored without an error, even if the router was
    restarted.

    Args:
        connect: The Zenoh endpoints of routers or peers to connect to. All of them must be
            reachable. The default is ``tcp/localhost:7447`` for a peer or client, and none for a
            router.
        listen: The Zenoh endpoints at which other processes can connect to this session. The
            default is a free port of this machine for a peer, ``tcp/127.0.0.1:7447`` for a router,
            and none for a client.
        mode: A ``"peer"`` connects to other peers directly, like a ROS 2 node. A ``"client"``
            communicates only through its router. A ``"router"`` lets the ROS 2 nodes of this
            machine find each other.
        domain: The ROS domain, 0 to 232. The default is the value of ``ROS_DOMAIN_ID``, or 0 if it
            is not set.
        config: Further settings of Zenoh, as a mapping from paths (``"transport/link/tx/lease"``)
            to values, or as the text of a JSON5 file, such as the files that configure rmw_zenoh.
            ``connect`` and ``listen`` replace the endpoints in a file. A mode in the file takes
            precedence over ``mode``.
        clock: The clock of the nodes in this process. The default is wall time.
        discovery: Goals and calls wait for an unknown server until this time after the transport
            was opened (s, event loop time). Later, a goal or call without a server fails at once.

    Raises:
        InvalidOption: if the value of an option is not allowed.
        TurtleactError: if the session cannot connect to an endpoint or cannot listen at one.
    """
    check_timeout(discovery, "discovery", may_be_none=False)
    if domain is None:
        domain = domain_of(os.environ)
    settings = session_config(connect, listen, mode, domain, config)
    with anyio.CancelScope(shield=True):  # bounded; without it nobody would close the session
        session = await anyio.to_thread.run_sync(Session.open, settings)
    transport = ZenohTransport(session, domain, clock, discovery)
    try:
        yield transport
    finally:
        await transport.aclose()
