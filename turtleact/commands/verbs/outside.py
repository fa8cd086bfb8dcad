"""Verbs and options of ``ros2`` that have no like here: what is said of them, if anything."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from turtleact.commands import VERBS

__all__ = ["NO_DAEMON", "problem_of_outside", "without_daemon"]

NO_DAEMON: Final = "The daemon is not running: each command asks the graph itself"
"""What ``daemon`` says, whatever is asked of it."""

_OUTSIDE: Final = {
    ("bag",): "'turtleact topic echo NAME --csv' prints messages a line each, to keep in a file",
    ("component",): "a node is a program, such as 'turtleact serve'",
    ("control",): "there are no controllers",
    ("doctor",): "'turtleact node list' tells whether there is a graph in reach",
    ("extension_points",): "there are no plug-ins",
    ("extensions",): "there are no plug-ins",
    ("launch",): "start each program by itself, such as 'turtleact serve'",
    ("lifecycle",): "there are no managed nodes",
    ("multicast",): "nodes find each other through a router, such as 'turtleact serve'",
    ("pkg",): "'turtleact interface packages' lists what has interfaces; nothing is built",
    ("security",): "'turtleact serve --config FILE' says who may come in",
    ("service", "echo"): "its nodes tell nobody of their calls; 'turtleact service call' makes one",
    ("wtf",): "'turtleact node list' tells whether there is a graph in reach",
}
"""The verbs, and what there is instead."""

_WORDS: Final = re.compile(r"\b[a-z]+(?=[,.])")
"""The verbs of a group, as `VERBS` lists them behind a colon; ``send_goal`` is one of ours too."""


def problem_of_outside(arguments: Sequence[str]) -> str:
    """What a command line asks for that ``ros2`` has, and turtleact not, or elsewhere; else empty.

    >>> problem_of_outside(["hz", "/turtle1/pose"])
    "no such command 'hz', did you mean 'topic hz'?"
    """
    for verb, instead in _OUTSIDE.items():
        if tuple(arguments[: len(verb)]) == verb:
            return f"'{' '.join(verb)}' is not part of turtleact: {instead}"
    first = arguments[0]
    groups = [
        each for each, text in VERBS.items() if first in _WORDS.findall(text.partition(":")[2])
    ]
    meant = " or ".join(f"'{each} {first}'" for each in groups)
    return f"no such command '{first}', did you mean {meant}?" if meant else ""


def without_daemon(args: Sequence[str]) -> list[str]:
    """Arguments without those by which ros2 is told how to look at the graph: it is always asked.

    >>> without_daemon(["--no-daemon", "--spin-time", "2", "-t", "--spin-time=1"])
    ['-t']
    """
    kept: list[str] = []
    left = iter(args)
    for arg in left:
        if arg == "--spin-time":
            next(left, None)
        elif arg != "--no-daemon" and not arg.startswith("--spin-time="):
            kept.append(arg)
    return kept
