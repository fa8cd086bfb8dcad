"""A node's place on the graph: its name, and the service that describes its types."""

from __future__ import annotations

from turtleact.transports.base import Closeable, Lazy, Transport
from turtleact.type_descriptions import offer_descriptions, service_name

__all__ = ["Membership"]


class Membership:
    """Shows a node on the graph until it is closed.

    Args:
        transport: The graph.
        node: The fully qualified name of the node.
    """

    __slots__ = ("_node", "_opened", "_transport")

    def __init__(self, transport: Transport, node: str) -> None:
        self._transport = transport
        self._node = node
        self._opened: list[Closeable] = [transport.enter(node)]
        if isinstance(transport, Lazy):  # within one process, nobody needs it
            self._opened.append(transport.open_when_sought(service_name(node), self._offer))

    def close(self) -> None:
        """Leave the graph. A second call does nothing."""
        while self._opened:
            self._opened.pop().close()

    def _offer(self) -> Closeable:
        return offer_descriptions(self._transport, self._node)
