"""The roster of a world: its turtles by name, in name order, and what new ones are called.

Knows no places, no ROS and no clock.

Source: turtlesim 1.8.2, ``TurtleFrame::spawnTurtle``.
"""

from __future__ import annotations

from bisect import bisect
from typing import TYPE_CHECKING

from turtleact.errors import SimError

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["Roster"]


class Roster:
    """The names of the turtles that there are.

    Args:
        names: Those at first, in any order; new names are counted on from so many.

    Attributes:
        names: In name order, which is the order of the indices.
    """

    names: tuple[str, ...]

    def __init__(self, names: Iterable[str]) -> None:
        self._note(tuple(sorted(names)))
        self._count = len(self.names)

    def index(self, turtle: str | int) -> int:
        """The index of a turtle, given that or its name.

        Raises:
            SimError: if there is no such turtle.
        """
        index = self._index.get(turtle, -1) if isinstance(turtle, str) else turtle
        if 0 <= index < len(self.names):
            return index
        last = len(self.names) - 1
        if last < 0:
            raise SimError(f"there is no turtle {turtle!r}, nor any other: spawn one")
        known = ", ".join(self.names[:3]) + (", …" if last > 2 else "")
        raise SimError(
            f"there is no turtle {turtle!r}: give a name ({known}) or an index to {last}"
        )

    def free_name(self, name: str = "") -> str:
        """The name of a turtle that is to come: the next free ``turtle1``, … if none is given.

        Raises:
            SimError: if there is a turtle of that name.
        """
        if name in self._index:
            raise SimError("there is a turtle of this name: give another", turtle=name)
        while not name or name in self._index:
            self._count += 1
            name = f"turtle{self._count}"
        return name

    def add(self, name: str) -> int:
        """Add a turtle of a free name; gives its index, which others may have had."""
        index = bisect(self.names, name)
        self._note((*self.names[:index], name, *self.names[index:]))
        return index

    def remove(self, index: int) -> None:
        """Remove a turtle; those behind it have other indices then."""
        self._note((*self.names[:index], *self.names[index + 1 :]))

    def _note(self, names: tuple[str, ...]) -> None:
        self.names = names
        self._index = dict(zip(names, range(len(names)), strict=True))
