"""ROS 2's interfaces as rclpy programs know them: `geometry_msgs.msg` and the like.

These are other classes than turtleact's own, made from the same definitions: their fields are
properties, sequences of numbers are arrays, and nothing is checked before a message is sent.
"""
