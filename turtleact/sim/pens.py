"""The pens of a world's turtles: what they draw, tick by tick.

A pen that is on draws a line from where its turtle was to where it is, teleports included; one
that is off draws nothing. In a tick each turtle, in name order, draws its teleports, looks at the
colour under it, and draws its step: it sees the lines of those before it, and not the end of its
own.

Knows no ROS and no clock.

Source: turtlesim 1.8.2, ``Turtle::update`` and ``Turtle::setPenCallback``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, cast

from turtleact.sim.canvas import Colour
from turtleact.sim.drawing import Drawing, Pen

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from turtleact.sim.runs import Numbers, Places
    from turtleact.sim.world import World

__all__ = ["Pens"]

THINNEST: Final = 1
"""The width (pixels) of a pen that is asked for with none."""


class Pens:
    """The pens of all turtles in a world; each begins switched on, with the usual one.

    Args:
        world: The turtles. `follow` is to be called after each of its steps.

    Attributes:
        drawing: What was drawn.
    """

    def __init__(self, world: World) -> None:
        self.drawing = Drawing()
        self._world = world
        self._count = 0
        self._holders: dict[str, _Holder] = {}
        self._jumps: dict[str, list[tuple[complex, complex]]] = {}
        self._fleet: _Fleet | None = None
        self._names: tuple[str, ...] = ()
        self._places: Sequence[complex] = ()
        world.on_jump = self._jump
        self._provide_all()

    def set(self, turtle: str, colour: Colour, width: int = 0, *, is_off: bool = False) -> None:
        """Change a turtle's pen, from its next line on.

        Args:
            turtle: Its name.
            colour: What it draws in.
            width: How wide (pixels), 0 to 255; 0 is 1.
            is_off: Whether it stops drawing; the rest is then left as it was.
        """
        holder = self._holders[turtle]
        self._fleet = None
        holder.is_on = not is_off
        if not is_off:
            holder.pen = Pen(colour, width or THINNEST)

    def colour(self, turtle: str) -> Colour:
        """What a turtle draws in, or would if its pen were on."""
        return self._holders[turtle].pen.colour

    def hand_out(self, turtle: str) -> None:
        """Give a turtle that has come a pen; to be called before the next step."""
        self._provide(turtle)
        self._take_stock()

    def take_back(self, turtle: str) -> None:
        """Take the pen of a turtle that has gone; to be called before the next step."""
        del self._holders[turtle]
        self._jumps.pop(turtle, None)
        self._take_stock()

    def forget_all(self) -> None:
        """Erase the drawing, and give every turtle that there is now a new pen."""
        self._holders.clear()
        self._jumps.clear()
        self.drawing.clear()
        self._provide_all()

    def follow(self, sensed: Collection[str] = ()) -> dict[str, Colour]:
        """Draw what the last step of the world made of the turtles.

        Args:
            sensed: The turtles whose colour is wanted.

        Returns:
            The colours of the drawing under these turtles, when it was their turn.
        """
        before, now = self._places, self._world.places()
        self._places = now
        if not sensed and not self._jumps and self._follow_fleet(before, now):
            return {}
        moved = _indices_of_changes(before, now)
        if not sensed and not self._jumps:
            for index in moved:
                self._draw(self._names[index], before[index], now[index])
            return {}
        index_of = {name: index for index, name in enumerate(self._names)}
        colours: dict[str, Colour] = {}
        wanted = {*sensed, *self._jumps, *(self._names[index] for index in moved)}
        for name in sorted(wanted):
            index = index_of[name]
            start, end = before[index], now[index]
            for here, there in self._jumps.pop(name, ()):
                self._draw(name, here, there)
                start = there
            if name in sensed:
                colours[name] = self.drawing.colour_at(end)
            if start != end:
                self._draw(name, start, end)
        return colours

    def _provide_all(self) -> None:
        for name in self._world.names:
            self._provide(name)
        self._take_stock()

    def _provide(self, turtle: str) -> None:
        self._count += 1
        self._holders[turtle] = _Holder(self._count)

    def _take_stock(self) -> None:
        self._names, self._places = self._world.names, self._world.places()
        self._fleet = None

    def _follow_fleet(self, before: Sequence[complex], now: Sequence[complex]) -> bool:
        """Draw the lines of many turtles at once, if all have one pen, and it is on."""
        if isinstance(now, list):
            return False
        if self._fleet is None:
            self._fleet = _Fleet.of([self._holders[name] for name in self._names])
        if self._fleet.pen is None:
            return False
        there = cast("Places", now)
        here = cast("Places", before)
        (moved,) = (there != here).nonzero()
        if len(moved):
            who = self._fleet.numbers[moved]
            self.drawing.lines(self._fleet.pen, who, here[moved], there[moved])
        return True

    def _draw(self, turtle: str, start: complex, end: complex) -> None:
        holder = self._holders[turtle]
        if holder.is_on:
            self.drawing.line(holder.number, holder.pen, start, end)

    def _jump(self, turtle: str, here: complex, there: complex) -> None:
        self._jumps.setdefault(turtle, []).append((here, there))


class _Holder:
    """Who holds a pen: turtles of one name, one after the other, have different numbers."""

    __slots__ = ("is_on", "number", "pen")

    def __init__(self, number: int) -> None:
        self.number = number
        self.pen = Pen()
        self.is_on = True


class _Fleet(NamedTuple):
    """The pens of many turtles.

    Attributes:
        numbers: Who holds them, by the indices of the turtles.
        pen: The one that all have, if it is so and all are on.
    """

    numbers: Numbers
    pen: Pen | None

    @classmethod
    def of(cls, holders: Sequence[_Holder]) -> _Fleet:
        import numpy as np

        numbers = np.array([holder.number for holder in holders], np.intp)
        pens = {holder.pen if holder.is_on else None for holder in holders}
        return cls(numbers, pens.pop() if len(pens) == 1 else None)


def _indices_of_changes(before: Sequence[complex], now: Sequence[complex]) -> list[int]:
    if isinstance(now, list):
        return [i for i, (a, b) in enumerate(zip(before, now, strict=True)) if a != b]
    changed = now != before  # an array of flags
    return changed.nonzero()[0].tolist()  # type: ignore[attr-defined,no-any-return]  # see above
