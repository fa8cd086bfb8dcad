"""The functions of ``rclpy`` itself: init, spin, shutdown and the like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module

from turtleact.rclpy import qos
from turtleact.rclpy.context import (
    Context,
    SignalHandlerOptions,
    get_default_context,
    get_rmw_implementation_identifier,
    install_signal_handlers,
    ok,
    shutdown,
    try_shutdown,
)
from turtleact.rclpy.exceptions import InvalidHandle, RCLError, UnknownROSArgsError
from turtleact.rclpy.executors import Executor, SingleThreadedExecutor
from turtleact.rclpy.graph import NodeNameNonExistentError
from turtleact.rclpy.impl.entity import Block
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.node import Node
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.task import Future

__all__ = [
    "Context",
    "Future",
    "InitContextManager",
    "Node",
    "Parameter",
    "SignalHandlerOptions",
    "create_node",
    "get_default_context",
    "get_global_executor",
    "get_rmw_implementation_identifier",
    "init",
    "ok",
    "rclpy_implementation",
    "shutdown",
    "spin",
    "spin_once",
    "spin_until_future_complete",
    "try_shutdown",
]


class _Global:
    """Holds the global executor, which `spin` uses by default."""

    executor: Executor | None = None


_global = _Global()


class InitContextManager(Block):
    """The result of `init`. As a context manager, it shuts its context down when the block ends.

    Args:
        context: The context.
        is_default: Whether it is the default context.
    """

    def __init__(self, context: Context, *, is_default: bool) -> None:
        self.context = context
        self._is_default = is_default

    def _leave(self) -> None:
        try_shutdown(context=None if self._is_default else self.context)


def init(
    *,
    args: Sequence[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> InitContextManager:
    """Initialise a context, or the default one.

    Args:
        args: The arguments of the program. None means ``sys.argv``.
        context: The context. None means the default context.
        domain_id: The ROS domain. None means the domain in the environment.
        signal_handler_options: Which signals shut contexts down. None means SIGINT and SIGTERM if
            this is the default context, and no signals otherwise.

    Raises:
        RuntimeError: if the context was initialised before.
    """
    given = get_default_context() if context is None else context
    if signal_handler_options is None:
        is_default = context is None
        signal_handler_options = SignalHandlerOptions.ALL if is_default else SignalHandlerOptions.NO
    given.init(args, domain_id=domain_id)
    install_signal_handlers(signal_handler_options)
    return InitContextManager(given, is_default=context is None)


def get_global_executor() -> Executor:
    """Return the global executor, which `spin` uses by default.

    After a shutdown, there is a new one.
    """
    if _global.executor is None or not _global.executor.context.ok():
        _global.executor = SingleThreadedExecutor()
    return _global.executor


def create_node(node_name: str, **options: Anything) -> Node:
    """Make a node; see `Node` for the options."""
    return Node(node_name, **options)


@contextmanager
def _borrowed(node: Node, executor: Executor | None) -> Iterator[Executor]:
    """Put a node into an executor for a ``with`` block, then back into its earlier executor.

    The genuine rclpy leaves the node without an executor, so its callbacks never run again.
    """
    used = get_global_executor() if executor is None else executor
    before = node.executor
    if before is not None and node not in before.get_nodes():
        before = None
    used.add_node(node)
    try:
        yield used
    finally:
        if before is not used:
            used.remove_node(node)
            if before is not None:
                before.add_node(node)


def spin_once(
    node: Node, *, executor: Executor | None = None, timeout_sec: float | None = None
) -> None:
    """Run one callback of a node.

    Args:
        node: The node.
        executor: The executor; None means the global one.
        timeout_sec: How long to wait for a callback (s). None or a negative number means for ever.
    """
    with _borrowed(node, executor) as used:
        used.spin_once(timeout_sec=timeout_sec)


def spin(node: Node, executor: Executor | None = None) -> None:
    """Run the callbacks of a node until its context is shut down.

    Args:
        node: The node.
        executor: The executor; None means the global one.

    Raises:
        ExternalShutdownException: if something other than a callback shuts the context down.
    """
    with _borrowed(node, executor) as used:
        while used.context.ok():
            used.spin_once()


def spin_until_future_complete(
    node: Node,
    future: Future,
    executor: Executor | None = None,
    timeout_sec: float | None = None,
) -> None:
    """Run the callbacks of a node until a future is done, or the time is over.

    Args:
        node: The node.
        future: The future.
        executor: The executor; None means the global one.
        timeout_sec: The longest time to wait for the future (s). None or a negative number means
            for ever.
    """
    with _borrowed(node, executor) as used:
        used.spin_until_future_complete(future, timeout_sec)


def __getattr__(name: str) -> object:
    """Import a module of rclpy when it is used as an attribute, such as ``rclpy.qos``."""
    if not name.startswith("_"):
        try:
            return import_module(f"rclpy.{name}")
        except ModuleNotFoundError:
            pass
    raise AttributeError(f"module 'rclpy' has no attribute '{name}'")


class rmw_qos_profile_t:
    """Replaces rclpy's class of the same name, which has the predefined QoS profiles."""

    @staticmethod
    def predefined(name: str) -> qos.QoSProfile:
        """Return the profile with a name such as ``qos_profile_default``."""
        found: qos.QoSProfile = getattr(qos, name)
        return found


class rclpy_implementation:  # rclpy's name
    """Has the names that some programs import from rclpy's extension module."""

    InvalidHandle = InvalidHandle
    NodeNameNonExistentError = NodeNameNonExistentError
    RCLError = RCLError
    RCLInvalidROSArgsError = RCLError
    UnknownROSArgsError = UnknownROSArgsError
    rmw_qos_profile_t = rmw_qos_profile_t
    rclpy_get_rmw_implementation_identifier = staticmethod(get_rmw_implementation_identifier)
