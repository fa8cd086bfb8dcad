"""What a step of a turtle is made of: its length, the size of the world, commands and places.

As in turtlesim, y is stored as the depth below the upper edge, and half a turn is 3.14159265. This
module imports no numpy, because commands need it at their start.

Source: turtlesim 1.8.2, ``turtle.cpp``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = [
    "COMMAND_TICKS",
    "DT",
    "HALF_TURN",
    "NEVER",
    "SIDE",
    "Command",
    "Hit",
    "Place",
    "State",
    "wrap",
]

DT = 0.016
"""Length of a step (s)."""

SIDE = 11.088889122009277
"""Width and height of the world (m): 499/45 in float32."""

COMMAND_TICKS = 63
"""How many ticks a command lasts.

In the 64th tick, the command would be 1.008 s old, and turtlesim drops commands older than 1.0 s.
"""


NEVER = 2**62
"""The number of a tick that never comes."""


class Command(NamedTuple):
    """A turtle's speeds: ahead (m/s), to the left (m/s), and turning to the left (rad/s)."""

    vx: float
    vy: float
    omega: float


class Place(NamedTuple):
    """A place to put a turtle: x (m), depth below the upper edge (m), theta (rad, any angle)."""

    x: float
    depth: float
    theta: float


class State(NamedTuple):
    """The place and the speeds of a turtle, not rounded.

    After a step, x and depth (m) are in [0, SIDE], and theta (rad) is in [-pi, pi). The speeds are
    the values of the turtle's command, or 0 if the turtle has no command.
    """

    x: float
    depth: float
    theta: float
    vx: float
    vy: float
    omega: float


class Hit(NamedTuple):
    """A turtle that has hit a wall in a step.

    ``turtle`` is the turtle's index. ``x`` and ``depth`` (m) are where the turtle would be without
    the wall.
    """

    turtle: int
    x: float
    depth: float


HALF_TURN = 3.14159265
"""Half a turn (rad), as in turtlesim."""


def wrap(theta: float) -> float:
    """Shift a finite angle (rad) by whole turns into [-HALF_TURN, HALF_TURN), as in turtlesim.

    Source: ``normalizeAngle`` in ``turtle.cpp``.
    """
    turn = 2.0 * HALF_TURN
    wrapped = theta - turn * math.floor((theta + HALF_TURN) / turn)
    # For huge angles the difference itself is rounded, and may miss the range by little or by much.
    return wrapped if -HALF_TURN <= wrapped < HALF_TURN else -HALF_TURN
