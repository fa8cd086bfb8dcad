"""Connects processes, including ROS 2 nodes, to one graph over Zenoh, as rmw_zenoh does.

Nodes in one process that share a transport exchange objects, as on a `MemoryTransport`. Everything
else travels over Zenoh, as bytes that ROS 2 can read.

- Calls into Zenoh may block. One thread makes them all, in order.
- Zenoh calls back in its own threads. The event loop handles what they bring.
- A reader that stops reading delays its reliable topics once, by a second at most. Then Zenoh
  disconnects the reader. The reader reconnects by itself when it reads again.

Source: rmw_zenoh_cpp, ``docs/design.md``.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import partial
from time import perf_counter
from weakref import WeakValueDictionary

import anyio
import anyio.to_thread
import msgspec

from turtleact.clock import Clock, check_timeout
from turtleact.errors import TurtleactError
from turtleact.tasks import current_tasks
from turtleact.transports.base import (
    EVERY_SERVER,
    AsyncHandler,
    Caller,
    CallerAware,
    Closeable,
    Deliver,
    Endpoint,
    Format,
    Publication,
    Source,
    Target,
)
from turtleact.transports.memory import MemoryTransport
from turtleact.transports.rmw_zenoh.config import Mode, domain_of, session_config
from turtleact.transports.rmw_zenoh.context import Context, Named, Opened, Presence, Sought
from turtleact.transports.rmw_zenoh.keys import (
    Graph,
    all_nodes,
    all_tokens,
    data_key,
    domain_of_node,
    endpoint_token,
    gid_of,
    node_token,
)
from turtleact.transports.rmw_zenoh.services import WireCaller, WireService
from turtleact.transports.rmw_zenoh.session import Session
from turtleact.transports.rmw_zenoh.topics import (
    DirectSubscription,
    WirePublication,
    WireSubscription,
)

__all__ = ["ZenohTransport", "open_zenoh"]


class ZenohTransport:
    """The transport between processes. `open_zenoh` opens and closes it.

    Attributes:
        clock: The time of all nodes on the graph in this process.
        round_trip: How long other processes took to answer `explore` (s).
        context: Shared by the endpoints of the transport, for their use only.
        graph: The nodes and endpoints of other sessions.
        discovery_ends: Before this moment, clients wait for a server that has not been seen yet
            (event loop time).
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
        self.graph = Graph(session.zid)
        self._numbers: dict[str, int] = {}
        self._services: WeakValueDictionary[tuple[str, str, str], WireService] = (
            WeakValueDictionary()
        )
        self._count = 0
        self._gone_since: dict[anyio.Event, set[str]] = {}
        self._awaited: set[anyio.Event] = set()  # set by the outbox, or when the transport closes
        self.context.outbox.post(partial(self._watch, session))

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open the sending end of a topic. With a source, only the source's messages are latched.

        A thread sends messages to readers in other processes; see `Publication.is_congested`.
        Messages are encoded only while another process reads the topic, or if it is latched.

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
    ) -> Closeable:
        """Open the receiving end of a topic. The errors are those of `advertise`.

        With ``in_any_thread``, one of Zenoh's threads decodes and delivers messages from other
        processes. ``deliver`` must return quickly, because no other message arrives meanwhile.
        """
        named = self._name(endpoint, format)
        made = DirectSubscription if in_any_thread else WireSubscription
        return made(self.context, named, format, deliver)

    def serve(self, endpoint: Endpoint, format: Format, handler: object) -> Closeable:
        """Offer ``handler`` as the server of a service. The errors are those of `advertise`.

        A request is refused if a request with the same gid and sequence number is under way. A
        handler's exception is sent to the caller. Clients of ROS 2 log it.
        """
        self._check_open()
        is_for_others = isinstance(handler, AsyncHandler)
        key = (endpoint.node, endpoint.name, endpoint.type_name)
        service = self._services.get(key) if is_for_others else None
        if service is None or not service.is_open:
            named = self._name(endpoint, format)
            service = WireService(self.context, named, format, is_for_others=is_for_others)
            if is_for_others:
                self._services[key] = service
        return service.add(handler)

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Show a client of a service on the graph, and return the object to call it with.

        A server in this process is preferred. A cancelled call ends here at once, but a server in
        another process learns of the cancellation only when the caller is closed. If a server hangs
        without dying, the call raises `ServiceTimeout` after ten minutes. The errors of this method
        are those of `advertise`.
        """
        return WireCaller(self.context, self._name(endpoint, format), format, target, self._servers)

    def all_local(self, name: str, type_name: str) -> tuple[object, ...]:
        """All handlers that serve a service in this process."""
        return self._near.all_local(name, type_name)

    def local(self, name: str, type_name: str) -> object | None:
        """The oldest handler that serves a service in this process, or None."""
        return self._near.local(name, type_name)

    def enter(self, node: str) -> Closeable:
        """Show a node with this fully qualified name on the graph."""
        self._check_open()
        number = self._numbers[node] = self._next_number()
        token = node_token(self.context.domain, self.context.session.zid, number, node)
        return Opened(self.context, self._near.enter(node), Presence(self.context, token))

    def open_when_sought(self, name: str, open: Callable[[], Closeable]) -> Closeable:
        """Call ``open`` as soon as another process has an endpoint with this name; see `Lazy`."""
        return Sought(self.context, name, open)

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints on the graph, or only those called ``name``: our own first, then others."""
        return (*self._near.endpoints(name), *self.graph.endpoints(name))

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints opened on this transport, or only those called ``name``."""
        return self._near.endpoints(name)

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, our own first. A name may occur twice."""
        return (*self._near.nodes(), *self.graph.nodes())

    @property
    def changes(self) -> int:
        """How often a node or endpoint has come or gone, here or elsewhere."""
        return self._near.changes

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint comes or goes, here or elsewhere. Cancelling: safe."""
        await self._near.wait_for_change()

    async def flush(self) -> None:
        """Wait until every earlier request has been handed to Zenoh. Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed, now or while this waits.
        """
        self._check_open()
        passed = anyio.Event()
        self.context.outbox.post(lambda: self.context.tasks.from_anywhere(passed.set))
        await self._wait_unless_closed(passed)

    async def explore(self) -> None:
        """Ask which nodes and endpoints are on the graph, and wait for the answer.

        Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed, now or while this waits.
        """
        self._check_open()
        context, found = self.context, anyio.Event()
        gone = self._gone_since[found] = set()
        began = perf_counter()

        def ask() -> None:
            tokens: list[str] = []
            try:
                tokens = context.session.tokens(all_tokens(context.domain))
            finally:
                context.inbox.push(partial(add, tokens))

        def add(tokens: list[str]) -> None:
            for token in tokens:
                if token not in gone:  # a node that died meanwhile would otherwise stay for ever
                    self.token_appeared(token)
            found.set()

        context.outbox.post(ask)
        try:
            await self._wait_unless_closed(found)
            self.round_trip = perf_counter() - began
        finally:
            del self._gone_since[found]

    async def domains(self) -> tuple[int, ...]:
        """The ROS domains in which other sessions have nodes. Hidden nodes do not count.

        Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed, now or while this waits.
        """
        self._check_open()
        context, answered = self.context, anyio.Event()
        found: set[int] = set()

        def ask() -> None:
            try:
                for token in context.session.tokens(all_nodes()):
                    domain = domain_of_node(token)
                    if domain is not None:
                        found.add(domain)
            finally:
                context.tasks.from_anywhere(answered.set)

        context.outbox.post(ask)
        await self._wait_unless_closed(answered)
        return tuple(sorted(found))

    async def routers(self) -> dict[str, str]:
        """The routers in reach, with each router's description of itself as JSON. Cancelling: safe.

        Raises:
            TurtleactError: if the transport is closed, now or while this waits.
        """
        self._check_open()
        context, answered = self.context, anyio.Event()
        found: dict[str, str] = {}

        def ask() -> None:
            try:
                found.update(context.session.routers())
            finally:
                context.tasks.from_anywhere(answered.set)

        context.outbox.post(ask)
        await self._wait_unless_closed(answered)
        return found

    async def aclose(self) -> None:
        """Close the session. Calls under way end, and handlers are cancelled.

        Earlier messages are sent first. A second call does nothing.
        """
        context = self.context
        if not context.is_open:
            return
        context.is_open = False
        with anyio.CancelScope(shield=True):
            opened = tuple(context.opened)
            for each in opened:
                if isinstance(each, WireCaller):
                    each.give_up()
            await context.crew.aclose()
            for each in opened:
                if isinstance(each, WireService):
                    each.give_up()
                each.close()
            await context.outbox.aclose()
            await anyio.to_thread.run_sync(context.session.close)
        context.inbox.close()
        self._near.tell_change()
        for event in self._awaited:  # the outbox may have ended without setting them
            event.set()

    async def _wait_unless_closed(self, event: anyio.Event) -> None:
        self._awaited.add(event)
        try:
            await event.wait()
        finally:
            self._awaited.discard(event)
        self._check_open()

    # names

    def _name(self, endpoint: Endpoint, format: Format) -> Named:
        """Give an endpoint its key and its token.

        The numbers in tokens are unique in the session.
        """
        self._check_open()
        if (node_id := self._numbers.get(endpoint.node)) is None:
            node_id = self._numbers[endpoint.node] = self._next_number()
        hashed = msgspec.structs.replace(endpoint, type_hash=format.type_hash)
        domain, zid = self.context.domain, self.context.session.zid
        token = endpoint_token(domain, zid, node_id, self._next_number(), hashed)
        named = msgspec.structs.replace(hashed, gid=gid_of(token))
        return Named(named, data_key(domain, named), token)

    def _next_number(self) -> int:
        self._count += 1
        return self._count - 1

    def _check_open(self) -> None:
        if not self.context.is_open:
            raise TurtleactError("the Zenoh transport is closed: open another")

    # other sessions

    def _servers(self, name: str) -> list[Endpoint]:
        """The servers of a service with that name in other sessions."""
        return [each for each in self.graph.endpoints(name) if each.kind == "service"]

    def _watch(self, session: Session) -> None:
        """Watch the tokens of other sessions. The outbox calls this."""
        inbox = self.context.inbox
        session.watch_tokens(
            all_tokens(self.context.domain),
            lambda key: inbox.push(partial(self.token_appeared, key)),
            lambda key: inbox.push(partial(self.token_gone, key)),
        )

    def token_appeared(self, key: str) -> None:
        """Handle a new token of another session."""
        token = self.graph.add(key)
        if token is None:
            return
        if token.endpoint is not None:
            self.context.seek(token.endpoint.name)
        self._near.tell_change()

    def token_gone(self, key: str) -> None:
        """Handle the loss of another session's token."""
        for gone in self._gone_since.values():
            gone.add(key)
        token = self.graph.remove(key)
        if token is None:
            return
        if token.endpoint is not None:
            self.context.forgo(token.endpoint.name)
        if token.endpoint is not None and token.endpoint.kind == "client":
            for handler in self._near.handlers(token.endpoint.name):
                if isinstance(handler, CallerAware):
                    handler.caller_lost(token.endpoint.gid)
        if token.endpoint is not None and token.endpoint.kind == "service":
            for each in tuple(self.context.opened):
                if isinstance(each, WireCaller):
                    each.doubt(token.endpoint.name)
        self._near.tell_change()


@asynccontextmanager
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
    """Open a graph of processes for the length of a block.

    If an endpoint cannot be reached or is already in use, this raises an error within a few
    seconds. Later, lost connections are restored silently, including those to a restarted router.

    Args:
        connect: The endpoints of routers or peers, all of which must be reachable. The default is
            ``tcp/localhost:7447``; a router connects to none.
        listen: The endpoints at which others can connect to this session. The default for a peer is
            a free port of this machine, for a router ``tcp/127.0.0.1:7447``, and for a client none.
        mode: ``"peer"`` joins like a ROS 2 node. ``"client"`` talks only through its router.
            ``"router"`` is what the ROS 2 nodes of this machine look for.
        domain: The ROS domain, 0 to 232. The default is that of ``ROS_DOMAIN_ID``, or 0.
        config: More of Zenoh's configuration: a mapping from paths (``"transport/link/tx/lease"``)
            to values, or the text of a JSON5 file, such as those that configure ROS 2. The other
            options take precedence over the file.
        clock: The clock of the nodes in this process. The default is wall time.
        discovery: How long after the opening a goal or call still waits for a server that has not
            been seen yet (s, event loop time). After that time, it fails at once if there is no
            server.

    Raises:
        InvalidOption: if the value of an option is not allowed.
        TurtleactError: if the session cannot connect to the graph, or cannot listen.
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
