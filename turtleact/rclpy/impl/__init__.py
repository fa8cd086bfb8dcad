"""The code that the modules of rclpy share: the event loop, the graph, and the base of entities.

Programs do not import from here, except `rclpy.impl.implementation_singleton` and its siblings,
which some programs know from rclpy.
"""
