"""rclpy without ROS: what ``import rclpy`` finds in programs that turtleact runs.

Nothing of turtleact imports this package except the commands that run such programs. Modules have
rclpy's names; `toplevel` holds what is in ``rclpy`` itself. `impl` has what they share. `messages`
makes the classes of ``std_msgs.msg`` and the like, `finder` makes all of them importable, `face`
decides whether the genuine rclpy is used instead, and `program` prepares a process for a program.

Source: rclpy 9.1 for names and behaviour; the ROS 2 design articles.
"""
