"""rclpy without ROS: the package that ``import rclpy`` imports in programs that turtleact runs.

Nothing of turtleact imports this package except the commands that run such programs. Modules have
rclpy's names. `toplevel` holds the functions of ``rclpy`` itself. `impl` holds code that the
modules share. `messages` makes the classes of ``std_msgs.msg`` and the like, and `finder` makes all
modules importable. `face` decides whether to use the genuine rclpy instead. `program` prepares a
process for a program.

Source: rclpy 9.1 for names and behaviour; the ROS 2 design articles.
"""
