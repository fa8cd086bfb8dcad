"""The world of turtlesim: turtles as plain Python objects, and the node that serves them.

These modules depend on neither ROS nor a clock:

- `world` keeps the turtles by name, and applies commands, teleports and walls.
- `start_poses` chooses where turtles start.
- `kinematics` moves a few turtles by one step. `fleet` moves many turtles, and finds the turtles
  that block each other.
- `drawing` has the turtles' pens, and draws their lines on a `canvas`. `rasterising` draws the
  lines of many turtles. `pictures` turns a drawing into SVG and PNG.

These modules make the world a ROS node:

- `turtlesim` is the node of the world. It has one `turtle` for each turtle of the world.
- `world_services` adds what the original turtlesim does not have: control of time, all poses at
  once, pictures.
"""
