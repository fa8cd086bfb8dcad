"""The code that the modules of rclpy share: event loop, graph, and the base class of entities.

Programs should import only the modules that the genuine rclpy also has, such as
`rclpy.impl.implementation_singleton`.
"""
