"""A node's place on the graph: its name, and the service that describes its types."""

from __future__ import annotations

from turtleact.transports import MemoryTransport
from turtleact.transports.base import Closeable, Transport
from turtleact.type_descriptions import offer_descriptions

__all__ = ["Membership"]


class Membership:
    """Shows a node on the graph until it is closed.

    Args:
        transport: The graph.
        node: The fully qualified name of the node.
    """

    def __init__(self, transport: Transport, node: str) -> None:
        self._opened: list[Closeable] = [transport.enter(node)]
        if not isinstance(transport, MemoryTransport):  # one process has one definition of a type
            self._opened.append(offer_descriptions(transport, node))

    def close(self) -> None:
        """Leave the graph. A second call does nothing."""
        while self._opened:
            self._opened.pop().close()
