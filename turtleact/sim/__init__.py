"""A world: turtlesim's, without ROS.

`kinematics` and `fleet` move turtles by one step, few or many; `world` gives them names, walls and
commands. None of the three knows ROS or a clock; `turtlesim`, above them, is the world as a node.
"""
