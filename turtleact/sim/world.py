"""A world of turtles, which moves them step by step.

Each step first applies the requests that came after the previous step: the newest command of each
turtle, and then all teleports in the order in which they came. Then each turtle, in the order of
the names, drops its command if the command is too old, turns, moves, and is stopped by the walls.
Two worlds with the same seed and the same calls have the same results, to the last bit.

This module knows no ROS and no clock: simulated time is the number of steps times ``DT``, and the
caller of `World.step` decides how fast it passes. All randomness comes from a seed.

Source: turtlesim 1.8.2, ``turtle_frame.cpp`` and ``turtle.cpp``.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from turtleact.errors import SimError
from turtleact.sim.fleet import Fleet, stopped
from turtleact.sim.kinematics import (
    DT,
    MIDDLE,
    SIDE,
    Command,
    Hit,
    Place,
    check_finite,
    place_ahead,
    place_at,
    starts,
    to_float32,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from turtleact.sim.kinematics import State

__all__ = ["Names", "Pose", "World"]


class Pose(NamedTuple):
    """The pose of a turtle as turtlesim publishes it, rounded to float32.

    x and y (m) are the distances from the left and the lower edge, in [0, SIDE]. theta (rad) is in
    [-pi, pi). Rounding may move x, y and theta slightly beyond these limits. The linear velocity
    (m/s) is never negative. The angular velocity is in rad/s.
    """

    x: float
    y: float
    theta: float
    linear_velocity: float
    angular_velocity: float


class World:
    """Turtles in a square. Each step moves all turtles.

    By default, ``turtle1`` starts in the middle and looks along x, as in turtlesim, and all others
    are spread over the square, in places that depend on the seed. With another ``placing``, all
    turtles start in a grid or on a ring.

    Args:
        turtles: How many turtles there are, at least one: ``turtle1``, ``turtle2``, …
        seed: With ``placing="random"``, determines where all turtles except the first start.
        placing: How the turtles are placed at the start: ``"random"``, ``"grid"`` or ``"ring"``.
        holonomic: Whether turtles can move sideways. If turtles cannot move sideways, ``vy`` is
            ignored, as in turtlesim.
        collide: Whether turtles that meet stop each other (`turtleact.sim.fleet`).

    Attributes:
        holonomic: Whether turtles can move sideways. You may change this attribute at any time; the
            change applies to later commands.
        on_jump: Called for each teleport when it is made, with the turtle's name, its old place and
            its new place. A place is ``x + 1j * depth`` (m), where ``depth`` is the distance from
            the upper edge.

    Raises:
        SimError: if ``turtles`` is below 1, or ``placing`` is unknown.

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
        placing: str = "random",
        holonomic: bool = False,
        collide: bool = False,
    ) -> None:
        if turtles < 1:
            raise SimError(f"a world of {turtles} turtles: give 1 or more")
        places = starts(turtles, placing, seed)
        numbers = sorted(range(1, turtles + 1), key=str)
        self._first = {f"turtle{number}": places[number - 1] for number in numbers}
        self.holonomic = holonomic
        self.on_jump: Callable[[str, complex, complex], None] | None = None
        self._collide = collide
        self._tick = 0
        self._is_asked = False
        self._commands: dict[int, Command] = {}
        self._fleet_command: npt.NDArray[np.float64] | None = None
        self._teleports: list[tuple[int, Callable[[State], Place]]] = []
        self._turtles: Fleet
        self._begin(self._first)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the turtles, sorted as strings. A turtle's index is its position here."""
        return self._names.names

    @property
    def tick(self) -> int:
        """The number of steps made so far."""
        return self._tick

    @property
    def time(self) -> float:
        """The simulated time (s)."""
        return self._tick * DT

    def set_velocity(
        self, turtle: str | int, vx: float, vy: float = 0.0, omega: float = 0.0
    ) -> None:
        """Give a turtle a velocity command, which takes effect in the next step.

        The command replaces the turtle's earlier command. It lasts for 63 steps, unless another
        command replaces it.

        Args:
            turtle: The turtle's name or index.
            vx: Speed ahead (m/s).
            vy: Speed to the left (m/s); ignored unless the world is holonomic.
            omega: Turn rate to the left (rad/s).

        Raises:
            SimError: if there is no such turtle, or a speed is not finite.
        """
        index = self._names.index(turtle)
        if not math.isfinite(vx + vy + omega):
            check_finite(self.names[index], vx=vx, vy=vy, omega=omega)
        self._commands[index] = Command(vx, vy if self.holonomic else 0.0, omega)
        self._is_asked = True

    def set_velocities(
        self, vx: npt.ArrayLike, vy: npt.ArrayLike = 0.0, omega: npt.ArrayLike = 0.0
    ) -> None:
        """Command all turtles at once, as `set_velocity` does for one turtle.

        Args:
            vx: Speeds ahead (m/s): one number per turtle, in the order of the indices, or a single
                number for all turtles.
            vy: Speeds to the left (m/s), in the same form; ignored unless the world is holonomic.
            omega: Turn rates to the left (rad/s), in the same form.

        Raises:
            SimError: if a speed is not finite, or an array does not have one number per turtle.
        """
        speeds = np.empty((3, len(self._turtles)))
        for row, what, values in zip(speeds, Command._fields, (vx, vy, omega), strict=True):
            given = np.asarray(values, dtype=np.float64)
            if given.shape not in ((), row.shape):
                raise SimError(f"{what} has shape {given.shape}: give one number or {row.shape}")
            row[:] = given
        if not np.isfinite(speeds).all():
            index = int(np.isfinite(speeds).all(axis=0).argmin())
            check_finite(self.names[index], **Command(*speeds[:, index].tolist())._asdict())
        if not self.holonomic:
            speeds[1] = 0.0
        self._commands.clear()
        self._fleet_command = speeds
        self._is_asked = True

    def teleport_absolute(self, turtle: str | int, x: float, y: float, theta: float) -> None:
        """Put a turtle at a place in the next step.

        If the place is outside the world, the turtle is moved inside in the same step. All three
        numbers are rounded to float32.

        Args:
            turtle: The turtle's name or index.
            x: Distance from the left edge (m).
            y: Distance from the lower edge (m).
            theta: The new heading (rad), any angle.

        Raises:
            SimError: if there is no such turtle, or a number is not finite in float32.
        """
        index = self._names.index(turtle)
        x, y, theta = to_float32(self.names[index], x=x, y=y, theta=theta)
        place = Place(x, max(0.0, SIDE - y), theta)
        self._teleport(index, lambda _: place)

    def teleport_relative(self, turtle: str | int, linear: float, angular: float) -> None:
        """In the next step, turn a turtle on the spot, and then move it along its new heading.

        Both numbers are rounded to float32.

        Args:
            turtle: The turtle's name or index.
            linear: How far to move ahead (m).
            angular: How far to turn to the left (rad).

        Raises:
            SimError: if there is no such turtle, or a number is not finite in float32.
        """
        index = self._names.index(turtle)
        linear, angular = to_float32(self.names[index], linear=linear, angular=angular)
        self._teleport(index, lambda state: place_ahead(state, linear, angular))

    def spawn(self, x: float, y: float, theta: float, name: str = "") -> str:
        """Put a new turtle into the world.

        If the place is outside the world, the turtle is moved inside in its first step. All three
        numbers are rounded to float32.

        Args:
            x: Distance from the left edge (m).
            y: Distance from the lower edge (m).
            theta: The turtle's heading (rad), any angle.
            name: The turtle's name. If empty, the turtle gets the next free name of ``turtle1``,
                ``turtle2``, …

        Returns:
            The turtle's name.

        Raises:
            SimError: if there is already a turtle with this name, or a number is not finite in
                float32.
        """
        x, y, theta = to_float32(name or "a new turtle", x=x, y=y, theta=theta)
        name = self._names.free_name(name)
        # Commands and teleports are kept by index, and a new turtle moves the indices behind it.
        # So they are taken up first, as the next step would.
        self.take_up()
        self._turtles.insert(self._names.add(name), place_at(x, y, theta))
        return name

    def kill(self, turtle: str) -> None:
        """Remove a turtle from the world.

        Raises:
            SimError: if there is no such turtle.
        """
        index = self._names.index(turtle)
        self.take_up()  # as in `spawn`: indices are about to change
        self._names.remove(index)
        self._turtles.remove(index)

    def reset(self) -> None:
        """Replace all turtles by a single ``turtle1`` in the middle.

        The next turtle without a given name is ``turtle2``. Simulated time continues.
        """
        self._begin({"turtle1": MIDDLE})

    def restart(self) -> None:
        """Replace all turtles by those with which the world began, at their starting places.

        Simulated time continues.
        """
        self._begin(self._first)

    def take_up(self) -> None:
        """Apply the pending commands and teleports now, instead of in the next step.

        Commands and teleports that come after this call are applied in the next step.
        """
        if self._is_asked:
            self._take_up()

    def step(self) -> list[Hit]:
        """Make one tick, and return the turtles that a wall stopped in this tick."""
        if self._is_asked:
            self._take_up()
        before = self._turtles.places() if self._collide else None
        hits = self._turtles.step(self._tick)
        if before is not None:
            self._keep_apart(before)
        self._tick += 1
        return hits

    def pose(self, turtle: str | int) -> Pose:
        """Return the pose of a turtle after the last step.

        Raises:
            SimError: if there is no such turtle.
        """
        # Rounded to float32 only here, so that roundings do not add up over the steps.
        x, depth, theta, vx, vy, omega = self._turtles.state(self._names.index(turtle))
        speed = math.sqrt(vx * vx + vy * vy)
        return Pose(*array("f", (x, SIDE - depth, theta, speed, omega)))

    def heading(self, turtle: str | int) -> float:
        """Return the heading of a turtle (rad), not rounded to float32.

        Raises:
            SimError: if there is no such turtle.
        """
        return self._turtles.state(self._names.index(turtle)).theta

    def places(self) -> npt.NDArray[np.complex128]:
        """Return a copy of the places of all turtles, by index.

        A place is ``x + 1j * depth`` (m), where ``depth`` is the distance from the upper edge.
        """
        return self._turtles.places()

    def poses(self) -> npt.NDArray[np.float32]:
        """Return the poses of all turtles after the last step.

        Returns:
            A new array of shape (N, 5): one row per turtle, in the order of the indices, with the
            columns of `Pose`.
        """
        x, depth, theta, vx, vy, omega = self._turtles.columns()
        poses = np.empty((len(self._turtles), 5), np.float32)
        with np.errstate(over="ignore"):  # beyond float32 a speed is infinite
            poses[:, 0] = x
            poses[:, 1] = SIDE - depth
            poses[:, 2] = theta
            poses[:, 3] = np.sqrt(vx * vx + vy * vy)
            poses[:, 4] = omega
        return poses

    def index(self, turtle: str | int) -> int:
        """Return the index of a turtle. ``turtle`` is the turtle's name or its index.

        Raises:
            SimError: if there is no such turtle.
        """
        return self._names.index(turtle)

    def _begin(self, turtles: dict[str, Place]) -> None:
        self._fleet_command = None
        self._commands.clear()
        self._teleports.clear()
        self._names = Names(turtles)
        self._turtles = Fleet(list(turtles.values()))

    def _keep_apart(self, before: npt.NDArray[np.complex128]) -> None:
        for index in stopped(before, self._turtles.places()):
            theta = self._turtles.state(index).theta
            x, depth = before[index].real, before[index].imag
            self._turtles.place(index, Place(float(x), float(depth), theta))

    def _teleport(self, index: int, teleport: Callable[[State], Place]) -> None:
        self._teleports.append((index, teleport))
        self._is_asked = True

    def _take_up(self) -> None:
        self._is_asked = False
        # A command to all replaces those to single turtles before it (`set_velocities` drops them),
        # and single ones that come later replace their part of it.
        if self._fleet_command is not None:
            self._turtles.drive_all(self._fleet_command, self._tick)
            self._fleet_command = None
        if self._commands:
            self._turtles.drive(self._commands, self._tick)
            self._commands.clear()
        # Teleports come last and in order, as turtlesim makes them after taking up commands: each
        # starts from where the one before has put the turtle.
        for index, teleport in self._teleports:
            before = self._turtles.state(index)
            after = teleport(before)
            self._turtles.place(index, after)
            if self.on_jump is not None:
                here, there = complex(before.x, before.depth), complex(after.x, after.depth)
                self.on_jump(self.names[index], here, there)
        self._teleports.clear()


class Names:
    """The names of the turtles that exist.

    Args:
        names: The names of the turtles that exist at the start, in any order. If N names are
            given, the first number that `free_name` uses is N + 1.

    Attributes:
        names: The names, sorted as strings. A turtle's index is its position in this order.
    """

    names: tuple[str, ...]

    def __init__(self, names: Iterable[str]) -> None:
        self._note(tuple(sorted(names)))
        self._count = len(self.names)

    def index(self, turtle: str | int) -> int:
        """Return the index of a turtle. ``turtle`` is the turtle's name or its index.

        Raises:
            SimError: if there is no such turtle.
        """
        index = self._index.get(turtle, -1) if isinstance(turtle, str) else turtle
        if 0 <= index < len(self.names):
            return index
        last = len(self.names) - 1
        if last < 0:
            raise SimError(f"there is no turtle {turtle!r}, because the world is empty: spawn one")
        known = ", ".join(self.names[:3]) + (", …" if last > 2 else "")
        raise SimError(
            f"there is no turtle {turtle!r}: give a name ({known}) or an index to {last}"
        )

    def free_name(self, name: str = "") -> str:
        """Return the given name for a new turtle; if it is empty, return the next free name.

        Raises:
            SimError: if a turtle already has the given name.
        """
        if name in self._index:
            raise SimError("a turtle has this name already: give another", turtle=name)
        while not name or name in self._index:
            self._count += 1
            name = f"turtle{self._count}"
        return name

    def add(self, name: str) -> int:
        """Add a turtle with a free name; return its index. The indices of later turtles change."""
        index = bisect(self.names, name)
        self._note((*self.names[:index], name, *self.names[index:]))
        return index

    def remove(self, index: int) -> None:
        """Remove a turtle; the indices of later turtles change."""
        self._note((*self.names[:index], *self.names[index + 1 :]))

    def _note(self, names: tuple[str, ...]) -> None:
        self.names = names
        self._index = dict(zip(names, range(len(names)), strict=True))
