"""Contains the commands: a module for each group of verbs, and modules that several share.

``turtleact --help`` and the completion of verbs use only the tables in this module and `app`, and
import no verb.
"""

from __future__ import annotations

from typing import Final

__all__ = ["GROUPS", "VERBS"]

GROUPS: Final = {
    "action": ("send_goal", "list", "info", "type", "find", "echo"),
    "topic": ("list", "info", "type", "find", "echo", "hz", "bw", "delay", "pub"),
    "service": ("list", "info", "type", "find", "call", "echo"),
    "node": ("list", "info"),
    "param": ("list", "get", "set", "delete", "describe", "dump", "load"),
    "pkg": ("create", "list", "executables"),
    "interface": ("list", "package", "packages", "proto", "fetch", "python", "show"),
    "bag": ("record", "info", "play", "goals", "convert", "view"),
    "journal": ("prune",),
}
"""The groups of verbs. ``ros2`` has all of these groups except ``journal``."""

VERBS: Final = {
    "send-goal": "Send a goal, follow it to its end and print the result.",
    "goals": "List the goals that the servers hold.",
    "cancel": "Cancel goals, no matter which client sent them.",
    "pause": "Pause goals: their bodies stand still until they are resumed.",
    "resume": "Let paused goals go on.",
    "watch": "Print the feedback of a goal, then its result.",
    "result": "Wait for the result of a goal and print it.",
    "journal": "Delete old goals from a journal: prune.",
    "serve": "Serve a world of turtles, and your own actions.",
    "run": "Run a program of a package, such as turtlesim turtlesim_node, or a file.",
    "mcp": "Offer actions as tools to a language model.",
    "teleop": "Drive a turtle with the keyboard.",
    "snapshot": "Save a picture of the world as PNG or SVG.",
    "doctor": "Find out what is wrong with the graph, and what to do about it.",
    **{
        name: f"Like 'ros2 {name}': {', '.join(verbs)}."
        for name, verbs in GROUPS.items()
        if name != "journal"
    },
}
"""A line about each verb, in the order of ``turtleact --help``."""
