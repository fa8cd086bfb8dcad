"""What the modules of rclpy share: the event loop, the graph, and the parts of every entity.

Programs do not import from here, except `rclpy.impl.implementation_singleton` and its siblings,
which some programs know from rclpy.
"""
