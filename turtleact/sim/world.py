"""A world of turtles, one or thousands, which moves them step by step.

Each step first makes the teleports that were asked for since the previous step, in the order in
which they came. Then each turtle drops its command if that is too old, turns, moves along its new
heading, and is stopped by the walls. These are turtlesim's operations in turtlesim's order, so the
poses are the same to the last bit of a float32. Two worlds with the same seed and the same calls
have the same results.

If turtles collide, each is a disc. If a step would make two discs overlap and bring them closer
than before, neither turtle moves. A turtle that does not move may block a third turtle, so that the
third turtle does not move either, and so on. Therefore, two separate discs never begin to overlap,
and two overlapping discs can only move apart. The result does not depend on the order of the
turtles.

This module knows no ROS and no clock: simulated time is the number of steps times ``DT``, and the
caller of `World.step` decides how fast it passes. All randomness comes from a seed.

Source: turtlesim 1.8.2, ``turtle_frame.cpp`` and ``turtle.cpp``; for collisions the cell lists of
molecular dynamics (Allen and Tildesley, Computer Simulation of Liquids, section 5.3.2).
"""

from __future__ import annotations

from bisect import bisect
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.errors import SimError
from turtleact.sim.kinematics import (
    COMMAND_TICKS,
    DT,
    HALF_TURN,
    MIDDLE,
    SIDE,
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

__all__ = ["BODY", "Pose", "World", "stopped"]

_Floats: TypeAlias = npt.NDArray[np.float64]
_Complexes: TypeAlias = npt.NDArray[np.complex128]
_Indices: TypeAlias = npt.NDArray[np.intp]

BODY: Final = 0.3
"""The radius of a turtle (m), measured on its picture without head and tail."""

_COLUMNS: Final = 1 << 20
"""A cell's number is its row times this factor, plus its column.

Every column is smaller than this factor.
"""

_AROUND: Final = [row * _COLUMNS + column for row in (-1, 0, 1) for column in (-1, 0, 1)]
"""The offsets from a cell's number to those of its eight neighbours and of the cell itself (0)."""


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
        collide: Whether turtles that meet stop each other.

    Attributes:
        names: The names of the turtles, sorted as strings. A turtle's index is its position here.
        holonomic: Whether turtles can move sideways. You may change this attribute at any time; the
            change applies to later commands.
        on_jump: Called for each teleport when it is made, with the turtle's name, its old place and
            its new place. A place is ``x + 1j * depth`` (m), where ``depth`` is the distance from
            the upper edge.
        tick: The number of steps made so far.

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

    names: tuple[str, ...]
    # By row: x, depth and theta of each turtle; vx, vy and omega of each turtle's command.
    _places: _Floats
    _speeds: _Floats
    _expires: npt.NDArray[np.int64]
    _teleports: list[tuple[str, Callable[[Place], Place]]]

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
        self._first = {f"turtle{number}": place for number, place in enumerate(places, 1)}
        self.holonomic = holonomic
        self.on_jump: Callable[[str, complex, complex], None] | None = None
        self.tick = 0
        self._collide = collide
        self._begin(self._first)

    @property
    def time(self) -> float:
        """The simulated time (s)."""
        return self.tick * DT

    def set_velocity(
        self, turtle: str | int, vx: float, vy: float = 0.0, omega: float = 0.0
    ) -> None:
        """Give a turtle a velocity command, which moves it from the next step on.

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
        index = self.index(turtle)
        check_finite(self.names[index], vx=vx, vy=vy, omega=omega)
        self._command(index, (vx, vy, omega))

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
        speeds = np.empty_like(self._speeds)
        names = ("vx", "vy", "omega")
        for row, what, values in zip(speeds, names, (vx, vy, omega), strict=True):
            given = np.asarray(values, dtype=np.float64)
            if given.shape not in ((), row.shape):
                raise SimError(f"{what} has shape {given.shape}: give one number or {row.shape}")
            row[:] = given
        for index in np.flatnonzero(~np.isfinite(speeds).all(axis=0)).tolist():
            check_finite(self.names[index], **dict(zip(names, speeds[:, index], strict=True)))
        self._command(slice(None), speeds)

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
        name = self.names[self.index(turtle)]
        x, y, theta = to_float32(name, x=x, y=y, theta=theta)
        place = Place(x, max(0.0, SIDE - y), theta)
        self._teleports.append((name, lambda _: place))

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
        name = self.names[self.index(turtle)]
        linear, angular = to_float32(name, linear=linear, angular=angular)
        self._teleports.append((name, lambda place: place_ahead(place, linear, angular)))

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
        if name in self._index:
            raise SimError("a turtle has this name already: give another", turtle=name)
        while not name or name in self._index:
            self._count += 1
            name = f"turtle{self._count}"
        index = bisect(self.names, name)
        self._call((*self.names, name))
        self._places = np.insert(self._places, index, place_at(x, y, theta), axis=1)
        self._speeds = np.insert(self._speeds, index, 0.0, axis=1)
        self._expires = np.insert(self._expires, index, 0)
        return name

    def kill(self, turtle: str) -> None:
        """Remove a turtle from the world.

        Raises:
            SimError: if there is no such turtle.
        """
        index = self.index(turtle)
        self._call(name for name in self.names if name != turtle)
        self._places = np.delete(self._places, index, axis=1)
        self._speeds = np.delete(self._speeds, index, axis=1)
        self._expires = np.delete(self._expires, index)
        self._teleports = [each for each in self._teleports if each[0] != turtle]

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
        """Make the teleports that were asked for now, instead of in the next step."""
        for name, teleport in self._teleports:
            index = self._index[name]
            before = Place(*self._places[:, index].tolist())
            after = teleport(before)
            self._places[:, index] = after
            if self.on_jump is not None:
                self.on_jump(name, complex(before.x, before.depth), complex(after.x, after.depth))
        self._teleports.clear()

    def step(self) -> list[Hit]:
        """Make one tick, and return the turtles that a wall stopped in this tick."""
        self.take_up()
        before = self._places[:2].copy()
        with np.errstate(over="ignore"):  # far beyond the walls a place may be infinite
            hits = self._move()
        if self._collide:
            at = stopped(before[0] + 1j * before[1], self.places())
            self._places[:2, at] = before[:, at]
        self.tick += 1
        return hits

    def pose(self, turtle: str | int) -> Pose:
        """Return the pose of a turtle after the last step.

        Raises:
            SimError: if there is no such turtle.
        """
        return Pose(*self._rounded(self.index(turtle)).tolist())

    def heading(self, turtle: str | int) -> float:
        """Return the heading of a turtle (rad), not rounded to float32.

        Raises:
            SimError: if there is no such turtle.
        """
        return float(self._places[2, self.index(turtle)])

    def places(self) -> npt.NDArray[np.complex128]:
        """Return a copy of the places of all turtles, by index.

        A place is ``x + 1j * depth`` (m), where ``depth`` is the distance from the upper edge.
        """
        x, depth, _ = self._places
        places: _Complexes = x + 1j * depth
        return places

    def poses(self) -> npt.NDArray[np.float32]:
        """Return the poses of all turtles after the last step.

        Returns:
            A new array of shape (N, 5): one row per turtle, in the order of the indices, with the
            columns of `Pose`.
        """
        return self._rounded(slice(None)).T

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

    def _begin(self, turtles: dict[str, Place]) -> None:
        self._call(turtles)
        self._count = len(turtles)
        self._places = np.array([turtles[name] for name in self.names]).T
        self._speeds = np.zeros_like(self._places)
        self._expires = np.zeros(len(turtles), np.int64)
        self._teleports = []

    def _call(self, names: Iterable[str]) -> None:
        self.names = tuple(sorted(names))
        self._index = {name: index for index, name in enumerate(self.names)}

    def _command(self, at: int | slice, speeds: npt.ArrayLike) -> None:
        self._speeds[:, at] = speeds
        if not self.holonomic:
            self._speeds[1, at] = 0.0
        self._expires[at] = self.tick + COMMAND_TICKS

    def _move(self) -> list[Hit]:
        self._speeds[:, self._expires <= self.tick] = 0.0
        vx, vy, omega = self._speeds
        theta = self._places[2] = _wrapped(self._places[2] + omega * DT)
        # These are turtlesim's operations in its order; another order rounds differently.
        cos, sin = np.cos(theta), np.sin(theta)
        x = self._places[0] + (cos * vx - sin * vy) * DT
        depth = self._places[1] - (sin * vx + cos * vy) * DT
        self._places[:2] = np.clip((x, depth), 0.0, SIDE)
        (at,) = ((self._places[0] != x) | (self._places[1] != depth)).nonzero()
        return list(map(Hit, at.tolist(), x[at].tolist(), depth[at].tolist()))

    def _rounded(self, at: int | slice) -> npt.NDArray[np.float32]:
        # Rounded to float32 only here, so that roundings do not add up over the steps.
        x, depth, theta = self._places[:, at]
        vx, vy, omega = self._speeds[:, at]
        with np.errstate(over="ignore"):  # beyond float32 a speed is infinite
            speed = np.sqrt(vx * vx + vy * vy)
            return np.array([x, SIDE - depth, theta, speed, omega]).astype(np.float32)


def stopped(before: npt.ArrayLike, after: npt.ArrayLike, radius: float = BODY) -> list[int]:
    """Find the turtles that must not move in a step, because they would collide.

    Args:
        before: The N places before the step, ``x + 1j * depth`` (m).
        after: The N places that the turtles have after the step if none of them is stopped (m).
        radius: The radius of each turtle (m), above zero.

    Returns:
        The indices of these turtles, in ascending order.
    """
    here, there = np.asarray(before), np.asarray(after)
    moves = here != there
    stay = np.zeros(len(here), np.bool_)
    new = np.flatnonzero(moves)
    while len(new):
        one, other = _near(there, new, 2.0 * radius)
        nearer = np.abs(there[one] - there[other]) < np.abs(here[one] - here[other])
        met = np.concatenate([one[nearer], other[nearer]])
        new = np.unique(met[moves[met] & ~stay[met]])
        stay[new] = True
        there = np.where(stay, here, there)
    return np.flatnonzero(stay).tolist()


def _wrapped(theta: _Floats) -> _Floats:
    """Wrap angles as `turtleact.sim.kinematics.wrap` does."""
    turn = 2.0 * HALF_TURN
    wrapped = theta - turn * np.floor((theta + HALF_TURN) / turn)
    return np.where((wrapped >= -HALF_TURN) & (wrapped < HALF_TURN), wrapped, -HALF_TURN)


def _near(places: _Complexes, some: _Indices, distance: float) -> tuple[_Indices, _Indices]:
    """Return all pairs (i, j) of turtles less than ``distance`` (m) apart, with i in ``some``."""
    cells = np.floor(places.imag / distance).astype(np.int64) * _COLUMNS
    cells += np.floor(places.real / distance).astype(np.int64)
    order = np.argsort(cells, kind="stable")
    sorted_cells = cells[order]
    pairs = []
    for around in _AROUND:
        first = np.searchsorted(sorted_cells, cells[some] + around, "left")
        count = np.searchsorted(sorted_cells, cells[some] + around, "right") - first
        at = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        pairs.append((np.repeat(some, count), order[at]))
    one, other = (np.concatenate(column) for column in zip(*pairs, strict=True))
    is_near = (one != other) & (np.abs(places[one] - places[other]) < distance)
    return one[is_near], other[is_near]
