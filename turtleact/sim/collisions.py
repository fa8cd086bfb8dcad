"""Turtles that stand in each other's way: whom a step must not move.

A turtle is a disc. A step that would bring two of them nearer to each other than their discs allow,
and nearer than they were, moves neither; whom that leaves in the way of a third stops it, too, and
so on. So discs that lie apart never come to overlap, those that overlap can only part, and nothing
depends on who is looked at first.

Places are ``x + 1j * depth`` (m). Knows no names, no ROS and no clock.

Source: the cell lists of molecular dynamics (Allen and Tildesley, Computer Simulation of Liquids,
section 5.3.2).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["BODY", "stopped"]

_Indices: TypeAlias = npt.NDArray[np.intp]
_Places: TypeAlias = npt.NDArray[np.complex128]

BODY: Final = 0.3
"""The radius of a turtle (m): of what a picture shows, without head and tail."""

_COLUMNS: Final = 1 << 20
"""By so much the number of a cell grows from row to row: more than there are columns."""

_AROUND: Final = [row * _COLUMNS + column for row in (-1, 0, 1) for column in (-1, 0, 1)]
"""From the number of a cell to those of its neighbours, and its own."""


def stopped(before: Sequence[complex], after: Sequence[complex], radius: float = BODY) -> list[int]:
    """Who must stay where it was.

    Args:
        before: Where the turtles were before the step.
        after: Where it would bring them.
        radius: Of each (m).

    Returns:
        Their indices, in order.
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


def _near(places: _Places, some: _Indices, distance: float) -> tuple[_Indices, _Indices]:
    """The pairs that are nearer than a distance (m), of some turtles with any."""
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
