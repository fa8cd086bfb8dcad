"""Makes the interface classes that rclpy programs use: `geometry_msgs.msg` and the like.

These classes differ from turtleact's own, but are made from the same definitions. Their fields are
properties, sequences of numbers are arrays, and nothing is checked before a message is sent.
"""
