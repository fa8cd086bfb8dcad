"""The size of the world, steps, commands and places, and the places of turtles at the start.

As in turtlesim, y is stored as the depth below the upper edge, and half a turn is 3.14159265.
Numbers from messages are rounded to float32, as in turtlesim. This module uses neither ROS nor a
clock, and no numpy, because commands need it at their start. All randomness comes from a seed.

The first turtles of a world are placed in one of the ways in `PLACINGS`:

- ``random``: the first turtle in the middle, looking along x, and the others spread evenly over the
  square. The place and heading of each turtle depend only on its number and the seed.
- ``grid``: in a square grid, row by row from the lower left, all looking along x.
- ``ring``: on a circle around the middle, counterclockwise from the right, each turtle looking
  along the circle.

All these places are at least a metre away from the walls.

Source: turtlesim 1.8.2, ``turtle.cpp`` and ``TurtleFrame::spawnTurtle``.
"""

from __future__ import annotations

import math
from array import array
from typing import Final, NamedTuple

from turtleact.errors import SimError

__all__ = [
    "COMMAND_TICKS",
    "DT",
    "HALF_TURN",
    "MIDDLE",
    "PLACINGS",
    "SIDE",
    "Hit",
    "Place",
    "check_finite",
    "place_ahead",
    "place_at",
    "starts",
    "to_float32",
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


class Place(NamedTuple):
    """A place to put a turtle: x (m), depth below the upper edge (m), theta (rad, any angle)."""

    x: float
    depth: float
    theta: float


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


MIDDLE = Place(SIDE / 2.0, SIDE / 2.0, 0.0)
"""Where turtlesim puts its first turtle."""

PLACINGS: Final = ("random", "grid", "ring")
"""The ways to place the turtles of a new world."""

_MARGIN = 1.0
"""The minimum distance between the walls and the places from `starts` (m)."""


def place_at(x: float, y: float, theta: float) -> Place:
    """Return the place of a spawned turtle, with all numbers rounded to float32."""
    x, y, theta = array("f", (x, y, theta))
    (depth,) = array("f", (SIDE - y,))
    return Place(x, depth, theta)


def place_ahead(start: Place, linear: float, angular: float) -> Place:
    """Return where a turtle is after turning by an angle (rad), then moving straight on (m)."""
    theta = start.theta + angular
    x = start.x + math.cos(theta) * linear
    return Place(x, start.depth - math.sin(theta) * linear, theta)


def starts(count: int, placing: str = "random", seed: int = 0) -> list[Place]:
    """Where the turtles of a world start, in the order of their numbers from 1 on.

    Args:
        count: How many turtles there are. A single turtle always starts in the middle.
        placing: One of `PLACINGS`.
        seed: Changes the places of all turtles except the first, if ``placing`` is ``random``.

    Raises:
        SimError: if ``placing`` is not one of `PLACINGS`.
    """
    if placing not in PLACINGS:
        raise SimError(f"turtles cannot be placed as '{placing}': give {', '.join(PLACINGS)}")
    if placing == "random" or count == 1:
        return [MIDDLE, *(_spread(number, seed) for number in range(2, count + 1))]
    place = _in_grid if placing == "grid" else _on_ring
    return [place(index, count) for index in range(count)]


def _in_grid(index: int, count: int) -> Place:
    rows = math.isqrt(count - 1) + 1
    up, right = divmod(index, rows)
    cell = (SIDE - 2.0 * _MARGIN) / rows
    return place_at(_MARGIN + (right + 0.5) * cell, _MARGIN + (up + 0.5) * cell, 0.0)


def _on_ring(index: int, count: int) -> Place:
    middle, angle = SIDE / 2.0, math.tau * index / count
    radius = middle - _MARGIN
    x, y = middle + radius * math.cos(angle), middle + radius * math.sin(angle)
    return place_at(x, y, math.remainder(angle + math.pi / 2.0, math.tau))


def _spread(number: int, seed: int) -> Place:
    """Return the place of one turtle.

    The places are spread evenly over the square, for any number of turtles.

    Source: Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, R3.
    """
    u, v, w = (
        (number * step + seed * shift) % _WHOLE / _WHOLE
        for step, shift in zip(_SPREAD, _SHIFT, strict=True)
    )
    width = SIDE - 2.0 * _MARGIN
    return place_at(_MARGIN + u * width, _MARGIN + v * width, (2.0 * w - 1.0) * math.pi)


# Fractions are whole numbers of 2**-64, so that any seed is exact. The steps of the sequence are
# g**-1, g**-2 and g**-3, where g**4 = g + 1; the shifts are odd and unrelated.
_WHOLE = 2**64
_SPREAD = tuple(int(1.2207440846057596**-power * _WHOLE) for power in (1, 2, 3))
_SHIFT = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)


def to_float32(turtle: str, **numbers: float) -> array[float]:
    """Round numbers for a turtle to float32. The keywords are the names of the numbers.

    Raises:
        SimError: if a number is not finite in float32. The error names the first such number.
    """
    rounded = array("f", numbers.values())
    check_finite(turtle, **dict(zip(numbers, rounded, strict=True)))
    return rounded


def check_finite(turtle: str, **numbers: float) -> None:
    """Check that numbers for a turtle are finite. The keywords are the names of the numbers.

    Raises:
        SimError: if a number is not finite. The error names the first such number.
    """
    for what, value in numbers.items():
        if not math.isfinite(value):
            raise SimError(f"{what} is {value}: give a finite number", turtle=turtle)
