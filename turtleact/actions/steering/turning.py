"""What turning takes at least from a turtle that turns while it drives.

Each leg of a tour has a direction, in which the turtle must come a certain way. While it heads off
by an angle e it makes cos(e) of its speed in that direction, or nothing where that is negative; so
in a tick it loses 1 - cos(e) of it. The error changes no faster than the turn rate. So turning
from an error e to none loses F(e) over the turn rate, and what a leg loses depends on the errors
at its ends:

- on two sides, F of both; and where the way is too short for so long a turn, what is left over;
- on one side, the same, but for what lies below the error at which the way is done.

What is lost in the direction of a leg may be more than its errors show. Seen in another direction
the way takes a certain time too, and what the two directions make of it differs by little where the
way is short. So a short leg is seen from all around, and for each pair of headings that view counts
which proves most. A leg that the length leaves out takes what it turns at least.

The heading at the end of a leg is that at the start of the next. All are tried, cell by cell, each
counted as the best heading in it would be: what comes out is a bound, however coarse the cells.

Angles count in rad, ways in turning radii, losses in rad of turning at full rate. Knows only
that the turtle first turns and then moves in a tick; what that may gain is taken off.

Source: L. S. Pontryagin et al., The Mathematical Theory of Optimal Processes, 1962, chapter 1: the
directions are the multipliers of the positions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from typing import TypeAlias

import msgspec

from turtleact.geometry import phase

__all__ = ["ROOM", "Cell", "Leg", "View", "least_loss"]

ROOM = 2.0
"""Radii in which there is room for both turns of a leg."""

_RIGHT = math.pi / 2
_ROUNDING = 1e-9  # Of angles: a cell that ends at a direction is on one side of it (rad).


class View(msgspec.Struct, frozen=True):
    """A direction (rad), and how far along it the turtle must come, and can (radii).

    The gain is what the way counts more in this direction than in that of its leg (radii).
    """

    direction: float
    least: float
    most: float
    gain: float = 0.0


class Leg(msgspec.Struct, frozen=True):
    """One leg: its unit vector, and how far along it the turtle must come, and can (radii).

    Its views in other directions gain on none if it is left out.
    """

    unit: complex
    least: float
    most: float
    views: tuple[View, ...] = ()
    is_left_out: bool = False


class Cell(msgspec.Struct, frozen=True):
    """Headings between two legs: the middle one (rad), their range, and the cost up to there.

    Before it is the cell at the corner before, from which it costs least.
    """

    heading: float
    width: float = 0.0
    cost: float = 0.0
    before: Cell | None = None


_Sight: TypeAlias = tuple[float, int, float]
"""An error, its side (1, -1, or 0 where it may be either), and what is made turning it off."""


def least_loss(
    heading: complex,
    legs: Sequence[Leg],
    *,
    half: float,
    tick: float,
    parts: int,
    known: dict[tuple[Leg, ...], list[Cell]] | None = None,
    last: float | None = None,
    slack: float = 0.0,
    tried: Sequence[float] | None = None,
    enough: float = -math.inf,
) -> tuple[float, list[float]]:
    """The least that turning takes over all legs, and the headings at the corners that take it.

    In rad of turning at full rate, and in rad.

    Args:
        heading: At the start, a unit vector.
        legs: In order; one at least.
        half: The largest error there is: pi, or pi / 2 where it may also drive in reverse.
        tick: How far it may turn before it moves (rad).
        parts: Into how many cells each eighth of the largest error is cut at a corner.
        known: What has been found out of the first legs of other tours with the same heading at the
            start and as many parts; more is added.
        last: The heading that is wanted at the end (rad); any if left out.
        slack: How far that may be off to either side (rad).
        tried: Headings (rad), one a corner, that may be nearly the best: they are tried first, and
            where nothing is known, what cannot be better is left out.
        enough: If those take no more than this, they are the answer.
    """
    corners = [_corner(one, next_, half, tick, parts) for one, next_ in pairwise(legs)]
    wanted = None if last is None else Cell(last, 2.0 * slack)
    limit = math.inf, list[float]()
    begun = [Cell(phase(heading))]
    if tried is not None:
        cells = begun
        for leg, corner, near in zip(legs, corners, tried, strict=False):
            cells = list(_pass(leg, cells, [_nearest(corner, near, half)], half, tick))
        limit = _ended(cells, legs[-1], wanted, half, tick)
        if limit[0] <= enough:
            return limit
    most = limit[0] if known is None else math.inf
    known, cells = {} if known is None else known, begun
    for i, (leg, corner) in enumerate(zip(legs, corners, strict=False)):
        first = tuple(legs[: i + 2])
        if first not in known:
            ends = _pass(leg, cells, corner, half, tick, most, legs[i + 1]) if cells else ()
            known[first] = list(ends)
        cells = known[first]
    found = _ended(cells, legs[-1], wanted, half, tick) if cells else limit
    return min(found, limit) if most < math.inf else found


def _ended(
    cells: Sequence[Cell], leg: Leg, wanted: Cell | None, half: float, tick: float
) -> tuple[float, list[float]]:
    """The least cost at the end of the last leg, and the headings at all corners."""
    if wanted is None:
        costs = [cell.cost + _started(cell, leg, half, tick) for cell in cells]
        cost = min(costs)
        best: Cell | None = cells[costs.index(cost)]
    else:
        (end,) = _pass(leg, cells, [wanted], half, tick)
        cost, best = end.cost, end.before
    headings = []
    while best and best.before:
        headings.append(best.heading)
        best = best.before
    return cost, headings[::-1]


def _nearest(corner: Sequence[Cell], heading: float, half: float) -> Cell:
    """The cell that a heading is in."""
    apart = [
        abs(math.remainder(cell.heading - heading, 2.0 * half)) - cell.width / 2.0
        for cell in corner
    ]
    return corner[apart.index(min(apart))]


def _corner(leg: Leg, following: Leg, half: float, tick: float, parts: int) -> list[Cell]:
    """All headings at a corner, cut at both directions and at the opposite ones.

    Where there is room for both turns only the best: half before the target, half after.
    """
    begun = phase(leg.unit)
    turn = math.remainder(phase(following.unit * leg.unit.conjugate()), 2.0 * half)
    if min(leg.least, following.least) >= ROOM:
        return [Cell(begun + math.copysign(max(0.0, abs(turn) - tick) / 2.0, turn))]
    cells, rest = [], math.copysign(half, turn) - turn
    for length in (turn, rest, turn, rest):
        count = parts * max(1, round(8.0 * abs(length) / half))
        width = abs(length) / count
        cells += [Cell(begun + (i + 0.5) / count * length, width) for i in range(count)]
        begun += length
    return cells


def _views(leg: Leg) -> Sequence[View]:
    """Its own, if that counts, and the others."""
    if leg.is_left_out:
        return leg.views
    return [View(phase(leg.unit), leg.least, leg.most), *leg.views]


def _sight(cell: Cell, view: View, half: float, tick: float = 0.0) -> _Sight:
    """The least error of a cell in a direction, if the turtle may turn for a tick."""
    angle, off = math.remainder(cell.heading - view.direction, 2.0 * half), cell.width / 2.0
    error = abs(angle)
    if error < off - _ROUNDING or error > half - off + _ROUNDING:
        side = 0
    else:
        side = 1 if angle >= 0.0 else -1
    least = error - off - tick
    if least <= 0.0:
        return 0.0, side, 0.0
    return least, side, math.sin(least) if least < _RIGHT else 1.0


def _pass(
    leg: Leg,
    starts: Sequence[Cell],
    ends: Sequence[Cell],
    half: float,
    tick: float,
    limit: float = math.inf,
    following: Leg | None = None,
) -> Iterator[Cell]:
    """The cells at the end of a leg, each with the least cost up to there.

    But for those from where the following leg must lead to more than the limit.
    """
    starts, views = _best(starts, half), _views(leg)
    ways = [(start, [_sight(start, view, half, tick) for view in views]) for start in starts]
    if leg.least >= ROOM:
        costs = [start.cost + _lost(sights[0][0]) for start, sights in ways]
        cost = min(costs)
        best = starts[costs.index(cost)]
        for end in ends:
            lost = _lost(_sight(end, views[0], half)[0])
            yield Cell(end.heading, end.width, cost + lost, best)
        return
    order, hint = list(range(len(views))), ways[:1]
    for end in ends:
        cost = math.inf
        if following and limit < math.inf:
            cost = limit + _ROUNDING - _started(end, following, half, tick)
        most, wanted = cost, dict[int, _Sight]()
        for way in chain(hint, ways):  # first that which is best for the cell before
            start, sights = way
            least = max(0.0, _turned(start, end, half) - tick) if leg.is_left_out else 0.0
            if start.cost + least >= cost:
                continue
            width = max(start.width + tick, end.width)
            for nth, i in enumerate(order):  # first the view that ruled out the way before
                view = views[i]
                if i not in wanted:
                    wanted[i] = _sight(end, view, half)
                least = max(least, view.gain + _between(sights[i], wanted[i], view, half, width))
                if start.cost + least >= cost:
                    order.insert(0, order.pop(nth))
                    break
            else:
                cost, hint = start.cost + least, [way]
        if cost < most:
            yield Cell(end.heading, end.width, cost, hint[0][0])


def _best(cells: Sequence[Cell], half: float) -> list[Cell]:
    """The cells in order of their cost, but for those that a turn on the spot leads to as soon."""
    best: list[Cell] = []
    for cell in sorted(cells, key=_cost):
        for other in best:
            apart = abs(math.remainder(cell.heading - other.heading, 2.0 * half))
            if other.cost + apart + (cell.width - other.width) / 2.0 <= cell.cost:
                break
        else:
            best.append(cell)
    return best


def _cost(cell: Cell) -> float:
    return cell.cost


def _turned(start: Cell, end: Cell, half: float) -> float:
    """The least turn from a cell to another."""
    angle = abs(math.remainder(end.heading - start.heading, 2.0 * half))
    return angle - (start.width + end.width) / 2.0


def _between(start: _Sight, end: _Sight, view: View, half: float, width: float) -> float:
    """What a way takes from an error to another, each more by a width at most."""
    sides = start[1] * end[1]
    if sides > 0:
        return _on_one_side(start, end, view, width)
    least = _on_both_sides(start, end, view, half, width)
    if sides < 0:
        return least
    return min(least, _on_one_side(start, end, view, width))


def _on_both_sides(start: _Sight, end: _Sight, view: View, half: float, width: float) -> float:
    """What a way takes from an error to another on the other side."""
    (error, _, made), (wanted, _, made_wanted) = start, end
    least = max(error - made + wanted - made_wanted, error + wanted - view.most)
    # Or it turns by the back, where an error of half a turn has two sides.
    whole = half - 1.0 - width
    away = max(0.0, half - error - width)
    if away + whole - wanted + made_wanted < least:
        least = min(least, away + _on_one_side((half, 0, 1.0), end, view, width))
    away = max(0.0, half - wanted - width)
    if away + whole - error + made < least:
        least = min(least, away + _on_one_side(start, (half, 0, 1.0), view, width))
    return least


def _on_one_side(one: _Sight, other: _Sight, view: View, width: float) -> float:
    """What a way takes from one error to another on the same side.

    The error falls until the way that is left is that of the turn to the other, and rises.
    """
    (low, _, made_low), (high, _, made_high) = (one, other) if one < other else (other, one)
    lost = low - made_low + high - made_high
    sine = (made_low + made_high - view.least) / 2.0
    least = math.inf
    if sine <= 0.0:
        least = lost
    elif sine < made_low:
        least = lost - 2.0 * (math.asin(sine) - sine)
    made = made_high + width  # at most, and soon known
    if made - made_low >= view.least and _made(high + width) - made_low >= view.least:
        # The turn alone may be enough.
        turned = high - made_high - _lost(low + width)
        least = min(least, max(0.0, turned, high - low - width - view.most))
    return least


def _started(cell: Cell, leg: Leg, half: float, tick: float) -> float:
    """What the last leg takes from a cell, if its end may be in any heading."""
    least = 0.0
    for view in _views(leg):
        if view.least > 0.0:
            error, _, made = _sight(cell, view, half, tick)
            rest = math.asin(max(0.0, made - view.least))
            least = max(least, view.gain + error - made - _lost(rest))
    return least


def _made(error: float) -> float:
    """The way made in turning from an error to none (radii)."""
    return math.sin(error) if error < _RIGHT else 1.0


def _lost(error: float) -> float:
    """The integral of 1 - cos, and of 1 beyond a right angle, from 0 to an error."""
    return error - _made(error)
