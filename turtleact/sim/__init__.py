"""A world of turtles: turtlesim's, first without ROS and then as a node.

Without ROS and without a clock:

- `world`: turtles by name that come and go, commands, teleports, walls; `start_poses` says where
  turtles are put.
- `kinematics` moves a few turtles by one step, `fleet` many; `fleet` also says who stops whom.
- `drawing`: the pens of the turtles and what they draw, as lines and on a `canvas`; `rasterising`
  does the same for a fleet; `pictures` turns a drawing into SVG and PNG.

As a node:

- `turtlesim` is the world, with a `turtle` for each of its turtles.
- `world_services` is what the world offers beyond turtlesim: time, all poses, pictures.
"""
