"""Carries messages between nodes. The public names are exported here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.transports.base import QoS, Transport

if TYPE_CHECKING:
    from turtleact.transports.memory import MemoryTransport
    from turtleact.transports.rmw_zenoh.transport import ZenohTransport, open_zenoh

__all__ = ["MemoryTransport", "QoS", "Transport", "ZenohTransport", "open_zenoh"]


def __getattr__(name: str) -> object:
    """Import a transport on first use, so that Zenoh is loaded only when needed."""
    if name == "MemoryTransport":
        from turtleact.transports.memory import MemoryTransport

        return MemoryTransport
    if name in ("ZenohTransport", "open_zenoh"):
        from turtleact.transports.rmw_zenoh import transport

        return getattr(transport, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
