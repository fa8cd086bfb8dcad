"""How messages travel between nodes; the names that are public."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.transports.base import QoS, Transport

if TYPE_CHECKING:
    from turtleact.transports.memory import MemoryTransport
    from turtleact.transports.rmw_zenoh import ZenohTransport, open_zenoh

__all__ = ["MemoryTransport", "QoS", "Transport", "ZenohTransport", "open_zenoh"]


def __getattr__(name: str) -> object:
    """Imports a transport, ``rmw_zenoh`` with Zenoh, when one of its names is first asked for."""
    if name == "MemoryTransport":
        from turtleact.transports.memory import MemoryTransport

        return MemoryTransport
    if name in ("ZenohTransport", "open_zenoh"):
        from turtleact.transports import rmw_zenoh

        return getattr(rmw_zenoh, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
