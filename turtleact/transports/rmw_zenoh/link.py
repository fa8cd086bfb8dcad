"""What the endpoints of a transport share: its session, its loop and threads, its local half."""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Callable, Coroutine
from time import time_ns
from typing import TYPE_CHECKING

import msgspec

from turtleact.tasks import GRACE, Background, Tasks
from turtleact.transports.base import Closeable, Endpoint
from turtleact.transports.memory import MemoryTransport
from turtleact.transports.rmw_zenoh.attachment import GID_SIZE, LAYOUT
from turtleact.transports.rmw_zenoh.boxes import Inbox, Outbox

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Session

__all__ = ["Counter", "Crew", "Link", "Named", "Opened", "Presence"]


class Named(msgspec.Struct, frozen=True):
    """An endpoint, and what it is called on the wire.

    Attributes:
        endpoint: The endpoint, with its type hash and gid.
        key: The key expression of its topic or service.
        token: Its liveliness token.
    """

    endpoint: Endpoint
    key: str
    token: str

    @property
    def on_demand(self) -> str:
        """Its name, if it is declared once others have an endpoint of that name; else empty."""
        return self.endpoint.name if self.endpoint.on_demand else ""


class Link:
    """What carries the messages of a transport.

    Attributes:
        session: The session; used in the outbox only.
        near: The graph within the process.
        tasks: The event loop.
        inbox: What came from other threads.
        outbox: What goes to Zenoh.
        crew: What runs beside.
        domain: The ROS domain.
        opened: The nodes and endpoints that are open, whoever else holds them.
        latched: The gids of its own latched publishers: a history asks them too.
        sought: How many endpoints of a name others have.
        asleep: What is told of only once others have an endpoint of its name.
        is_open: Whether anything goes through.
    """

    def __init__(self, session: Session, near: MemoryTransport, tasks: Tasks, domain: int) -> None:
        self.session = session
        self.near = near
        self.tasks = tasks
        self.inbox = Inbox(tasks)
        self.outbox = Outbox(f"turtleact-zenoh-{session.zid[:8]}")
        self.crew = Crew(tasks)
        self.domain = domain
        self.opened: set[Closeable] = set()
        self.latched: set[bytes] = set()
        self.sought: Tally[str] = Tally()
        self.asleep: dict[str, dict[Presence, None]] = {}
        self.is_open = True

    def seek(self, name: str) -> None:
        """Note that others have an endpoint of this name."""
        self.sought[name] += 1
        for presence in self.asleep.pop(name, ()):
            presence.wake()

    def forgo(self, name: str) -> None:
        """Note that they have one less."""
        self.sought[name] -= 1
        if not self.sought[name]:
            del self.sought[name]


class Crew:
    """Tasks that run beside their owner, each until its own end or that of all."""

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self._running: dict[int, Background] = {}
        self._count = 0

    def run(self, running: Coroutine[object, object, None], name: str) -> None:
        """Run a coroutine in a task of its own."""
        self._count += 1
        number = self._count
        background = Background(self._run(running, number), name, self._tasks)
        if not background.has_ended:  # its first steps may have been all
            self._running[number] = background

    async def aclose(self) -> None:
        """Cancel all, and wait for their end, `GRACE` seconds at most each."""
        for background in tuple(self._running.values()):
            await background.aclose(GRACE)

    async def _run(self, running: Coroutine[object, object, None], number: int) -> None:
        try:
            await running
        finally:
            self._running.pop(number, None)


class Counter:
    """Numbers and stamps what one endpoint sends.

    Args:
        gid: The gid of the endpoint.
    """

    def __init__(self, gid: bytes) -> None:
        self._gid = gid
        self._sequence = 0

    def next(self) -> bytes:
        """The attachment of the next message."""
        self._sequence += 1
        # as `write_attachment` does, without a call between: it is made for each message
        return LAYOUT.pack(self._sequence, time_ns(), GID_SIZE, self._gid)


class Presence:
    """What an endpoint or a node is on the wire: what it declares, then its liveliness token.

    Args:
        link: Where.
        token: The token; it is taken back before the rest.
        declare: Declares the rest, in the outbox.
        undeclare: Takes it back, likewise.
        on_demand: The name of an endpoint that is declared once others have one of that name; if
            it is empty, all is declared now.
        on_wake: Called when it is, if not at once.

    Attributes:
        is_asleep: Whether nothing is declared yet.
    """

    def __init__(
        self,
        link: Link,
        token: str,
        declare: Callable[[], None] | None = None,
        undeclare: Callable[[], None] | None = None,
        *,
        on_demand: str = "",
        on_wake: Callable[[], None] | None = None,
    ) -> None:
        self.is_asleep = True
        self._link = link
        self._token = token
        self._declare = declare
        self._undeclare = undeclare
        self._on_demand = on_demand
        self._on_wake = on_wake
        self._declared: Declared | None = None
        if on_demand and not link.sought[on_demand]:
            link.asleep.setdefault(on_demand, {})[self] = None
        else:
            self._appear()

    def wake(self) -> None:
        """Appear in the graph after all."""
        self._appear()
        if self._on_wake is not None:
            self._on_wake()

    def _appear(self) -> None:
        self.is_asleep = False
        if self._declare is not None:
            self._link.outbox.post(self._declare)
        self._link.outbox.post(self._declare_token)

    def close(self) -> None:
        """Leave the graph."""
        if not self.is_asleep:
            self._link.outbox.post(self._undeclare_token)
            if self._undeclare is not None:
                self._link.outbox.post(self._undeclare)
            return
        others = self._link.asleep.get(self._on_demand, {})
        others.pop(self, None)
        if not others:
            self._link.asleep.pop(self._on_demand, None)

    def _declare_token(self) -> None:
        self._declared = self._link.session.declare_token(self._token)

    def _undeclare_token(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()
            self._declared = None


class Opened:
    """Something that is open within the process and on the wire, until it is closed.

    Args:
        link: Where.
        near: Its half within the process.
        presence: Its half on the wire.

    Attributes:
        is_open: Whether it is.
    """

    def __init__(self, link: Link, near: Closeable, presence: Presence) -> None:
        self.is_open = True
        self._link = link
        self._near = near
        self._presence = presence
        link.opened.add(self)

    def close(self) -> None:
        """Leave the graph; a second time does nothing."""
        if self.is_open:
            self.is_open = False
            self._near.close()
            self._presence.close()
            self._link.opened.discard(self)
