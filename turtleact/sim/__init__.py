"""The world of turtlesim: turtles as plain Python objects, and the node that serves them.

Without ROS and without a clock:

- `world`: turtles by name, which come and go, commands, teleports and walls; `start_poses` chooses
  where turtles start.
- `kinematics` moves a few turtles by one step, `fleet` many; `fleet` also finds the turtles that
  block each other.
- `drawing`: the pens of the turtles and what they draw, as lines and on a `canvas`; `rasterising`
  draws the lines of a fleet; `pictures` turns a drawing into SVG and PNG.

As a node:

- `turtlesim` is the world, with a `turtle` for each of its turtles.
- `world_services` offers more than turtlesim does: control of time, all poses, pictures.
"""
