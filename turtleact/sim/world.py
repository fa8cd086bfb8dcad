"""The world: turtles by name, commands, teleports, and one step for all of them.

A tick first takes up what was asked for since the last one: the newest command of each turtle,
then its teleports in order. Then each turtle, in name order, forgets a command that is too old,
turns, moves, and is stopped by the walls. The same calls give the same run to the last bit.

Knows no ROS and no clock: simulated time is the number of ticks times ``DT``, and whoever calls
`World.step` decides how fast it passes. Chance is a seed.

Source: turtlesim 1.8.2, ``turtle_frame.cpp`` and ``turtle.cpp``.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING, NamedTuple

from turtleact.errors import SimError
from turtleact.sim.kinematics import DT, SIDE, Command, Handful, Place, StepRule

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from turtleact.sim.kinematics import Hits, State, Turtles

__all__ = ["Pose", "World"]

_FEW = 16
"""Up to so many turtles plain floats are faster than arrays."""

_MARGIN = 1.0
"""Turtles that are spread keep this far from the walls (m)."""


class Pose(NamedTuple):
    """What turtlesim publishes of a turtle, rounded to float32 as there.

    x and y are in [0, SIDE] (m), y counted from the lower edge; theta is in [-pi, pi) (rad), but
    for the rounding; linear_velocity (m/s) is never negative; angular_velocity is in rad/s.
    """

    x: float
    y: float
    theta: float
    linear_velocity: float
    angular_velocity: float


class World:
    """Turtles in a square, moved step by step.

    ``turtle1`` starts in the middle and looks along x, as in turtlesim. All others start spread
    over the square, a metre or more from the walls, each in a place and direction that follow
    from its number and the seed alone.

    Up to 16 turtles are stepped in plain floats, with turtlesim's own bits; more as arrays, where
    places on a curve may differ by 1e-13 m (`turtleact.sim.fleet`).

    Args:
        turtles: How many turtles there are, at least one: ``turtle1``, ``turtle2``, …
        seed: Chooses where all but the first start.
        holonomic: Whether turtles can move sideways; if not, ``vy`` is ignored, as in turtlesim.
        rule: How a step turns speeds into motion.

    Raises:
        SimError: if there would be no turtle.

    Example:
        >>> world = World()
        >>> world.set_velocity("turtle1", 2.0, 0.0, 1.8)
        >>> for _ in range(100):
        ...     hits = world.step()
        >>> [round(value, 6) for value in world.pose("turtle1")]
        [6.602817, 6.93899, 1.8144, 0.0, 0.0]
    """

    def __init__(
        self,
        turtles: int = 1,
        seed: int = 0,
        *,
        holonomic: bool = False,
        rule: StepRule = StepRule.EULER,
    ) -> None:
        if turtles < 1:
            raise SimError(f"a world of {turtles} turtles: give 1 or more")
        numbers = sorted(range(1, turtles + 1), key=str)
        self._names = tuple(f"turtle{number}" for number in numbers)
        self._index = {name: index for index, name in enumerate(self._names)}
        self._turtles = _turtles([_start(number, seed) for number in numbers], rule)
        self._holonomic = holonomic
        self._tick = 0
        self._is_asked = False
        self._commands: dict[int, Command] = {}
        self._fleet_command: npt.NDArray[np.float64] | None = None
        self._teleports: list[tuple[int, _Absolute | _Relative]] = []

    @property
    def names(self) -> tuple[str, ...]:
        """The turtles in name order, which is the order of their indices."""
        return self._names

    @property
    def tick(self) -> int:
        """Steps made so far."""
        return self._tick

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return self._tick * DT

    def set_velocity(
        self, turtle: str | int, vx: float, vy: float = 0.0, omega: float = 0.0
    ) -> None:
        """Command a turtle; taken up by the next step, and replaces an earlier command.

        The command moves the turtle in that step and 62 more, unless another one follows.

        Args:
            turtle: Its name or index.
            vx: Speed ahead (m/s).
            vy: Speed to the left (m/s); ignored unless the world is holonomic.
            omega: Turning to the left (rad/s).

        Raises:
            SimError: if there is no such turtle, or a speed is not finite.
        """
        index = self.index(turtle)
        self._check_finite(index, vx=vx, vy=vy, omega=omega)
        self._commands[index] = Command(vx, vy if self._holonomic else 0.0, omega)
        self._is_asked = True

    def set_velocities(
        self, vx: npt.ArrayLike, vy: npt.ArrayLike = 0.0, omega: npt.ArrayLike = 0.0
    ) -> None:
        """Command all turtles at once, as `set_velocity` does for each.

        Args:
            vx: Speeds ahead (m/s): N numbers by index, or one for all.
            vy: Speeds to the left (m/s), likewise.
            omega: Turning to the left (rad/s), likewise.

        Raises:
            SimError: if a speed is not finite, or there are not N of them.
        """
        import numpy as np

        speeds = np.empty((3, len(self._names)))
        for row, what, values in zip(speeds, Command._fields, (vx, vy, omega), strict=True):
            given = np.asarray(values, dtype=np.float64)
            if given.shape not in ((), row.shape):
                raise SimError(f"{what} has shape {given.shape}: give one number or {row.shape}")
            row[:] = given
        if not np.isfinite(speeds).all():
            index = int(np.isfinite(speeds).all(axis=0).argmin())
            self._check_finite(index, **Command(*speeds[:, index].tolist())._asdict())
        if not self._holonomic:
            speeds[1] = 0.0
        self._commands.clear()
        self._fleet_command = speeds
        self._is_asked = True

    def teleport_absolute(self, turtle: str | int, x: float, y: float, theta: float) -> None:
        """Put a turtle somewhere at the next step; outside the walls it is brought back by them.

        Args:
            turtle: Its name or index.
            x: From the left edge (m); rounded to float32, as are all of them.
            y: From the lower edge (m).
            theta: Its new heading (rad), any angle.

        Raises:
            SimError: if there is no such turtle, or a number is not finite in float32.
        """
        self._teleport(turtle, _Absolute(*array("f", (x, y, theta))))

    def teleport_relative(self, turtle: str | int, linear: float, angular: float) -> None:
        """Turn a turtle, then put it ahead along its new heading, at the next step.

        Args:
            turtle: Its name or index.
            linear: How far ahead (m); rounded to float32, as is the angle.
            angular: How far to turn to the left (rad).

        Raises:
            SimError: if there is no such turtle, or a number is not finite in float32.
        """
        self._teleport(turtle, _Relative(*array("f", (linear, angular))))

    def step(self) -> Hits:
        """Let one tick pass.

        Returns:
            The turtles that were stopped by a wall in this tick, and where it caught them.
        """
        if self._is_asked:
            self._take_up()
        hits = self._turtles.step(self._tick)
        self._tick += 1
        return hits

    def pose(self, turtle: str | int) -> Pose:
        """The pose of a turtle after the last step.

        Raises:
            SimError: if there is no such turtle.
        """
        x, depth, theta, vx, vy, omega = self._turtles.state(self.index(turtle))
        speed = math.sqrt(vx * vx + vy * vy)
        return Pose(*array("f", (x, SIDE - depth, theta, speed, omega)))

    def poses(self) -> npt.NDArray[np.float32]:
        """The poses of all turtles after the last step.

        Returns:
            A new array of shape (N, 5), rows by index, columns as in `Pose`.
        """
        import numpy as np

        x, depth, theta, vx, vy, omega = map(np.asarray, self._turtles.columns())
        poses = np.empty((len(self._names), 5), np.float32)
        with np.errstate(over="ignore"):  # beyond float32 a speed is infinite
            poses[:, 0] = x
            poses[:, 1] = SIDE - depth
            poses[:, 2] = theta
            poses[:, 3] = np.sqrt(vx * vx + vy * vy)
            poses[:, 4] = omega
        return poses

    def index(self, turtle: str | int) -> int:
        """The index of a turtle, given that or its name.

        Raises:
            SimError: if there is no such turtle.
        """
        index = self._index.get(turtle, -1) if isinstance(turtle, str) else turtle
        if 0 <= index < len(self._names):
            return index
        last = len(self._names) - 1
        known = ", ".join(self._names[:3]) + (", …" if last > 2 else "")
        raise SimError(
            f"there is no turtle {turtle!r}: give a name ({known}) or an index to {last}"
        )

    def _teleport(self, turtle: str | int, teleport: _Absolute | _Relative) -> None:
        index = self.index(turtle)
        self._check_finite(index, **teleport._asdict())
        self._teleports.append((index, teleport))
        self._is_asked = True

    def _take_up(self) -> None:
        self._is_asked = False
        if self._fleet_command is not None:
            self._turtles.drive_all(self._fleet_command, self._tick)
            self._fleet_command = None
        if self._commands:
            self._turtles.drive(self._commands, self._tick)
            self._commands.clear()
        for index, teleport in self._teleports:
            self._turtles.place(index, teleport.place_after(self._turtles.state(index)))
        self._teleports.clear()

    def _check_finite(self, index: int, **numbers: float) -> None:
        for what, value in numbers.items():
            if not math.isfinite(value):
                problem = f"{what} is {value}: give a finite number"
                raise SimError(problem, turtle=self._names[index])


class _Absolute(NamedTuple):
    """The request of a teleport to a place."""

    x: float
    y: float
    theta: float

    def place_after(self, _state: State) -> Place:
        return Place(self.x, max(0.0, SIDE - self.y), self.theta)


class _Relative(NamedTuple):
    """The request of a teleport by a turn and a way."""

    linear: float
    angular: float

    def place_after(self, state: State) -> Place:
        theta = state.theta + self.angular
        x = state.x + math.cos(theta) * self.linear
        return Place(x, state.depth - math.sin(theta) * self.linear, theta)


def _turtles(places: list[Place], rule: StepRule) -> Turtles:
    if len(places) <= _FEW:
        return Handful(places, rule)
    from turtleact.sim.fleet import Fleet  # numpy costs 0.1 s: only a fleet waits for it

    return Fleet(places, rule)


def _start(number: int, seed: int) -> Place:
    """Where a turtle starts: the first in the middle, the others evenly spread.

    Source: Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, R3; the seed
    shifts it.
    """
    if number == 1:
        return Place(SIDE / 2.0, SIDE / 2.0, 0.0)
    u, v, w = (
        (number * step + seed * shift) % _WHOLE / _WHOLE
        for step, shift in zip(_SPREAD, _SHIFT, strict=True)
    )
    width = SIDE - 2.0 * _MARGIN
    x, y, theta = array("f", (_MARGIN + u * width, _MARGIN + v * width, (2.0 * w - 1.0) * math.pi))
    (depth,) = array("f", (SIDE - y,))
    return Place(x, depth, theta)


# Fractions are whole numbers of 2**-64, so that any seed is exact. The steps of the sequence are
# g**-1, g**-2 and g**-3, where g**4 = g + 1; the shifts are odd and unrelated.
_WHOLE = 2**64
_SPREAD = tuple(int(1.2207440846057596**-power * _WHOLE) for power in (1, 2, 3))
_SHIFT = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
