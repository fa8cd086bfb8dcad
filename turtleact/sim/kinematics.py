"""One step of a turtle: drop an expired command, turn, move, stop at the walls.

The numbers and the order of the operations are turtlesim's, so that Poses equal turtlesim's to the
last bit. As in turtlesim, y is stored as the depth below the upper edge, and half a turn is
3.14159265. A Pose is rounded to float32 only when it is read. `Handful` moves a few turtles with
plain floats; `turtleact.sim.fleet` moves many turtles with arrays. This module knows no names, no
ROS and no clock: it counts time in ticks.

Source: turtlesim 1.8.2, ``Turtle::update`` in ``turtle.cpp``; for arcs Lynch and Park, Modern
Robotics, section 13.3.1, the integral of a constant twist.
"""

from __future__ import annotations

import enum
import math
from math import cos, sin
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy as np
    import numpy.typing as npt

__all__ = [
    "COMMAND_TICKS",
    "DT",
    "NEVER",
    "SIDE",
    "Command",
    "Handful",
    "Hit",
    "Hits",
    "Place",
    "State",
    "StepRule",
    "Turtles",
    "chord",
    "displacement",
    "half_turn",
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


class StepRule(enum.Enum):
    """How a step turns speeds into motion."""

    EULER = "euler"
    """turtlesim's rule: first turn, then move straight along the new heading."""

    ARC = "arc"
    """The exact motion at constant speeds: the turtle moves along an arc."""


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


Hits: TypeAlias = "Sequence[Hit]"
"""The turtles that hit a wall in one step, in the order of their indices; usually none."""


class Turtles(Protocol):
    """The interface of `Handful` and ``Fleet``.

    The methods access turtles by index. `step` moves all turtles by one time step.
    """

    def __len__(self) -> int: ...

    def drive(self, commands: Mapping[int, Command], tick: int) -> None:
        """Give commands to turtles; the keys are the indices of the turtles.

        A command lasts ``COMMAND_TICKS`` ticks from ``tick`` on.
        """

    def drive_all(self, speeds: npt.NDArray[np.float64], tick: int) -> None:
        """Give every turtle a command. ``speeds`` has shape (3, N), with rows as in `Command`."""

    def place(self, index: int, place: Place) -> None:
        """Place a turtle.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """

    def insert(self, index: int, place: Place) -> None:
        """Insert a turtle at rest at this index.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """

    def remove(self, index: int) -> None:
        """Remove a turtle."""

    def state(self, index: int) -> State:
        """The state of one turtle."""

    def columns(self) -> Sequence[npt.ArrayLike]:
        """The states of all turtles: N numbers for each field of `State`."""

    def places(self) -> Sequence[complex]:
        """A copy of all turtles' positions, as complex numbers ``x + 1j * depth`` (m)."""

    def orders(self) -> list[tuple[State, int]]:
        """The state of each turtle, and the tick in which its command expires.

        The tick is `NEVER` if the turtle has no command.
        """

    def step(self, tick: int) -> Hits:
        """Move all turtles by one step, which completes tick number ``tick``.

        Returns:
            The turtles that hit a wall, in the order of their indices; usually none.
        """


def displacement(
    theta: float, vx: float, vy: float, chord: tuple[float, float]
) -> tuple[float, float]:
    """How far one step moves a turtle in x and y (m).

    Args:
        theta: The heading at the end of the step (rad).
        vx: Speed ahead (m/s).
        vy: Speed to the left (m/s).
        chord: The return value of `chord` for the step.
    """
    lag, length = chord
    cos_, sin_ = cos(theta - lag), sin(theta - lag)
    # These are turtlesim's operations in its order; another order rounds differently.
    return cos_ * vx * length - sin_ * vy * length, cos_ * vy * length + sin_ * vx * length


def chord(rule: StepRule, turn: float) -> tuple[float, float]:
    """The direction and length of the straight line from the start to the end of a step.

    Args:
        rule: The step rule.
        turn: How far the turtle turns in the step (rad).

    Returns:
        The heading at the end of the step minus the direction of the line (rad), and the length of
        the line divided by the turtle's speed (s).
    """
    if rule is StepRule.EULER or not turn:
        return 0.0, DT
    half = turn / 2.0
    return half, DT * (sin(half) / half)


def half_turn(rule: StepRule) -> float:
    """The angle that a step rule uses for half a turn (rad).

    The angle is pi for ARC. For EULER, the angle is 3.14159265, as in turtlesim.
    """
    return _HALF_TURN[rule]


def wrap(theta: float, half: float) -> float:
    """Shift ``theta`` by whole turns into [-half, half), as in turtlesim.

    Args:
        theta: Any finite angle (rad).
        half: Half a turn (rad), from `half_turn`.

    Source: ``normalizeAngle`` in ``turtle.cpp``.
    """
    turn = 2.0 * half
    wrapped = theta - turn * math.floor((theta + half) / turn)
    # For huge angles the difference itself is rounded, and may miss the range by little or by much.
    return wrapped if -half <= wrapped < half else -half


class Handful:
    """Moves turtles with plain floats. Up to about ten turtles, floats are faster than arrays.

    Args:
        places: Where the turtles stand, by index.
        rule: How a step turns speeds into motion.
    """

    def __init__(self, places: Iterable[Place], rule: StepRule) -> None:
        self._turtles = [_Turtle(place) for place in places]
        self._rule = rule
        self._half = _HALF_TURN[rule]

    def __len__(self) -> int:
        return len(self._turtles)

    def drive(self, commands: Mapping[int, Command], tick: int) -> None:
        """Give commands to turtles; the keys are the indices of the turtles.

        A command lasts ``COMMAND_TICKS`` ticks from ``tick`` on.
        """
        for index, command in commands.items():
            self._turtles[index].take_up(command, self._rule, tick + COMMAND_TICKS)

    def drive_all(self, speeds: npt.NDArray[np.float64], tick: int) -> None:
        """Give every turtle a command. ``speeds`` has shape (3, N), with rows as in `Command`."""
        self.drive(dict(enumerate(map(Command, *speeds.tolist()))), tick)

    def place(self, index: int, place: Place) -> None:
        """Place a turtle.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """
        turtle = self._turtles[index]
        turtle.x, turtle.depth, turtle.theta = place

    def insert(self, index: int, place: Place) -> None:
        """Insert a turtle at rest at this index.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """
        self._turtles.insert(index, _Turtle(place))

    def remove(self, index: int) -> None:
        """Remove a turtle."""
        del self._turtles[index]

    def state(self, index: int) -> State:
        """The state of one turtle."""
        turtle = self._turtles[index]
        return State(turtle.x, turtle.depth, turtle.theta, turtle.vx, turtle.vy, turtle.omega)

    def columns(self) -> Sequence[npt.ArrayLike]:
        """The states of all turtles: N numbers for each field of `State`."""
        columns = list(zip(*map(self.state, range(len(self))), strict=True))
        return columns or [()] * len(State._fields)

    def places(self) -> Sequence[complex]:
        """A copy of all turtles' positions, as complex numbers ``x + 1j * depth`` (m)."""
        return [complex(turtle.x, turtle.depth) for turtle in self._turtles]

    def orders(self) -> list[tuple[State, int]]:
        """The state of each turtle, and the tick in which its command expires.

        The tick is `NEVER` if the turtle has no command.
        """
        return [(self.state(index), each.expires) for index, each in enumerate(self._turtles)]

    def step(self, tick: int) -> Hits:
        """Move all turtles by one step, which completes tick number ``tick``."""
        hits: Sequence[Hit] = ()
        low, half, side = -self._half, self._half, SIDE
        for index, turtle in enumerate(self._turtles):
            if tick >= turtle.expires:
                turtle.halt()
            theta = turtle.theta + turtle.turn
            if not low <= theta < half:
                theta = wrap(theta, half)
            turtle.theta = theta
            # `displacement`, written out in the same order of operations, so that the bits agree.
            # A call per turtle would make a world of ten twice as slow (benchmarks/bench_sim.py).
            vx, length = turtle.vx, turtle.length
            cos_, sin_ = cos(theta - turtle.lag), sin(theta - turtle.lag)
            dx, dy = cos_ * vx * length, sin_ * vx * length
            if turtle.vy:
                dx, dy = dx - sin_ * turtle.vy * length, cos_ * turtle.vy * length + dy
            x, depth = turtle.x + dx, turtle.depth - dy
            if not (0.0 <= x <= side and 0.0 <= depth <= side):
                hits = [*hits, Hit(index, x, depth)]
                x, depth = min(max(x, 0.0), side), min(max(depth, 0.0), side)
            turtle.x, turtle.depth = x, depth
        return hits


class _Turtle:
    """One turtle: its place, its command, and the values that each step needs.

    Attributes:
        turn: How far the turtle turns in a step (rad).
        lag: The heading at the end of a step minus the direction of the step's `chord` (rad).
        length: The length of the step's `chord` divided by the turtle's speed (s).
        expires: The tick in which the command expires; `NEVER` if there is no command.
    """

    __slots__ = (
        "depth", "expires", "lag", "length", "omega", "theta", "turn", "vx", "vy", "x",
    )  # fmt: skip

    def __init__(self, place: Place) -> None:
        self.x, self.depth, self.theta = place
        self.halt()

    def take_up(self, command: Command, rule: StepRule, expires: int) -> None:
        self.vx, self.vy, self.omega = command
        self.turn = self.omega * DT
        self.lag, self.length = chord(rule, self.turn)
        self.expires = expires

    def halt(self) -> None:
        self.vx = self.vy = self.omega = self.turn = self.lag = 0.0
        self.length = DT
        self.expires = NEVER


_HALF_TURN = {StepRule.EULER: 3.14159265, StepRule.ARC: math.pi}
