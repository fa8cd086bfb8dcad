"""Ensures that only one node serves an action name, and resolves conflicts between nodes.

One node may serve several types under one name. For example, the built-in ``/fibonacci`` has two
types. If two nodes served the same name, every goal would run twice, because ROS 2 sends a request
to all servers of a service. The argument ``on_conflict`` of the second node decides what happens:

- ``refuse``: The second node's call of `action_server` raises an error, which names the first node.
- ``wait``: The second node begins to serve when the first node no longer serves the name. This is
  useful for restarts and failover.
- ``withdraw``: The second node withdraws when any other node, in any process, serves the name.
  Running goals of the second node still finish. When no other node serves the name any more, the
  second node serves the name again. The built-in actions use ``withdraw``.

If a process dies, its nodes stay on the graph until their leases run out. So a restarted node may
still see its predecessor, which has the same name. In this case even ``refuse`` raises no error.
The restarted node waits until the predecessor has left the graph.

A node notices a server in another process only after discovery has found that server.
"""

from __future__ import annotations

import logging
import random
from collections.abc import Callable, Coroutine
from typing import Literal, TypeAlias, get_args

import anyio

from turtleact.errors import ActionConflict, InvalidOption
from turtleact.goals.server import LocalActionServer
from turtleact.goals.server_endpoints import ActionEndpoints
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
        transport: The connection to the graph.
        service: The name of the action's ``send_goal`` service.
        node: The fully qualified name of the node that wants to serve the action.
    """

    def __init__(self, transport: Transport, service: str, node: str) -> None:
        self._transport = transport
        self._service = service
        self._node = node

    def check(self, action: str, type_name: str, own_types: set[str]) -> None:
        """Raise an error if another node serves the action, or this node serves the same type.

        Args:
            action: The action's name.
            type_name: The type that this node wants to serve.
            own_types: The types that this node already serves under the name.

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
        """Return the name of another node that serves the action; None if there is none.

        The node of the built-in actions does not count, because it withdraws.
        """
        own = (self._node, BUILT_INS_NODE)
        return next((node for node in self._nodes() if node not in own), None)

    def holder(self) -> str | None:
        """Return the name of the node that this node must wait for; None if there is none.

        If this node has been restarted, the result may be this node's own name: a predecessor of
        this node, in another process, may still serve the action.
        """
        if self._node in self._nodes(is_local=False):
            return self._node
        return self.first()

    async def wait_until_free(self) -> None:
        """Wait until this node can serve the action. Cancelling: safe.

        If several processes wait, they all see at the same moment that a server has gone. Each
        process then waits for its own random time and looks again, so that only one of them begins
        to serve.
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
        """Return the names of the nodes that serve the action.

        If ``is_local`` is True, return only nodes of this process. If ``is_local`` is False, return
        only nodes of other processes.
        """
        return [
            endpoint.node
            for endpoint in self._transport.endpoints(self._service)
            if endpoint.kind == "service" and is_local in (None, self._is_local(endpoint.type_name))
        ]

    def _is_local(self, type_name: str) -> bool:
        """Whether this process serves the action with the type ``type_name``."""
        return bool(self._transport.local(self._service, type_name))


class ServedName:
    """Decides when an action server joins the graph, waits for other nodes, or withdraws.

    Args:
        server: The object that holds and runs the goals.
        endpoints: The endpoints that put the server on the graph.
        rivals: The other servers of the name.
        types_served: A function that returns the types that the server's node now serves under the
            name.
        restore: Called when the server begins to serve the name, to restore the server's goals.

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
        """Serve the name now, or when no other node serves the name.

        Args:
            on_conflict: What to do if another node serves the name. With "refuse", the caller has
                already checked that no other node serves the name. Only this node's predecessor,
                from an earlier process, may still serve the name. The server then waits until the
                predecessor has left the graph.
            again: Opens a new server with the same arguments. Called when this server has withdrawn
                and the name is free again.
        """
        if on_conflict == "withdraw":
            self._keep(self._make_way(again), "making way for others with")
        holder = self._rivals.holder()
        if holder is None:
            self._begin()
        elif on_conflict != "withdraw":
            logger.warning(
                "%s is served by %s: waiting until that node has gone", self._server.name, holder
            )
            self._keep(self._serve_once_free(), "waiting to serve")

    async def wait(self) -> bool:
        """Wait until the server serves the name. Return False if the server stops first.

        Cancelling: safe.
        """
        while self._server.is_open and not self.is_serving:
            await self._turned.wait()
        return self.is_serving

    async def aclose(self) -> None:
        """Accept no more goals, and no longer wait for other nodes."""
        self._stop()
        for running in self._running:
            await running.aclose()
        self._running.clear()

    def _keep(self, running: Coroutine[object, object, None], name: str) -> None:
        """Run a coroutine in the background. `aclose` cancels it."""
        self._running.append(Background(running, f"{name} {self._server.name}"))

    def _begin(self) -> None:
        self._endpoints.open()
        self._restore()
        self.is_serving = True
        self._turned.fire()

    def _stop(self) -> None:
        self._server.is_open = False
        self.is_serving = False
        self._turned.fire()

    async def _serve_once_free(self) -> None:
        """Wait until no other node serves the name, and then serve it."""
        await self._rivals.wait_until_free()
        logger.warning("%s is free: serving it now", self._server.name)
        self._begin()

    async def _make_way(self, again: Callable[[], object]) -> None:
        """Withdraw when another node serves the name, and serve the name again when it is free.

        A closed server cannot open again, so ``again`` opens a new server, which may withdraw in
        turn. The node tracks the old server until ``again`` is called. Closing the node therefore
        also ends this coroutine.
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
        InvalidOption: if the value is not one of `OnConflict`.
    """
    if given not in get_args(OnConflict):
        words = ", ".join(get_args(OnConflict))
        raise InvalidOption("on_conflict", f"expected one of {words}, not {given!r}")
