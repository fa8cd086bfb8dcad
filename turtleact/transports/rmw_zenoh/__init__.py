"""ROS 2 over Zenoh: a graph of several processes, including ROS 2 nodes with ``rmw_zenoh``."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.transport import ZenohTransport, open_zenoh

__all__ = ["ZenohTransport", "open_zenoh"]


def __getattr__(name: str) -> object:
    """Import the transport on first use, because code that only uses `census` does not need it."""
    if name in __all__:
        from turtleact.transports.rmw_zenoh import transport

        return getattr(transport, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
