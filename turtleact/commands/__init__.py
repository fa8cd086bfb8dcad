"""The verbs of the command line.

Each is declared in `turtleact.commands.verbs`; these tables alone are what ``turtleact --help``
needs, so that it answers before Typer could be imported.
"""

from __future__ import annotations

from typing import Final

__all__ = ["OPTIONS", "VERBS"]

VERBS: Final = {
    "send-goal": "Send a goal, follow it to its end, print the result.",
    "serve": "Serve a world of turtles and your own actions, to this machine or beyond.",
    "run": "Run a program of ROS 2 that has its like here, such as turtlesim turtlesim_node.",
    "teleop": "Drive a turtle with the keys of turtle_teleop_key.",
    "snapshot": "Write a picture of the world in reach, as PNG or SVG.",
    "goals": "List the goals that servers hold.",
    "cancel": "Cancel goals, whoever has sent them.",
    "watch": "Print the feedback of a goal, then its result.",
    "result": "Print the result of a goal, once there is one.",
    "action": "The verbs of 'ros2 action': send_goal, list, info, type, find, echo.",
    "topic": "The verbs of 'ros2 topic': list, info, type, find, echo, pub, hz, bw, delay.",
    "service": "The verbs of 'ros2 service': list, info, type, find, call.",
    "node": "The verbs of 'ros2 node': list, info.",
    "param": "The verbs of 'ros2 param': list, get, set, delete, describe, dump, load.",
    "interface": "The verbs of 'ros2 interface': list, package, packages, proto, show.",
}
"""What there is, and what it does."""

OPTIONS: Final = {
    "--version": "Print the version.",
    "--install-completion": "Let bash, zsh or fish complete the command line.",
    "--show-completion": "Print what --install-completion would tell that shell.",
    "-h, --help": "Show this message and exit.",
}
"""What may stand in the place of a verb, and what it does."""
