"""Straight ways of many turtles, put together as they are drawn: one line each, not one a tick.

Of arrays, for a fleet; `drawing` has the same for one line after the other. Places are
``x + 1j * depth`` in metres. Knows no ROS and no clock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from turtleact.sim.drawing import Pen

__all__ = ["Lines", "Runs"]

Numbers: TypeAlias = npt.NDArray[np.intp]
Places: TypeAlias = npt.NDArray[np.complex128]
Lines: TypeAlias = tuple[Numbers, Places, Places]
"""Whose lines, where each begins, and where it ends."""


class Runs:
    """The lines of one pen that may still go on, one a turtle.

    Args:
        pen: The pen.
        bend: How far a line that goes straight on may lead aside (m).
    """

    def __init__(self, pen: Pen, bend: float) -> None:
        self.pen = pen
        self._bend = bend
        self._is_held = np.zeros(0, np.bool_)
        self._start = np.zeros(0, np.complex128)
        self._end = np.zeros(0, np.complex128)

    def take(self, who: Numbers, start: Places, end: Places) -> Lines:
        """Go on with some lines; gives those that do not go on, now that others have begun.

        Args:
            who: The numbers of the turtles, each once.
            start: Where their lines begin.
            end: Where they end.
        """
        self._make_room(int(who.max()) + 1)
        is_held, way, step = self._is_held[who], self._end[who] - self._start[who], end - start
        length, more = np.abs(way), np.abs(step)
        with np.errstate(divide="ignore", invalid="ignore"):  # a dot leads nowhere
            turned = step * way.conj() / length
            is_straight = np.abs(turned.imag) <= self._bend * np.minimum(1.0, more / length)
        goes_on = is_held & is_straight & (turned.real >= 0.0) & (more > 0.0)
        goes_on &= self._end[who] == start
        over = who[is_held & ~goes_on]
        ended = over, self._start[over], self._end[over]
        new = who[~goes_on]
        self._start[new] = start[~goes_on]
        self._is_held[new] = True
        self._end[who] = end
        return ended

    def take_all(self) -> Lines:
        """Give all lines that there are, and forget them."""
        (who,) = self._is_held.nonzero()
        self._is_held[:] = False
        return who, self._start[who], self._end[who]

    def _make_room(self, count: int) -> None:
        more = count - len(self._is_held)
        if more > 0:
            self._is_held = np.append(self._is_held, np.zeros(more, np.bool_))
            self._start = np.append(self._start, np.zeros(more, np.complex128))
            self._end = np.append(self._end, np.zeros(more, np.complex128))
