"""Moves turtles, one or a million, as arrays, and finds their collisions.

The numbers are turtlesim's: a turtle first drops an expired command, then turns, then moves along
its new heading, and is stopped by the walls. Places and steps are complex numbers,
``x + 1j * depth`` (m). A turtle's step is the vector by which it moves in a tick. This vector is
computed with trigonometry when the turtle gets a command or a new place. After that, each tick adds
the vector to the place and then rotates the vector: ``theta += turn; place += step; step *= spin``.

A vector is rotated at most ``COMMAND_TICKS`` times, so rounding errors stay small: after 20,000
steps of random driving, places differed by 7e-14 m from those that sines and cosines in each tick
give. A Pose is rounded to float32, where that shows in 4 of 100 million numbers. Angles, straight
lines, turns on the spot, walls and the ends of commands are exact to the last bit.

For collisions, each turtle is a disc. If a step would make two discs overlap and bring them closer
than before, neither turtle moves. A turtle that does not move may block a third turtle, so that the
third turtle does not move either, and so on. Therefore, two separate discs never begin to overlap,
and two overlapping discs can only move apart. The result does not depend on the order of the
turtles.

This module depends on no turtle names, no ROS and no clock: it counts time in ticks.

Source: turtlesim 1.8.2, ``Turtle::update`` in ``turtle.cpp``; for collisions the cell lists of
molecular dynamics (Allen and Tildesley, Computer Simulation of Liquids, section 5.3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.sim.kinematics import COMMAND_TICKS, DT, HALF_TURN, NEVER, SIDE, Hit, State

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turtleact.sim.kinematics import Command, Place

__all__ = ["BLOCK", "BODY", "Fleet", "stopped"]

_Floats: TypeAlias = npt.NDArray[np.float64]
_Complexes: TypeAlias = npt.NDArray[np.complex128]
_Indices: TypeAlias = npt.NDArray[np.intp]

_Column: TypeAlias = npt.NDArray[Any]

_Caught: TypeAlias = tuple[int, _Indices, _Complexes]
"""The turtles of a block that are outside the walls, as three values.

The values are the index of the block's first turtle, an array with the indices of the outside
turtles in the block, and an array with the places of these turtles.
"""

BLOCK = 8192
"""How many turtles are stepped together, so that a step's data fits the second-level cache."""

# Arrays, because numpy handles them faster than plain numbers.
_ZERO = np.array(0.0)
_ONE = np.array(1)
_SIDE = np.array(SIDE)
_SIDE_BITS = _SIDE.view(np.uint64)
_HALF = np.array(HALF_TURN)

BODY: Final = 0.3
"""The radius of a turtle (m), measured on its picture without head and tail."""

_COLUMNS: Final = 1 << 20
"""A cell's number is its row times this factor, plus its column.

Every column is smaller than this factor.
"""

_AROUND: Final = [row * _COLUMNS + column for row in (-1, 0, 1) for column in (-1, 0, 1)]
"""The offsets from a cell's number to those of its eight neighbours and of the cell itself (0)."""


class Fleet:
    """Moves turtles with arrays.

    Args:
        places: Where the turtles stand, by index.
    """

    def __init__(self, places: Sequence[Place]) -> None:
        x, depth, theta = np.array(places, dtype=np.float64).reshape(-1, 3).T
        count = len(x)
        self._place = _complex(x, depth)
        self._theta = theta.copy()
        self._speeds = np.zeros((3, count))
        self._turn = np.zeros(count)
        self._step = np.zeros(count, np.complex128)
        self._spin = np.ones(count, np.complex128)
        self._expires = np.full(count, NEVER, np.int64)
        self._next_expiry = NEVER
        self._is_awake = True
        self._divide()

    def __len__(self) -> int:
        return len(self._theta)

    def drive(self, commands: Mapping[int, Command], tick: int) -> None:
        """Give commands to turtles; the keys are the indices of the turtles.

        A command lasts ``COMMAND_TICKS`` ticks from ``tick`` on.
        """
        at = np.fromiter(commands, np.intp, len(commands))
        self._take_up(at, np.array(list(commands.values())).T, tick)

    def drive_all(self, speeds: _Floats, tick: int) -> None:
        """Give every turtle a command. ``speeds`` has shape (3, N), with rows as in `Command`."""
        for block in self._blocks:
            self._take_up(block.where, speeds[:, block.where], tick)

    def place(self, index: int, place: Place) -> None:
        """Place a turtle.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """
        self._place[index] = complex(place.x, place.depth)
        self._theta[index] = place.theta
        at = np.array([index])
        self._aim(at, self._theta[at] + self._turn[at])
        self._is_awake = True

    def insert(self, index: int, place: Place) -> None:
        """Insert a turtle at rest at this index.

        The next step wraps the turtle's angle. If the turtle is outside the walls, the step moves
        the turtle back inside.
        """
        self._rearrange(lambda column: np.insert(column, index, 0, axis=-1))
        self._rest(np.array([index]))
        self.place(index, place)

    def remove(self, index: int) -> None:
        """Remove a turtle."""
        self._rearrange(lambda column: np.delete(column, index, axis=-1))

    def state(self, index: int) -> State:
        """The state of one turtle."""
        return State(*(float(column[index]) for column in self.columns()))

    def columns(self) -> tuple[_Floats, ...]:
        """The states of all turtles: an array of shape (N,) for each field of `State`."""
        return self._place.real, self._place.imag, self._theta, *self._speeds

    def places(self) -> _Complexes:
        """A copy of all turtles' positions, ``x + 1j * depth`` (m)."""
        return self._place.copy()

    def step(self, tick: int) -> list[Hit]:
        """Move all turtles by one step, which completes tick number ``tick``.

        Returns:
            The turtles that hit a wall, in the order of their indices.
        """
        if tick >= self._next_expiry:
            self._halt(tick)
        if not self._is_awake:
            return []
        # All turtles turn before any moves: wrapping angles costs about the same for one turtle and
        # for many.
        over: list[_Indices] = []
        for block in self._blocks:
            if block.turn():
                over.append(block.over())
        if over:
            self._wrap(np.concatenate(over))
        caught: list[_Caught] = []
        for block in self._blocks:
            if block.move():
                caught.append(block.clamp())
        self._is_awake = self._next_expiry != NEVER
        return _hits(caught) if caught else []

    def _take_up(self, at: slice | _Indices, speeds: _Floats, tick: int) -> None:
        turn = speeds[2] * DT
        self._speeds[:, at] = speeds
        self._turn[at] = turn
        self._spin[at] = _complex(np.cos(turn), -np.sin(turn))
        self._expires[at] = tick + COMMAND_TICKS
        self._next_expiry = min(self._next_expiry, tick + COMMAND_TICKS)
        self._is_awake = True
        self._aim(at, self._theta[at] + turn)

    def _halt(self, tick: int) -> None:
        self._rest(np.flatnonzero(self._expires <= tick))
        self._next_expiry = int(self._expires.min())

    def _rest(self, at: _Indices) -> None:
        self._speeds[:, at] = 0.0
        self._turn[at] = 0.0
        self._step[at] = 0.0
        self._spin[at] = 1.0
        self._expires[at] = NEVER

    def _rearrange(self, change: Callable[[_Column], _Column]) -> None:
        """Change which turtles there are, column by column, and recompute all steps.

        Two fleets with the same turtles therefore move identically to the last bit, even if other
        turtles were inserted or removed earlier.
        """
        self._place, self._theta = change(self._place), change(self._theta)
        self._speeds, self._turn = change(self._speeds), change(self._turn)
        self._spin, self._expires = change(self._spin), change(self._expires)
        self._step = np.zeros_like(self._spin)
        (driven,) = (self._expires != NEVER).nonzero()
        self._aim(driven, self._theta[driven] + self._turn[driven])
        self._is_awake = True
        self._divide()

    def _divide(self) -> None:
        self._blocks = [
            _Block(self, slice(start, start + BLOCK)) for start in range(0, len(self), BLOCK)
        ]

    def _wrap(self, at: _Indices) -> None:
        """Wrap the angles of these turtles as `kinematics.wrap` does, and recompute their steps."""
        half, turn = HALF_TURN, 2.0 * HALF_TURN
        theta = self._theta[at]
        wrapped = theta - turn * np.floor((theta + half) / turn)
        theta = np.where((-half <= wrapped) & (wrapped < half), wrapped, -half)
        self._theta[at] = theta
        self._aim(at, theta)

    def _aim(self, at: slice | _Indices, theta: _Floats) -> None:
        """Compute the step vectors of turtles that have the headings ``theta`` after the step."""
        # These are turtlesim's operations in its order; another order rounds differently.
        vx, vy = self._speeds[0, at], self._speeds[1, at]
        cos, sin = np.cos(theta), np.sin(theta)
        self._step[at] = _complex((cos * vx - sin * vy) * DT, -((sin * vx + cos * vy) * DT))


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


class _Block:
    """Consecutive turtles of a fleet: views of its arrays, and arrays for intermediate values."""

    def __init__(self, fleet: Fleet, where: slice) -> None:
        self.where = where
        self._theta, self._turn = fleet._theta[where], fleet._turn[where]
        self._place, self._step = fleet._place[where], fleet._step[where]
        self._spin = fleet._spin[where]
        self._place_parts = self._place.view(np.float64)
        self._place_bits = self._place.view(np.uint64)
        self._step_parts = self._step.view(np.float64)
        self._magnitude = np.empty_like(self._theta)
        # The flags are bytes, too, since looking for a 1 in bytes is much faster than any().
        self._over_bytes = bytearray(len(self._theta))
        self._outside_bytes = bytearray(len(self._place_parts))
        self._over = np.frombuffer(self._over_bytes, np.bool_)
        self._outside = np.frombuffer(self._outside_bytes, np.bool_)

    def turn(self) -> bool:
        """Turn all turtles by one step; return whether an angle may be out of range."""
        np.add(self._theta, self._turn, self._theta)
        np.absolute(self._theta, self._magnitude)
        np.greater_equal(self._magnitude, _HALF, self._over)
        return 1 in self._over_bytes

    def over(self) -> _Indices:
        """The turtles with an angle out of range."""
        at: _Indices = self._over.nonzero()[0] + self.where.start
        return at

    def move(self) -> bool:
        """Move all turtles by their step vectors, then rotate these vectors.

        Return whether a turtle may be outside the walls.
        """
        np.add(self._place_parts, self._step_parts, self._place_parts)
        np.multiply(self._step, self._spin, self._step)
        # As unsigned integers, the bits of SIDE are below those of any larger or negative
        # float: one comparison sees all four walls.
        np.greater(self._place_bits, _SIDE_BITS, self._outside)
        return 1 in self._outside_bytes

    def clamp(self) -> _Caught:
        """Bring the turtles flagged by `move` back inside; return their indices and old places."""
        at = self._outside.nonzero()[0]
        np.right_shift(at, _ONE, at)  # two parts a turtle
        before = self._place[at]
        np.maximum(self._place_parts, _ZERO, out=self._place_parts)
        np.minimum(self._place_parts, _SIDE, out=self._place_parts)
        return self.where.start, at, before


def _hits(caught: list[_Caught]) -> list[Hit]:
    """Return the turtles that were outside the walls, in the order of their indices."""
    at = np.concatenate([start + at for start, at, _ in caught])
    before = np.concatenate([before for _, _, before in caught])
    at, first = np.unique(at, return_index=True)  # in a corner both parts are flagged
    x, depth = before[first].real, before[first].imag
    real = (x < 0.0) | (x > SIDE) | (depth < 0.0) | (depth > SIDE)  # unlike -0.0
    return list(map(Hit, *(column[real].tolist() for column in (at, x, depth))))


def _complex(real: _Floats, imag: _Floats) -> _Complexes:
    number = np.empty(real.shape, np.complex128)
    number.real = real
    number.imag = imag
    return number


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
