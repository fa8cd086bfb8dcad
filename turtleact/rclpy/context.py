"""Contexts, which ``init`` starts and ``shutdown`` ends."""

from __future__ import annotations

import contextlib
import os
import threading
import weakref
from collections.abc import Callable, Sequence
from inspect import ismethod
from types import TracebackType
from typing import Self

from turtleact.rclpy.exceptions import NotInitializedException
from turtleact.rclpy.impl.arguments import Arguments, parse_arguments
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import Handle
from turtleact.rclpy.impl.process import PROCESS
from turtleact.rclpy.impl.typing import Anything
from turtleact.transports.rmw_zenoh.config import domain_of

__all__ = ["Context"]


class Context:
    """The context of nodes and executors, which work only between `init` and `shutdown`.

    The shutdown destroys the nodes, and then calls the callbacks of `on_shutdown`.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._callbacks: list[Callable[[], Callable[[], object] | None]] = []
        self._nodes: weakref.WeakSet[Anything] = weakref.WeakSet()
        self._handle: Handle | None = None
        self._is_ok = False
        self._domain: int | None = None
        self._connection: Connection | None = None
        self.arguments = Arguments()

    @property
    def handle(self) -> Handle | None:
        """The handle, which shows whether the context may be used; None before `init`."""
        return self._handle

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
            if self._handle is not None:
                raise RuntimeError("Context.init() must only be called once")
            arguments = parse_arguments(args)
            self._domain = domain_of(os.environ) if domain_id is None else domain_id
            self._handle = Handle()
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
            self.check()
            if self._connection is None:
                assert self._domain is not None  # noqa: S101  # `check`
                self._connection = PROCESS.join(self._domain, self)
            return self._connection

    def check(self) -> None:
        """Check that the context is initialised and not shut down.

        Raises:
            NotInitializedException: if the context is not `ok`.
        """
        if not self._is_ok:
            raise NotInitializedException

    def get_domain_id(self) -> int:
        """Return the ROS domain.

        Raises:
            RuntimeError: if the context was not initialised.
        """
        if self._domain is None:
            raise RuntimeError("Context must be initialized before it can have a domain id")
        return self._domain

    def destroy(self) -> None:
        """Shut down the context if it is initialised and not shut down yet."""
        self._shut_down()

    def shutdown(self) -> None:
        """Shut down the context.

        Raises:
            RuntimeError: if the context is not initialised, or was shut down before.
        """
        if not self._shut_down():
            raise RuntimeError("Context must be initialized before it can be shutdown")

    def try_shutdown(self) -> None:
        """Shut down the context if it is initialised and not shut down yet."""
        self._shut_down()

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Call ``callback()`` at the shutdown, or at once if the context is shut down already.

        Raises:
            TypeError: if the callback is not callable.
        """
        if not callable(callback):
            raise TypeError("callback should be a callable, got {}", type(callback))
        with self._lock:
            if self._handle is None or self._is_ok:
                # A bound method must not keep its object alive.
                is_bound = ismethod(callback)
                held = weakref.WeakMethod(callback) if is_bound else (lambda: callback)
                self._callbacks.append(held)
                return
        callback()

    def track_node(self, node: Anything) -> None:
        """Remember a node, so that the shutdown of the context destroys the node."""
        self._nodes.add(node)

    def untrack_node(self, node: Anything) -> None:
        """Forget a node, so that the shutdown of the context does not destroy the node."""
        self._nodes.discard(node)

    def _shut_down(self) -> bool:
        """Shut down and return True. If the context is not `ok`, do nothing and return False."""
        with PROCESS.ending():
            return self._end()

    def _end(self) -> bool:
        with self._lock:
            if not self._is_ok:
                return False
            self._is_ok = False
            callbacks, self._callbacks = self._callbacks, []
            nodes = list(self._nodes)
        # From now on no node can be made, and no spin goes on. The lock is free: a callback of the
        # program may use the context in any way, and a node that is being destroyed does.
        PROCESS.contexts.discard(self)
        for node in nodes:
            with contextlib.suppress(Exception):
                node.destroy_node()
        for held in callbacks:
            callback = held()
            if callback is not None:
                callback()
        if self._handle is not None:
            self._handle.destroy_when_not_in_use()
        self._connection = None
        PROCESS.leave(self)
        return True

    def __enter__(self) -> Self:
        if self._handle is None:
            self.init()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.try_shutdown()
