"""Ensures that only one node serves an action name, and decides what a second node does.

One node may serve several types under one name, as for ``/fibonacci``. If two nodes served the same
name, every goal would run twice, because ROS 2 sends a request to all servers of a service. A
second node chooses one of these:

- ``refuse``: its `action_server` raises an error, which names the first node.
- ``wait``: it begins to serve when the first node has gone. This is useful for restarts and
  failover.
- ``withdraw``: it withdraws when any other node, in any process, serves the name. The running goals
  of the second node finish. When no other node serves the name any more, the second node serves the
  name again. The built-in actions do this.

A restarted node may still see its predecessor: a node of the same name. The predecessor's process
has just died, and its lease has not run out. The restarted node is not refused: it waits until the
predecessor is gone.

Across processes, all of this depends on discovery: a server counts only after it has been
discovered.
"""

from __future__ import annotations

import logging
import random
from collections.abc import Callable, Coroutine
from typing import Literal, TypeAlias, get_args

import anyio

from turtleact.errors import ActionConflict, InvalidOption
from turtleact.server.endpoints import ActionEndpoints
from turtleact.server.local_server import LocalActionServer
from turtleact.tasks import Background, current_tasks
from turtleact.transports.base import Transport

__all__ = ["BUILT_INS_NODE", "OnConflict", "Rivals", "ServedName", "check_on_conflict"]

logger = logging.getLogger("turtleact.server")

OnConflict: TypeAlias = Literal["refuse", "wait", "withdraw"]

BUILT_INS_NODE = "/turtle_actions"
"""The node of the built-in actions in every process. It withdraws in favour of any other node."""


STAGGER = random.uniform(0.0, 0.5)  # noqa: S311  # not for security
"""How long this process waits before it takes over from another process (s, event loop time)."""


class Rivals:
    """The other servers of one action name, as far as discovery shows them.

    Args:
        transport: The graph.
        service: The name of the action's ``send_goal`` service.
        node: The fully qualified name of the node that wants to serve the action.
    """

    def __init__(self, transport: Transport, service: str, node: str) -> None:
        self._transport = transport
        self._service = service
        self._node = node

    def check(self, action: str, type_name: str, own_types: set[str]) -> None:
        """Check that no other node serves the action, and that this node does not serve that type.

        Args:
            action: The action's name.
            type_name: The type that the node wants to serve.
            own_types: The types that the node already serves under the name.

        Raises:
            ActionConflict: if a node serves the action already. The error names that node.
        """
        if type_name in own_types:
            raise ActionConflict(action, self._node)
        other = self.first()
        if other is None and not own_types and self._node in self._nodes(is_local=True):
            other = self._node  # another node of this name in the same process
        if other is not None:
            raise ActionConflict(action, other)

    def first(self) -> str | None:
        """Return the first other node that serves the action, or None.

        Built-in actions do not count, because they withdraw.
        """
        own = (self._node, BUILT_INS_NODE)
        return next((node for node in self._nodes() if node not in own), None)

    def holder(self) -> str | None:
        """Return the node that must go before this node can serve; None if the name is free.

        The holder may be a predecessor: a node in another process with this node's own name.
        """
        if self._node in self._nodes(is_local=False):
            return self._node
        return self.first()

    def has_built_in(self, *, is_local: bool | None = None) -> bool:
        """Whether a built-in action, local or remote, must withdraw for this server.

        Ask about remote servers before this server is open: afterwards, a server of the same type
        always counts as local.
        """
        return self._node != BUILT_INS_NODE and BUILT_INS_NODE in self._nodes(is_local=is_local)

    @property
    def discovery_ends(self) -> float:
        """Before this moment, an existing server may still be undiscovered (event loop time)."""
        return self._transport.discovery_ends

    async def wait_until_free(self) -> None:
        """Wait until this node can serve the action. Cancelling: safe.

        Standbys in several processes all see at the same moment that a server has gone. Each
        standby then waits for a different time and looks again, so that only the first standby
        takes over.
        """
        while (holder := self.holder()) is not None:
            is_remote = holder in self._nodes(is_local=False)
            await self.wait_until(lambda: self.holder() is None)
            if is_remote:
                await anyio.sleep(STAGGER)

    async def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition on the graph holds. Cancelling: safe."""
        while not condition():
            await self._transport.wait_for_change()

    def _nodes(self, *, is_local: bool | None = None) -> list[str]:
        """List the nodes that serve the action: all nodes, only local ones, or only remote ones."""
        return [
            endpoint.node
            for endpoint in self._transport.endpoints(self._service)
            if endpoint.kind == "service" and is_local in (None, self._is_local(endpoint.type_name))
        ]

    def _is_local(self, type_name: str) -> bool:
        """Whether this process serves the service under that type."""
        return self._transport.local(self._service, type_name) is not None


class ServedName:
    """The name of one action server: the server serves it, waits for it, or makes way for others.

    Args:
        server: The object that holds and runs the goals.
        endpoints: The endpoints that put the server on the graph.
        rivals: The other servers of the name.
        types_served: A function that returns the types that the server's node now serves under the
            name.
        restore: Called once the server serves the name, to restore its goals.

    Attributes:
        is_serving: Whether the server is on the graph under its name.
    """

    def __init__(
        self,
        server: LocalActionServer,
        endpoints: ActionEndpoints,
        rivals: Rivals,
        types_served: Callable[[], set[str]],
        restore: Callable[[], object],
    ) -> None:
        self.is_serving = False
        self._server = server
        self._endpoints = endpoints
        self._rivals = rivals
        self._types_served = types_served
        self._restore = restore
        self._running: list[Background] = []
        self._turned = current_tasks().signal()

    def take(self, on_conflict: OnConflict, again: Callable[[], object]) -> None:
        """Serve the name now, or once it is free.

        Args:
            on_conflict: What to do if another node serves the name. "refuse" has been checked
                before: with it, only a predecessor can still hold the name, and the predecessor is
                about to disappear.
            again: Opens a server like this one, after this server has made way for another node.
        """
        if on_conflict == "withdraw":
            self._keep(self._make_way(again), "making way for others with")
        holder = self._rivals.holder()
        if holder is None:
            self._begin()
        elif on_conflict != "withdraw":
            logger.warning(
                "%s is served by %s: waiting until that has gone", self._server.name, holder
            )
            self._keep(self._serve_once_free(), "waiting to serve")

    async def wait(self) -> bool:
        """Wait until the server serves the name. False if it stopped before. Cancelling: safe."""
        while self._server.is_open and not self.is_serving:
            await self._turned.wait()
        return self.is_serving

    async def aclose(self) -> None:
        """Accept no more goals, and stop waiting for the name or making way."""
        self._stop()
        for running in self._running:
            await running.aclose()
        self._running.clear()

    def _keep(self, running: Coroutine[object, object, None], name: str) -> None:
        """Run a coroutine until the server is closed."""
        self._running.append(Background(running, f"{name} {self._server.name}"))

    def _begin(self) -> None:
        # Before the endpoints are open: afterwards a built-in action of the same type would count
        # as one of this process.
        if self._rivals.has_built_in(is_local=False):
            self._tell_of_built_in()
        elif not self._rivals.has_built_in():
            # On a graph that was opened a moment ago, it may not have been discovered yet.
            rest = self._rivals.discovery_ends - anyio.current_time()
            if rest > 0:
                self._keep(self._look_for_built_in(rest), "looking for a built-in of")
        self._endpoints.open()
        self._restore()
        self.is_serving = True
        self._turned.fire()

    def _stop(self) -> None:
        self._server.is_open = False
        self.is_serving = False
        self._turned.fire()

    async def _look_for_built_in(self, seconds: float) -> None:
        """Write a log line if discovery shows a built-in action within some seconds.

        Cancelling: safe.
        """
        with anyio.move_on_after(seconds):
            await self._rivals.wait_until(self._rivals.has_built_in)
            self._tell_of_built_in()

    def _tell_of_built_in(self) -> None:
        logger.warning("%s: the built-in action makes way for this one", self._server.name)

    async def _serve_once_free(self) -> None:
        """Join the graph when nobody else serves the name any more."""
        await self._rivals.wait_until_free()
        logger.warning("%s is free: serving it now", self._server.name)
        self._begin()

    async def _make_way(self, again: Callable[[], object]) -> None:
        """Withdraw when another node serves the name. Serve again when no other node serves it.

        A closed server cannot open again, so ``again`` opens another server, which watches for
        rivals in turn. Until then, the node keeps track of the old server, so that closing the node
        also ends this watch.
        """
        name, rivals = self._server.name, self._rivals
        await rivals.wait_until(lambda: rivals.first() is not None)
        self._stop()
        self._endpoints.stop_taking_goals()
        if not self._types_served():  # one line, though it may have several types
            logger.warning(
                "%s is served by %s now: the built-in action withdraws", name, rivals.first()
            )
        await self._server.wait_until_idle()
        await self._endpoints.aclose()
        await rivals.wait_until_free()
        if not self._types_served():
            logger.warning("%s is free: the built-in action serves it again", name)
        again()


def check_on_conflict(given: object) -> None:
    """Check a value of ``on_conflict``.

    Raises:
        InvalidOption: if the value is none of `OnConflict`.
    """
    if given not in get_args(OnConflict):
        words = ", ".join(get_args(OnConflict))
        raise InvalidOption("on_conflict", f"expected one of {words}, not {given!r}")
