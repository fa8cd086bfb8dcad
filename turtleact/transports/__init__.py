"""How messages travel between nodes; the names that are public."""

from turtleact.transports.base import QoS, Transport
from turtleact.transports.memory import MemoryTransport

__all__ = ["MemoryTransport", "QoS", "Transport"]
