"""ROS 2 on Zenoh: a graph that reaches other processes and the nodes of ROS 2's ``rmw_zenoh``."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.transport import ZenohTransport, open_zenoh

__all__ = ["ZenohTransport", "open_zenoh"]


def __getattr__(name: str) -> object:
    """Imports the transport when it is first asked for: a `census` does without."""
    if name in __all__:
        from turtleact.transports.rmw_zenoh import transport

        return getattr(transport, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
