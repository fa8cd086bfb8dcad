"""rclpy without ROS: ``import rclpy`` imports this package in programs that turtleact runs.

Only the commands that run such programs import this package. Most modules have the same names as in
rclpy. The other modules include:

- `toplevel` holds the functions of ``rclpy`` itself.
- `impl` holds code that the modules share.
- `messages` makes the classes of ``std_msgs.msg`` and other message packages.
- `finder` lets a program import these modules and classes under their names in ROS 2.
- `face` decides whether a program gets the genuine rclpy instead of this package.
- `program` prepares a process for a program that imports rclpy.

Source: rclpy 9.1 for names and behaviour; the ROS 2 design articles.
"""
