"""The places of turtles at the start, after a spawn, and after a teleport.

The first turtles of a world are placed in one of the ways in `PLACINGS`:

- ``random``: the first turtle in the middle, looking along x, and the others spread evenly over the
  square. The place and heading of each turtle depend only on its number and the seed.
- ``grid``: in a square grid, row by row from the lower left, all looking along x.
- ``ring``: on a circle around the middle, counterclockwise from the right, each turtle looking
  along the circle.

All these places are at least a metre away from the walls. Numbers from messages are rounded to
float32, as in turtlesim. This module uses neither ROS nor a clock. All randomness comes from a
seed.

Source: turtlesim 1.8.2, ``TurtleFrame::spawnTurtle`` and ``Turtle::update``.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from turtleact.errors import SimError
from turtleact.sim.kinematics import SIDE, Place

if TYPE_CHECKING:
    from turtleact.sim.kinematics import State

__all__ = [
    "MIDDLE",
    "PLACINGS",
    "Absolute",
    "Relative",
    "Spawn",
    "Teleport",
    "check_finite",
    "starts",
]

MIDDLE = Place(SIDE / 2.0, SIDE / 2.0, 0.0)
"""Where turtlesim puts its first turtle."""

PLACINGS: Final = ("random", "grid", "ring")
"""The ways to place the turtles of a new world."""

_MARGIN = 1.0
"""The minimum distance between the walls and the places from `starts` (m)."""


class Teleport(Protocol):
    """A request to put a turtle somewhere else."""

    def place_after(self, state: State) -> Place:
        """Where the turtle is after the teleport."""

    def _asdict(self) -> dict[str, float]: ...


class Absolute(NamedTuple):
    """A teleport to a place: x, y (m) and theta (rad)."""

    x: float
    y: float
    theta: float

    @classmethod
    def of(cls, x: float, y: float, theta: float) -> Absolute:
        """Make a teleport from the values of a request, rounded to float32."""
        return cls(*array("f", (x, y, theta)))

    def place_after(self, state: State) -> Place:  # noqa: ARG002  # wherever it was
        """Where the turtle is after the teleport."""
        return Place(self.x, max(0.0, SIDE - self.y), self.theta)


class Relative(NamedTuple):
    """A teleport that turns a turtle by an angle (rad), then moves it along the new heading (m)."""

    linear: float
    angular: float

    @classmethod
    def of(cls, linear: float, angular: float) -> Relative:
        """Make a teleport from the values of a request, rounded to float32."""
        return cls(*array("f", (linear, angular)))

    def place_after(self, state: State) -> Place:
        """Where the turtle is after the teleport."""
        theta = state.theta + self.angular
        x = state.x + math.cos(theta) * self.linear
        return Place(x, state.depth - math.sin(theta) * self.linear, theta)


class Spawn(NamedTuple):
    """A place for a new turtle: x, y (m) and theta (rad)."""

    x: float
    y: float
    theta: float

    @classmethod
    def of(cls, x: float, y: float, theta: float) -> Spawn:
        """Make a `Spawn` from the values of a request, rounded to float32."""
        return cls(*array("f", (x, y, theta)))

    @property
    def place(self) -> Place:
        """The turtle's place. Its depth below the upper edge is rounded to float32."""
        (depth,) = array("f", (SIDE - self.y,))
        return Place(self.x, depth, self.theta)


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
    return Spawn.of(_MARGIN + (right + 0.5) * cell, _MARGIN + (up + 0.5) * cell, 0.0).place


def _on_ring(index: int, count: int) -> Place:
    middle, angle = SIDE / 2.0, math.tau * index / count
    radius = middle - _MARGIN
    x, y = middle + radius * math.cos(angle), middle + radius * math.sin(angle)
    return Spawn.of(x, y, math.remainder(angle + math.pi / 2.0, math.tau)).place


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
    return Spawn.of(_MARGIN + u * width, _MARGIN + v * width, (2.0 * w - 1.0) * math.pi).place


# Fractions are whole numbers of 2**-64, so that any seed is exact. The steps of the sequence are
# g**-1, g**-2 and g**-3, where g**4 = g + 1; the shifts are odd and unrelated.
_WHOLE = 2**64
_SPREAD = tuple(int(1.2207440846057596**-power * _WHOLE) for power in (1, 2, 3))
_SHIFT = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)


def check_finite(turtle: str, **numbers: float) -> None:
    """Check that numbers for a turtle are finite. The keywords are the names of the numbers.

    Raises:
        SimError: if a number is not finite. The error names the first such number.
    """
    for what, value in numbers.items():
        if not math.isfinite(value):
            raise SimError(f"{what} is {value}: give a finite number", turtle=turtle)
