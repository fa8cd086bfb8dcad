"""The code that the modules of rclpy share: event loop, graph, and the base class of entities.

Programs import a module of this package only if the genuine rclpy has the module, too. An example
is `rclpy.impl.implementation_singleton`.
"""
