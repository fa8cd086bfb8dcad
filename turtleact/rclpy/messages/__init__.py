"""Makes the interface classes that rclpy programs use, such as those of `geometry_msgs.msg`.

These classes differ from turtleact's own, but are made from the same definitions. Their fields are
properties, and their sequences of numbers are arrays. Values are not checked until a message is
sent, unless ``check_fields`` is true.
"""
