"""What the endpoints of a transport share: its session, its loop and threads, its local half."""

from __future__ import annotations

from collections.abc import Coroutine
from functools import partial
from time import time_ns
from typing import TYPE_CHECKING

import msgspec

from turtleact.tasks import GRACE, Background, Tasks
from turtleact.transports.base import Closeable, Endpoint
from turtleact.transports.memory import MemoryTransport
from turtleact.transports.rmw_zenoh.attachment import write_attachment
from turtleact.transports.rmw_zenoh.boxes import Inbox, Outbox

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Session

__all__ = ["Counter", "Crew", "Link", "Named", "Presence"]


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
        self.is_open = True


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
        return write_attachment(self._sequence, time_ns(), self._gid)


class Presence:
    """A liveliness token: to be made after what it tells of is posted, and closed before."""

    def __init__(self, link: Link, token: str) -> None:
        self._link = link
        self._declared: Declared | None = None
        link.outbox.post(partial(self._declare, token))

    def close(self) -> None:
        """Leave the graph."""
        self._link.outbox.post(self._undeclare)

    def _declare(self, token: str) -> None:
        self._declared = self._link.session.declare_token(token)

    def _undeclare(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()
            self._declared = None
