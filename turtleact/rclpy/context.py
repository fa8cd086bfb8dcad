"""Contexts, which ``init`` starts and ``shutdown`` ends, the graphs that they join, and signals.

A graph is joined when the first node needs it, and left when the last context that uses it is shut
down. The event loop keeps running for the next ``init``.

SIGINT and SIGTERM shut every context down. Python may call a signal handler anywhere in the
program, even while the program holds a lock. The handler therefore starts a thread, which shuts the
contexts down. The handler then calls the previously installed handler. For SIGINT, the previous
handler is usually Python's own handler, which raises KeyboardInterrupt.
"""

from __future__ import annotations

import _thread
import atexit
import os
import signal
import sys
import threading
import weakref
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from enum import IntFlag
from functools import partial
from inspect import ismethod
from types import FrameType
from typing import Self, TypeAlias

import anyio

from turtleact.errors import TurtleactError
from turtleact.rclpy.exceptions import NotInitializedException
from turtleact.rclpy.face import SETTINGS, JoinOptions
from turtleact.rclpy.impl.arguments import Arguments, parse_arguments, split_arguments
from turtleact.rclpy.impl.connection import Connection, EventLoop, OpenTransport
from turtleact.rclpy.impl.entity import Block, BusyThreads, Handle
from turtleact.rclpy.impl.typing import Anything
from turtleact.tasks.clock import Clock
from turtleact.transports import MemoryTransport, Transport, open_zenoh
from turtleact.transports.rmw_zenoh.config import domain_of

__all__ = [
    "PROCESS",
    "Context",
    "Process",
    "SignalHandlerOptions",
    "get_current_signal_handlers_options",
    "get_default_context",
    "get_rmw_implementation_identifier",
    "install_signal_handlers",
    "ok",
    "open_chosen",
    "remove_ros_args",
    "shutdown",
    "try_shutdown",
    "uninstall_signal_handlers",
]

RMW = "rmw_zenoh_cpp"
"""The middleware with the protocol that turtleact speaks."""

ATTEMPTS = 20
"""How many times to try to open the graph.

An attempt fails if another program becomes the router at the same time.
"""

PAUSE = 0.05
"""How long to wait between two attempts to open the graph (s)."""

LISTEN = ("tcp/127.0.0.1:7447",)
"""Where the nodes of a machine look for a router."""


@asynccontextmanager
async def open_chosen(domain: int) -> AsyncIterator[Transport]:
    """Open the graph that was chosen for this process.

    An embedded world opens its own connection to the graph, like ``turtleact serve``. Other
    programs and commands can therefore also see the world.

    Raises:
        TurtleactError: if the graph cannot be opened.
    """
    place = SETTINGS.place
    async with AsyncExitStack() as stack:
        if place.is_embedded:
            from turtleact.sim.world_node import open_world

            world = open_world(graph=partial(_open, place, domain))
            await stack.enter_async_context(world)
        yield await stack.enter_async_context(_open(place, domain))


@asynccontextmanager
async def _open(
    place: JoinOptions, domain: int, clock: Clock | None = None
) -> AsyncIterator[Transport]:
    if place.is_alone:
        yield MemoryTransport(clock)
        return
    peer = partial(open_zenoh, domain=domain, config=place.config, clock=clock)
    async with AsyncExitStack() as stack:
        if place.connect:
            yield await stack.enter_async_context(peer(place.connect))
        else:
            yield await _join_or_lead(stack, peer)


async def _join_or_lead(
    stack: AsyncExitStack, peer: Callable[..., AbstractAsyncContextManager[Transport]]
) -> Transport:
    """Connect to the router of this machine, or become the router if there is none."""
    router = partial(peer, mode="router", listen=LISTEN)
    for _ in range(ATTEMPTS - 1):
        for opening in (peer, router):
            with suppress(TurtleactError):
                return await stack.enter_async_context(opening())
        await anyio.sleep(PAUSE)
    return await stack.enter_async_context(router())


PATIENCE = 2.5
"""How long to delay the end of the process while other threads shut contexts down (s)."""


class Process:
    """Holds the event loop, the joined graphs and the contexts of this process.

    Attributes:
        loop: The event loop.
        contexts: All contexts that are initialised and not shut down.
        open_transport: A function that opens the graph of a ROS domain.
        ending: The threads that shut contexts down.
    """

    def __init__(self) -> None:
        self.loop = EventLoop()
        self.contexts: weakref.WeakSet[Anything] = weakref.WeakSet()
        self.open_transport: OpenTransport = open_chosen
        self.ending = BusyThreads()
        self._lock = threading.Lock()
        self._is_registered = False
        self._connections: dict[int, tuple[Connection, set[int]]] = {}

    def join(self, domain: int, user: object) -> Connection:
        """Return the connection to the graph of a domain; open the connection on the first call.

        Raises:
            TurtleactError: if the graph cannot be opened.
        """
        with self._lock:
            if not self._is_registered:
                # Most programs end without a call of `shutdown`.
                self._is_registered = True
                atexit.register(self.shut_down)
            if domain not in self._connections:
                connection = Connection(self.loop, self.open_transport, domain)
                self._connections[domain] = connection, set()
            connection, users = self._connections[domain]
            users.add(id(user))
            return connection

    def shut_down(self) -> None:
        """Shut all contexts down, and wait for those that other threads are shutting down.

        After a signal, a thread shuts the contexts down while the main thread ends the program. If
        the interpreter ended before the process left the graph, a thread of Zenoh could call
        into the interpreter, and the C library would abort the process.
        """
        for context in list(self.contexts):
            context.try_shutdown()
        self.ending.wait_for_others(PATIENCE)

    def leave(self, domain: int, user: object) -> None:
        """Leave the graph of a domain that ``user`` may have joined, unless it has other users."""
        with self._lock:
            connection, users = self._connections.get(domain, (None, set()))
            users.discard(id(user))
            if connection is None or users:
                return
            del self._connections[domain]
        connection.close()


#: The only one. It is global because rclpy's API is: ``rclpy.init()`` names no process.
PROCESS = Process()


class Context(Block):
    """The context of nodes and executors, which work only between `init` and `shutdown`.

    The shutdown destroys the nodes, and then calls the callbacks of `on_shutdown`.

    Attributes:
        handle: Shows whether the context may be used; None before `init`.
        arguments: The ROS arguments of the program.
        nodes: The nodes that the shutdown destroys.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._callbacks: list[Callable[[], Callable[[], object] | None]] = []
        self.nodes: weakref.WeakSet[Anything] = weakref.WeakSet()
        self.handle: Handle | None = None
        self._is_ok = False
        self._domain: int | None = None
        self._connection: Connection | None = None
        self.arguments = Arguments()

    def init(
        self,
        args: Sequence[str] | None = None,
        *,
        initialize_logging: bool = True,
        domain_id: int | None = None,
    ) -> None:
        """Initialise the context.

        Args:
            args: The arguments of the program. Only those after ``--ros-args`` are used. None means
                ``sys.argv``.
            initialize_logging: Whether to apply the log levels in the arguments.
            domain_id: The ROS domain. None means the domain in the environment variable
                ``ROS_DOMAIN_ID``.

        Raises:
            RuntimeError: if the context was initialised before, or the domain is negative.
            UnknownROSArgsError: if an argument after ``--ros-args`` is unknown.
        """
        with self._lock:
            if domain_id is not None and domain_id < 0:
                raise RuntimeError(f"Domain id ({domain_id}) should not be lower than zero.")
            if self.handle is not None:
                raise RuntimeError("Context.init() must only be called once")
            arguments = parse_arguments(args)
            self._domain = domain_of(os.environ) if domain_id is None else domain_id
            self.handle = Handle()
            self.arguments = arguments
            self._is_ok = True
            PROCESS.contexts.add(self)
        if initialize_logging:
            from turtleact.rclpy.logging import apply_levels

            apply_levels(arguments.log_levels)

    def ok(self) -> bool:
        """Whether the context is initialised and not shut down."""
        return self._is_ok

    @property
    def connection(self) -> Connection:
        """The connection to the graph, which is joined on first use.

        Raises:
            NotInitializedException: if the context is not `ok`.
        """
        with self._lock:
            if not self._is_ok:
                raise NotInitializedException
            if self._connection is None:
                self._connection = PROCESS.join(self.get_domain_id(), self)
            return self._connection

    def get_domain_id(self) -> int:
        """Return the ROS domain.

        Raises:
            RuntimeError: if the context was not initialised.
        """
        if self._domain is None:
            raise RuntimeError("Context must be initialized before it can have a domain id")
        return self._domain

    def shutdown(self) -> None:
        """Shut down the context.

        Raises:
            RuntimeError: if the context is not initialised, or was shut down before.
        """
        if not self.try_shutdown():
            raise RuntimeError("Context must be initialized before it can be shutdown")

    def try_shutdown(self) -> bool:
        """Shut down the context and return True. If the context is not `ok`, return False."""
        with PROCESS.ending:
            return self._end()

    def destroy(self) -> None:
        """Shut down the context, unless it is already shut down."""
        self.try_shutdown()

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Call ``callback()`` at the shutdown, or at once if the context is shut down already.

        Raises:
            TypeError: if the callback is not callable.
        """
        if not callable(callback):
            raise TypeError("callback should be a callable, got {}", type(callback))
        with self._lock:
            if self.handle is None or self._is_ok:
                # A bound method must not keep its object alive.
                is_bound = ismethod(callback)
                held = weakref.WeakMethod(callback) if is_bound else (lambda: callback)
                self._callbacks.append(held)
                return
        callback()

    def _end(self) -> bool:
        with self._lock:
            if not self._is_ok:
                return False
            self._is_ok = False
            callbacks, self._callbacks = self._callbacks, []
            nodes = list(self.nodes)
        # From now on no node can be made, and no spin goes on. The lock is free: a callback of the
        # program may use the context in any way, and a node that is being destroyed does.
        PROCESS.contexts.discard(self)
        for node in nodes:
            with suppress(Exception):
                node.destroy_node()
        for held in callbacks:
            callback = held()
            if callback is not None:
                callback()
        if self.handle is not None:
            self.handle.destroy_when_not_in_use()
        self._connection = None
        PROCESS.leave(self.get_domain_id(), self)
        return True

    def __enter__(self) -> Self:
        if self.handle is None:
            self.init()
        return self

    def _leave(self) -> None:
        self.try_shutdown()


class _Default:
    """Holds the default context."""

    context: Context | None = None


DEFAULT = _Default()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """Return the default context, which is used if no context is given.

    Args:
        shutting_down: Whether the context is about to be shut down. If true, the next call returns
            a new context.
    """
    context = DEFAULT.context or Context()
    DEFAULT.context = None if shutting_down else context
    return context


def ok(*, context: Context | None = None) -> bool:
    """Whether a context, or the default one, is initialised and not shut down."""
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut down a context, or the default one. `Context.shutdown` lists the errors.

    Args:
        context: The context. None means the default context.
        uninstall_handlers: Whether to restore the handlers of signals. None means to do so for the
            default context only.
    """
    (get_default_context(shutting_down=True) if context is None else context).shutdown()
    _uninstall(context, uninstall_handlers)


def try_shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut down a context, or the default one, unless it is already shut down; see `shutdown`."""
    given = get_default_context() if context is None else context
    if context is None and given.handle is not None:  # it may also have been shut down by a signal
        get_default_context(shutting_down=True)
    given.try_shutdown()
    _uninstall(context, uninstall_handlers)


def _uninstall(context: Context | None, wanted: bool | None) -> None:
    if wanted or (wanted is None and context is None):
        uninstall_signal_handlers()


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """Return ``args``, by default ``sys.argv``, without the part from ``--ros-args`` to ``--``."""
    return split_arguments(sys.argv if args is None else args)[0]


def get_rmw_implementation_identifier() -> str:
    """Return the name of the middleware."""
    return RMW


# --- signals ------------------------------------------------------------------------------------

Handler: TypeAlias = Callable[[int, FrameType | None], object] | int | None


class SignalHandlerOptions(IntFlag):
    """Which signals shut contexts down."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


SIGNALS = {
    SignalHandlerOptions.SIGINT: signal.SIGINT,
    SignalHandlerOptions.SIGTERM: signal.SIGTERM,
}


class _Handlers:
    """Installs and restores signal handlers."""

    def __init__(self) -> None:
        self.installed = SignalHandlerOptions.NO
        self._before: dict[int, Handler] = {}

    def install(self, options: SignalHandlerOptions) -> None:
        """Install handlers for the given signals.

        Python allows this only in the main thread. In other threads, this method does nothing.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        for option, number in SIGNALS.items():
            if option in options and option not in self.installed:
                # Known before the signal can come: it must reach the former handler, too.
                self._before[number] = signal.getsignal(number)
                signal.signal(number, self._receive)
                self.installed |= option

    def uninstall(self) -> None:
        """Restore the earlier handlers, unless other code has replaced turtleact's handlers."""
        if threading.current_thread() is not threading.main_thread():
            return
        for option, number in SIGNALS.items():
            if option in self.installed:
                if signal.getsignal(number) == self._receive:
                    signal.signal(number, self._before.pop(number))
                self.installed &= ~option

    def _receive(self, number: int, frame: FrameType | None) -> None:
        # Unlike `threading.Thread.start`, this takes no lock that the interrupted code may hold.
        _thread.start_new_thread(PROCESS.shut_down, ())
        before = self._before.get(number)
        if callable(before):
            before(number, frame)


HANDLERS = _Handlers()


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Install handlers for the given signals. `rclpy.init` calls this function."""
    HANDLERS.install(options)


def get_current_signal_handlers_options() -> SignalHandlerOptions:
    """Return which signals shut contexts down."""
    return HANDLERS.installed


def uninstall_signal_handlers() -> None:
    """Restore the signal handlers that were set before `install_signal_handlers` was called."""
    HANDLERS.uninstall()
