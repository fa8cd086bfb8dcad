"""ROS 2 over Zenoh: a graph of several processes, including ROS 2 nodes with ``rmw_zenoh``."""
