"""The code that the modules of rclpy share: event loop, graph, and the base class of entities.

Programs import only those modules of this package that the genuine rclpy also has, such as
`rclpy.impl.implementation_singleton`.
"""
