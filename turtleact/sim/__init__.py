"""A world: turtlesim's, without ROS.

`kinematics` and `fleet` move turtles by one step, few or many; `world` gives them walls and
commands and lets them come and go, `roster` has their names, `placing` says where they are put,
`rotation` how one turns to a heading, `collisions` who stands in whose way. `pens` follows them
over a `drawing`, which is kept as lines and on a `canvas` (`runs` and `strips`: of a fleet);
`snapshot` makes pictures. None of these knows ROS or a clock.

`turtlesim`, above them, is the world as a node, with `turtle` for each of its turtles, `parameters`
for its own, `ticking` for when it steps, `simulation` for those who rule that, `poses` and
`pictures` for those who look on.
"""
