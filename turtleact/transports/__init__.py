"""How messages travel between nodes; the names that are public."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.transports.base import QoS, Transport
from turtleact.transports.memory import MemoryTransport

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh import ZenohTransport, open_zenoh

__all__ = ["MemoryTransport", "QoS", "Transport", "ZenohTransport", "open_zenoh"]


def __getattr__(name: str) -> object:
    """Imports ``rmw_zenoh``, and with it Zenoh, when one of its names is first asked for."""
    if name in ("ZenohTransport", "open_zenoh"):
        from turtleact.transports import rmw_zenoh

        return getattr(rmw_zenoh, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
