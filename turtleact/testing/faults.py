"""A transport for tests that delays, loses and repeats messages, and whose link can be cut.

The faulty transport wraps another transport and affects only topics. Goals and service calls are
never late or lost, because inside one process a client calls the server's object directly, without
a transport. Messages that a body publishes or reads on topics may be late or lost.

The faults are random, and the same seed gives the same faults. Each subscription draws its own
random numbers from the seed and the names of its node and topic. A new subscription therefore does
not change the faults of the others.
"""

from __future__ import annotations

import math
import random
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

import msgspec

from turtleact.errors import SimError
from turtleact.tasks import Background
from turtleact.tasks.clock import Clock
from turtleact.transports import Transport
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

__all__ = ["Faults", "FaultyTransport"]


class Faults(msgspec.Struct, frozen=True):
    """How many messages were delivered or lost. A message counts once for each subscription.

    Attributes:
        delivered: How many messages arrived.
        repeated: How many of the delivered messages arrived twice.
        dropped: How many messages were lost by chance.
        cut: How many messages were lost because the link was cut.
        on_their_way: How many messages are delayed and have not arrived yet.
    """

    delivered: int = 0
    repeated: int = 0
    dropped: int = 0
    cut: int = 0
    on_their_way: int = 0


class FaultyTransport:
    """A transport that delivers messages late, twice or not at all.

    Only messages to subscriptions that are opened on this transport are affected. Nodes that are
    opened on the wrapped transport share the same graph, without faults. Messages keep their order,
    as in every transport, so a late message also delays the messages behind it. Messages may be
    lost even if their topic's quality of service is reliable.

    Close the transport, or use it as an async context manager. Delayed messages are lost when it
    closes.

    Args:
        transport: The transport to wrap.
        seed: Determines the random faults.
        delay: How late messages are (s of the transport's clock). Give one number for all messages,
            or a pair of the shortest and the longest delay. With a pair, each message gets a random
            delay between the two numbers.
        drop: The share of messages that are lost, from 0 to 1.
        repeat: The share of delivered messages that arrive twice, from 0 to 1.

    Attributes:
        clock: The clock of the wrapped transport.
        round_trip: The ``round_trip`` of the wrapped transport; see
            `turtleact.transports.Transport`.
        discovery_ends: The ``discovery_ends`` of the wrapped transport; see
            `turtleact.transports.Transport`.
        delay: The shortest and the longest delay (s). You may change it at any time.
        drop: The share of messages that are lost. You may change it at any time.
        repeat: The share of delivered messages that arrive twice. You may change it at any time.
        is_cut: Whether the link is cut, so that no message arrives.

    Raises:
        SimError: if an option is out of range.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        seed: int = 0,
        delay: float | tuple[float, float] = 0.0,
        drop: float = 0.0,
        repeat: float = 0.0,
    ) -> None:
        for name, share in (("drop", drop), ("repeat", repeat)):
            if not 0 <= share <= 1:
                raise SimError(f"{name} must be a share of messages, from 0 to 1, not {share}")
        shortest, longest = delay if isinstance(delay, tuple) else (delay, delay)
        if not 0 <= shortest <= longest < math.inf:
            raise SimError(f"delay must be 0 or more seconds, or an ordered pair, not {delay}")
        self.clock: Clock = transport.clock
        self.round_trip = transport.round_trip
        self.discovery_ends = transport.discovery_ends
        self.delay = (shortest, longest)
        self.drop = drop
        self.repeat = repeat
        self.counts: Counter[str] = Counter()
        self.is_cut = False
        self._transport = transport
        self._seed = seed
        self._links: list[_Link] = []
        self._names: Counter[str] = Counter()

    def cut(self) -> None:
        """Cut the link: no message arrives until `mend` is called.

        Messages that are due in the meantime are lost, even if they were sent before the cut.
        """
        self.is_cut = True

    def mend(self) -> None:
        """Mend the link, so that messages arrive again. Lost messages stay lost."""
        self.is_cut = False

    @contextmanager
    def cut_off(self) -> Iterator[None]:
        """Cut the link at the start of a ``with`` block, and mend it at the end."""
        self.cut()
        try:
            yield
        finally:
            self.mend()

    def statistics(self) -> Faults:
        """Return how many messages have been delivered or lost so far."""
        return Faults(**self.counts, on_their_way=sum(map(len, self._links)))

    def subscribe(
        self,
        endpoint: Endpoint,
        format: Format,
        deliver: Deliver,
        *,
        in_any_thread: bool = False,  # noqa: ARG002  # the delayed come in the event loop
        on_gap: Callable[[int], None] | None = None,  # noqa: ARG002  # the inner link has none
    ) -> Closeable:
        """Open a subscription of a topic, with faults."""
        name = f"{endpoint.node} {endpoint.name}"
        self._names[name] += 1
        chance = random.Random(f"{self._seed} {name} {self._names[name]}")  # noqa: S311  # no secret
        link = _Link(self, deliver, chance)
        self._links.append(link)
        link.inner = self._transport.subscribe(endpoint, format, link.take)
        return link

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open a publisher of a topic."""
        return self._transport.advertise(endpoint, format, source)

    def serve(self, endpoint: Endpoint, format: Format, handler: ServiceHandler) -> Closeable:
        """Offer ``handler`` as the server of a service."""
        return self._transport.serve(endpoint, format, handler)

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Show a client of a service on the graph, and return the object that calls the service.

        Faults do not affect the client's calls.
        """
        return self._transport.join(endpoint, format, target)

    def local(self, name: str, type_name: str) -> tuple[ServiceHandler, ...]:
        """Return all handlers in this process that serve a service, even while the link is cut."""
        return self._transport.local(name, type_name)

    def enter(self, node: str) -> Closeable:
        """Show a node on the graph."""
        return self._transport.enter(node)

    def call_when_sought(self, name: str, act: Callable[[], object]) -> Closeable:
        """Call ``act`` once another process has an endpoint with this name."""
        return self._transport.call_when_sought(name, act)

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """Return all endpoints on the graph, or only those of the topic or service ``name``."""
        return self._transport.endpoints(name)

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """Return all endpoints opened in this process, or only those called ``name``."""
        return self._transport.local_endpoints(name)

    def nodes(self) -> tuple[str, ...]:
        """Return the names of all nodes on the graph."""
        return self._transport.nodes()

    @property
    def changes(self) -> int:
        """How many times a node or endpoint has appeared or disappeared."""
        return self._transport.changes

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint appears or disappears. Cancelling: safe."""
        await self._transport.wait_for_change()

    async def aclose(self) -> None:
        """Close the transport: delayed messages are lost, and no more messages arrive."""
        self.cut()
        for link in self._links:
            await link.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.aclose()


class _Link:
    """The faulty link to one subscription. Its `len` is the number of delayed messages."""

    inner: Closeable

    def __init__(self, transport: FaultyTransport, deliver: Deliver, chance: random.Random) -> None:
        self._transport = transport
        self._deliver = deliver
        self._chance = chance
        self._late: deque[tuple[float, int, object]] = deque()
        self._courier: Background | None = None

    def __len__(self) -> int:
        return len(self._late)

    def take(self, message: object) -> None:
        """Take a message from the wrapped transport, and deliver, delay or lose it."""
        transport, chance = self._transport, self._chance
        is_dropped = chance.random() < transport.drop  # Always draw three numbers per message, so
        is_repeated = chance.random() < transport.repeat  # that one fault does not change the rest.
        delay = chance.uniform(*transport.delay)
        if transport.is_cut:
            transport.counts["cut"] += 1
        elif is_dropped:
            transport.counts["dropped"] += 1
        else:
            self._send(message, 1 + is_repeated, delay)

    def close(self) -> None:
        """Close the link. A second call does nothing."""
        self._late.clear()
        self.inner.close()

    async def aclose(self) -> None:
        """Close the link, and wait for the end of the task that delivers its delayed messages."""
        self.close()
        if self._courier is not None:
            await self._courier.aclose()

    def _send(self, message: object, times: int, delay: float) -> None:
        if not delay and not self._late:
            self._arrive(message, times)
            return
        self._late.append((self._transport.clock.time() + delay, times, message))
        if self._courier is None:
            self._courier = Background(self._carry(), "a faulty transport")

    async def _carry(self) -> None:
        """Deliver each delayed message when it is due."""
        transport = self._transport
        while self._late:
            await transport.clock.sleep_until(self._late[0][0])
            if self._late:  # otherwise it was closed meanwhile
                _, times, message = self._late.popleft()
                if transport.is_cut:
                    transport.counts["cut"] += 1
                else:
                    self._arrive(message, times)
        self._courier = None

    def _arrive(self, message: object, times: int) -> None:
        self._transport.counts["delivered"] += 1
        self._transport.counts["repeated"] += times - 1
        for _ in range(times):
            self._deliver(message)
