"""One node serves an action name. What becomes of a second one.

A node may declare several types under one name, as ``/fibonacci`` does. If two nodes served the
same name, every goal would run twice: ROS 2 sends a request to all servers of a service.

- ``refuse``: the second node's `action_server` raises, with the first one's name.
- ``wait``: the second node begins to serve once the first has gone; for restarts and failover.
- ``withdraw``: a built-in action makes way as soon as another node serves its name, in any process.
  Its running goals finish.

A restarted node may still see its predecessor, a node of the same name whose process died a moment
ago and whose lease has not run out. It is not refused: it waits until the predecessor has gone.

Across processes all this rests on discovery: a server that has not been seen yet does not count.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Literal, TypeAlias

from turtleact.errors import ActionConflict
from turtleact.transports.base import Transport

__all__ = ["BUILT_INS_NODE", "OnConflict", "Rivals"]

logger = logging.getLogger("turtleact.server")

OnConflict: TypeAlias = Literal["refuse", "wait", "withdraw"]

BUILT_INS_NODE = "/turtle_actions"
"""The node of the built-in actions, in whatever process: it makes way for every other."""


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
            type_name: The type to be served.
            own_types: The types that this very node serves under the name.

        Raises:
            ActionConflict: names the node that serves the action.
        """
        if type_name in own_types:
            raise ActionConflict(action, self._node)
        other = self.first()
        if other is None and not own_types and self._node in self._nodes(is_local=True):
            other = self._node  # another node of this name in the same process
        if other is not None:
            raise ActionConflict(action, other)

    def first(self) -> str | None:
        """The first other node that serves the action; None if there is none.

        Built-ins do not count: they make way.
        """
        own = (self._node, BUILT_INS_NODE)
        return next((node for node in self._nodes() if node not in own), None)

    def holder(self) -> str | None:
        """The node that has to go before this one can serve the action; None if it is free.

        It may have this node's own name, if that is seen in another process: a predecessor.
        """
        if self._node in self._nodes(is_local=False):
            return self._node
        return self.first()

    def has_built_in(self) -> bool:
        """Whether a built-in action in another process has to make way for this one."""
        return self._node != BUILT_INS_NODE and BUILT_INS_NODE in self._nodes(is_local=False)

    async def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition on the graph holds. Cancelling: safe."""
        while not condition():
            await self._transport.wait_for_change()

    def _nodes(self, *, is_local: bool | None = None) -> list[str]:
        """The nodes that serve the action: all, or those in this process, or those elsewhere."""
        return [
            endpoint.node
            for endpoint in self._transport.endpoints(self._service)
            if endpoint.kind == "service" and is_local in (None, self._is_local(endpoint.type_name))
        ]

    def _is_local(self, type_name: str) -> bool:
        """Whether the service is offered in this process under a type."""
        return self._transport.local(self._service, type_name) is not None
