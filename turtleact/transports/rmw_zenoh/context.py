"""What the endpoints of a transport share: session, event loop, threads and local transport.

A `ReceiveQueue` and a `SendQueue` connect the event loop to other threads. One wake-up of the event
loop may handle many messages, and no message blocks the event loop.
"""

from __future__ import annotations

import logging
import math
import queue
import threading
from collections import deque
from collections.abc import Callable, Coroutine
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, TypeAlias

import anyio
import anyio.to_thread
import msgspec

from turtleact.tasks import GRACE, Background, Tasks
from turtleact.transports.base import Closeable, Closing, Endpoint
from turtleact.transports.memory import MemoryTransport
from turtleact.transports.rmw_zenoh.wire import Graph

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Session

__all__ = [
    "Context",
    "Crew",
    "Declaration",
    "Demand",
    "Named",
    "Opened",
    "RateLimitedLog",
    "ReceiveQueue",
    "SendQueue",
]

logger = logging.getLogger("turtleact.transport")

Job: TypeAlias = Callable[[], object]

#: How many jobs run in a row before the event loop gets a turn.
IN_A_ROW = 100

#: How soon after a warning another one of its kind is logged (s).
PERIOD = 10.0


class Named(msgspec.Struct, frozen=True):
    """An endpoint, with its key expression and its liveliness token.

    Attributes:
        endpoint: The endpoint, with its type hash and gid.
        key: The key expression of the endpoint's topic or service.
        token: The endpoint's liveliness token.
    """

    endpoint: Endpoint
    key: str
    token: str

    @property
    def on_demand(self) -> str:
        """The endpoint's name if the endpoint is declared on demand; otherwise empty."""
        return self.endpoint.name if self.endpoint.on_demand else ""


class Context:
    """Everything that the endpoints of one transport share.

    Attributes:
        session: The Zenoh session. Only jobs in the send queue call it.
        near: The local transport, which connects the endpoints in this process.
        tasks: The task functions of the event loop, either asyncio or trio.
        receive_queue: Runs jobs from other threads in the event loop.
        send_queue: Runs jobs that call Zenoh.
        crew: Runs the tasks of the transport.
        log: Logs warnings about peers.
        domain: The ROS domain.
        opened: The nodes and endpoints that are open.
        latched: The gids of this session's latched publishers. A new latched subscription of this
            session gets the messages of these publishers twice: as objects from the local
            transport, and as bytes from Zenoh. The subscription uses the gids to recognize and
            ignore these bytes.
        graph: The nodes and endpoints of other sessions.
        demand: Calls what waits for a name that other processes use.
        is_open: Whether the transport is open.
    """

    def __init__(self, session: Session, near: MemoryTransport, tasks: Tasks, domain: int) -> None:
        self.session = session
        self.near = near
        self.tasks = tasks
        self.receive_queue = ReceiveQueue(tasks)
        self.send_queue = SendQueue(f"turtleact-zenoh-{session.zid[:8]}")
        self.crew = Crew(tasks)
        self.log = RateLimitedLog()
        self.domain = domain
        self.opened: set[Closeable] = set()
        self.latched: set[bytes] = set()
        self.graph = Graph(session.zid)
        self.demand = Demand(self.graph)
        self.is_open = True


class Demand:
    """Calls what waits until other processes have an endpoint with a certain name.

    Args:
        graph: The nodes and endpoints of other sessions.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._waiting: dict[str, list[Job]] = {}

    def has(self, name: str) -> bool:
        """Whether another process has an endpoint with this name."""
        return bool(self._graph.endpoints(name))

    def appeared(self, name: str) -> None:
        """Call what waits for this name, because another process has an endpoint with it."""
        for act in self._waiting.pop(name, ()):
            act()

    def call_when_sought(self, name: str, act: Job) -> Closeable:
        """Call ``act`` once; see `turtleact.transports.base.Transport`."""
        if self.has(name):
            act()
        else:
            self._waiting.setdefault(name, []).append(act)
        return Closing(partial(self._forget, name, act))

    def _forget(self, name: str, act: Job) -> None:
        waiting = self._waiting.get(name, [])
        if act in waiting:
            waiting.remove(act)
            if not waiting:
                del self._waiting[name]


class Crew:
    """Runs the tasks of a transport, and cancels them when the transport is closed.

    Attributes:
        running: The tasks that have not ended, each with a key of its own.
    """

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self.running: dict[object, Background] = {}

    def run(self, running: Coroutine[object, object, None], name: str) -> None:
        """Run a coroutine in a new task."""
        key = object()
        self.running[key] = Background(self._run(running, key), name, self._tasks)

    async def aclose(self) -> None:
        """Cancel all tasks one after another, and wait at most `GRACE` seconds for each to end."""
        for background in tuple(self.running.values()):
            await background.aclose(GRACE)

    async def _run(self, running: Coroutine[object, object, None], key: object) -> None:
        try:
            await running
        finally:
            self.running.pop(key, None)


class Declaration:
    """Declares an endpoint or node to other processes, together with its liveliness token.

    The token is declared last and undeclared first, so that no process sees an endpoint that cannot
    be reached.

    Args:
        context: The transport's context.
        token: The liveliness token.
        declare: Declares what the endpoint sends or receives with, and returns it. It is called in
            the thread of the send queue. A node has nothing but its token.
        on_demand: The name of an endpoint. The endpoint of this object is declared only when
            another process has an endpoint with the name ``on_demand``. If ``on_demand`` is empty,
            the endpoint is declared at once.
        on_wake: Called when another process opens an endpoint with the name that ``on_demand``
            holds, and this endpoint is therefore declared.

    Attributes:
        is_pending: Whether the endpoint is not declared yet because of ``on_demand``.
    """

    def __init__(
        self,
        context: Context,
        token: str,
        declare: Callable[[], Declared] | None = None,
        *,
        on_demand: str = "",
        on_wake: Callable[[], None] | None = None,
    ) -> None:
        self.is_pending = True
        self._context = context
        self._token = token
        self._declare = declare
        self._on_wake = on_wake
        self._declared: list[Declared] = []  # the token is the last one
        self._waiting: Closeable | None = None
        if on_demand and not context.demand.has(on_demand):
            self._waiting = context.demand.call_when_sought(on_demand, self._wake)
        else:
            self._appear()

    def _wake(self) -> None:
        self._appear()
        if self._on_wake is not None:
            self._on_wake()

    def _appear(self) -> None:
        self.is_pending = False
        self._context.send_queue.post(self._declare_all)

    def close(self) -> None:
        """Undeclare the endpoint or node, so that it leaves the graph."""
        if not self.is_pending:
            self._context.send_queue.post(self._undeclare_all)
        elif self._waiting is not None:
            self._waiting.close()

    def _declare_all(self) -> None:
        if self._declare is not None:
            self._declared.append(self._declare())
        self._declared.append(self._context.session.declare_token(self._token))

    def _undeclare_all(self) -> None:
        while self._declared:
            self._declared.pop().undeclare()


class Opened:
    """A node or endpoint that is open both in the local transport and on Zenoh.

    Args:
        context: The transport's context.
        near: The node or endpoint in the local transport.
        declaration: Declares the node or endpoint to other processes.

    Attributes:
        is_open: Whether the node or endpoint is open.
        declaration: Declares the node or endpoint to other processes.
    """

    def __init__(self, context: Context, near: Closeable, declaration: Declaration) -> None:
        self.is_open = True
        self._context = context
        self._near = near
        self.declaration = declaration
        context.opened.add(self)

    def close(self) -> None:
        """Remove the node or endpoint from the graph. A second call does nothing."""
        if self.is_open:
            self.is_open = False
            self._near.close()
            self.declaration.close()
            self._context.opened.discard(self)


class ReceiveQueue:
    """Runs jobs from other threads in the event loop, in order.

    Args:
        tasks: The task functions of the event loop, either asyncio or trio.
    """

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self._jobs: deque[Job] = deque()
        self._is_armed = False

    def push(self, job: Job) -> None:
        """Run a job in the event loop. May be called in any thread."""
        self._jobs.append(job)
        if not self._is_armed:
            self._is_armed = True
            self._tasks.from_anywhere(self._work)

    def _work(self) -> None:
        self._is_armed = False
        jobs = self._jobs
        for _ in range(min(len(jobs), IN_A_ROW)):
            try:
                jobs.popleft()()
            except Exception:
                logger.exception("the Zenoh transport failed to handle a message")
        if self._jobs and not self._is_armed:
            self._is_armed = True
            self._tasks.from_anywhere(self._work)


class SendQueue:
    """A thread that runs blocking jobs one after another, and logs their exceptions.

    Args:
        name: The name of the thread.

    Attributes:
        post: Adds a job without blocking.
        thread: The thread that runs the jobs.
    """

    def __init__(self, name: str) -> None:
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self.post: Callable[[Job], None] = self._jobs.put  # saves a call per job
        self._is_left = False
        self.thread = threading.Thread(target=self._work, name=name, daemon=True)
        self.thread.start()

    async def aclose(self) -> None:
        """Run the remaining jobs, and end the thread. Give up after `GRACE` seconds."""
        self._jobs.put(None)
        await anyio.to_thread.run_sync(self.thread.join, GRACE)
        if self.thread.is_alive():
            self._is_left = True
            logger.error("a peer reads nothing: the Zenoh transport closes with messages unsent")

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None and not self._is_left:
            try:
                job()
            except Exception:
                if not self._is_left:  # otherwise the session may have been closed meanwhile
                    logger.exception("the Zenoh transport failed to send")


class RateLimitedLog:
    """Logs warnings about messages of peers, so few that no peer can fill the log.

    One warning of each kind is logged within `PERIOD` seconds. It says how many were left out
    before.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, tuple[float, int]] = {}  # when it was logged, and how many since

    def warn(self, about: str, error: Exception) -> None:
        """Log a warning, unless one of its kind was logged in this period. Call it in any thread.

        Args:
            about: A sentence that says what went wrong, and where. It is the kind of the warning.
            error: The exception to report.
        """
        logged, count = self._kinds.get(about, (-math.inf, 0))
        now = monotonic()
        if now - logged < PERIOD:
            self._kinds[about] = logged, count + 1
            return
        more = f" ({count:,} more such warnings before)" if count else ""
        logger.warning("%s: %s%s", about, error, more)
        self._kinds[about] = now, 0
