"""The world of turtlesim: turtles as plain Python objects, and the nodes that serve them.

These modules depend on neither ROS nor a clock:

- `world` keeps the turtles by name, and moves them by commands, teleports, walls and collisions.
  `kinematics` has the constants and types of a step, and chooses where turtles start.
- `drawing` has the turtles' pens, and draws their lines. `pictures` has the sizes and colours of
  pictures, and turns a drawing into SVG and PNG.

These modules make the world a ROS node:

- `turtlesim` is the node of the world. It has one `turtle` for each turtle of the world.
- `world_services` adds what the original turtlesim does not have: control of time, all poses at
  once, pictures.
- `world_node` has `open_world`, which also puts the built-in actions in.
"""
