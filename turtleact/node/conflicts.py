"""Ensures that only one node serves an action name, and decides what happens to a second one.

A node may serve several types under one name, as it does for ``/fibonacci``. But if two nodes
served the same name, every goal would run twice, because ROS 2 sends a request to all servers of a
service. A second node chooses what happens:

- ``refuse``: its `action_server` raises and names the first node.
- ``wait``: it begins to serve when the first node has gone; useful for restarts and failover.
- ``withdraw``: it withdraws when any other node, in any process, serves the name. Its running goals
  finish. When no other node serves the name any more, it serves it again. The built-in actions do
  this.

A restarted node may still see its predecessor: a node of the same name whose process has just died
and whose lease has not run out. Such a node is not refused. It waits until the predecessor is gone.

Across processes, all of this depends on discovery: a server counts only once it has been seen.
"""

from __future__ import annotations

import logging
import random
from collections.abc import Callable
from typing import Literal, TypeAlias

import anyio

from turtleact.errors import ActionConflict
from turtleact.transports.base import Transport

__all__ = ["BUILT_INS_NODE", "OnConflict", "Rivals", "tell_of_built_in"]

logger = logging.getLogger("turtleact.server")

OnConflict: TypeAlias = Literal["refuse", "wait", "withdraw"]

BUILT_INS_NODE = "/turtle_actions"
"""The node of the built-in actions in every process; it withdraws in favour of any other node."""


STAGGER = random.uniform(0.0, 0.5)  # noqa: S311  # not for security
"""How long this process waits before it takes over from another process (s, event loop time)."""


class Rivals:
    """The other servers of one action name, as far as discovery shows them.

    Args:
        transport: The graph.
        service: The name of the action's ``send_goal`` service.
        node: The fully qualified name of the node that wants to serve it.
    """

    def __init__(self, transport: Transport, service: str, node: str) -> None:
        self._transport = transport
        self._service = service
        self._node = node

    def check(self, action: str, type_name: str, own_types: set[str]) -> None:
        """Raise if another node serves the action, or this one under the same type.

        Args:
            action: The action's name.
            type_name: The type that the node wants to serve.
            own_types: The types that the node already serves under the name.

        Raises:
            ActionConflict: with the name of the node that serves the action.
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
        """Return the node that must go before this one can serve; None if the name is free.

        The holder may have this node's own name if it is in another process: a predecessor.
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

    async def look_for_built_in(self, action: str, seconds: float) -> None:
        """Log it if discovery shows a built-in action within some seconds. Cancelling: safe."""
        with anyio.move_on_after(seconds):
            await self.wait_until(self.has_built_in)
            tell_of_built_in(action)

    async def wait_until_free(self) -> None:
        """Wait until this node can serve the action. Cancelling: safe.

        Standbys in several processes all see at the same moment that a server has gone. Each then
        waits for a time of its own and looks again, so that only the first one takes over.
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
        """List the nodes that serve the action: all, only local ones, or only remote ones."""
        return [
            endpoint.node
            for endpoint in self._transport.endpoints(self._service)
            if endpoint.kind == "service" and is_local in (None, self._is_local(endpoint.type_name))
        ]

    def _is_local(self, type_name: str) -> bool:
        """Whether this process serves the service under that type."""
        return self._transport.local(self._service, type_name) is not None


def tell_of_built_in(action: str) -> None:
    """Log that the built-in action makes way for one of this process."""
    logger.warning("%s: the built-in action makes way for this one", action)
