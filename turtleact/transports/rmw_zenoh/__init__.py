"""ROS 2 on Zenoh: a graph that reaches other processes and the nodes of ROS 2's ``rmw_zenoh``."""

from turtleact.transports.rmw_zenoh.transport import ZenohTransport, open_zenoh

__all__ = ["ZenohTransport", "open_zenoh"]
