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

import cmath
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import msgspec

__all__ = ["ROOM", "Cell", "Leg", "View", "least_loss"]

ROOM = 2.0
"""Radii in which there is room for both turns of a leg."""

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
    """Headings between two legs: the middle one (rad), their range, and the cost up to there."""

    heading: float
    width: float = 0.0
    cost: float = 0.0


class _Sight(NamedTuple):
    """An error, its side (1, -1, or 0 where it may be either), and what is made turning it off."""

    error: float
    side: int
    made: float


def least_loss(
    heading: complex,
    legs: Sequence[Leg],
    *,
    half: float,
    tick: float,
    parts: int,
    known: dict[tuple[Leg, ...], list[Cell]],
    last: float | None = None,
    slack: float = 0.0,
) -> float:
    """The least that turning takes over all legs, in rad of turning at full rate.

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
    """
    tried = [Cell(cmath.phase(heading))]
    for i, (leg, following) in enumerate(pairwise(legs)):
        begun = tuple(legs[: i + 2])
        if begun not in known:
            turn = math.remainder(cmath.phase(following.unit * leg.unit.conjugate()), 2.0 * half)
            if min(leg.least, following.least) >= ROOM:
                corner = iter([_halved(leg, turn, tick)])
            else:
                corner = _corner(leg, turn, half, parts)
            known[begun] = list(_pass(leg, tried, corner, half, tick))
        tried = known[begun]
    if last is None:
        return min(cell.cost + _started(cell, legs[-1], half, tick) for cell in tried)
    wanted = Cell(last, 2.0 * slack)
    return min(cell.cost for cell in _pass(legs[-1], tried, [wanted], half, tick))


def _corner(leg: Leg, turn: float, half: float, parts: int) -> Iterator[Cell]:
    """All headings at a corner, cut at both directions and at the opposite ones."""
    begun, rest = cmath.phase(leg.unit), math.copysign(half, turn) - turn
    for length in (turn, rest, turn, rest):
        count = parts * max(1, round(8.0 * abs(length) / half))
        for i in range(count):
            yield Cell(begun + (i + 0.5) / count * length, abs(length) / count)
        begun += length


def _halved(leg: Leg, turn: float, tick: float) -> Cell:
    """The best heading where there is room for both turns: half before the target, half after."""
    return Cell(cmath.phase(leg.unit) + math.copysign(max(0.0, abs(turn) - tick) / 2.0, turn))


def _views(leg: Leg) -> Sequence[View]:
    """Its own, if that counts, and the others."""
    if leg.is_left_out:
        return leg.views
    return [View(cmath.phase(leg.unit), leg.least, leg.most), *leg.views]


def _sight(cell: Cell, view: View, half: float, tick: float = 0.0) -> _Sight:
    """The least error of a cell in a direction, if the turtle may turn for a tick."""
    angle, off = math.remainder(cell.heading - view.direction, 2.0 * half), cell.width / 2.0
    error = abs(angle)
    if error < off - _ROUNDING or error > half - off + _ROUNDING:
        side = 0
    else:
        side = 1 if angle >= 0.0 else -1
    least = max(0.0, error - off - tick)
    return _Sight(least, side, _made(least))


def _pass(
    leg: Leg, starts: Sequence[Cell], ends: Iterable[Cell], half: float, tick: float
) -> Iterator[Cell]:
    """The cells at the end of a leg, each with the least cost up to there."""
    starts, views = _best(starts, half), _views(leg)
    seen = [[_sight(start, view, half, tick) for view in views] for start in starts]
    if leg.least >= ROOM:
        begun = min(
            start.cost + _lost(sights[0].error) for start, sights in zip(starts, seen, strict=True)
        )
        for end in ends:
            cost = begun + _lost(_sight(end, views[0], half).error)
            yield Cell(end.heading, end.width, cost)
        return
    for end in ends:
        cost, wanted = math.inf, [_sight(end, view, half) for view in views]
        for start, sights in zip(starts, seen, strict=True):
            if start.cost >= cost:
                break
            width = max(start.width + tick, end.width)
            least = _turned(start, end, half) - tick if leg.is_left_out else 0.0
            for view, from_, to in zip(views, sights, wanted, strict=True):
                if start.cost + least >= cost:
                    break
                least = max(least, view.gain + _between(from_, to, view, half, width))
            cost = min(cost, start.cost + least)
        yield Cell(end.heading, end.width, cost)


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
    if start.side * end.side > 0:
        return _on_one_side(start, end, view, width)
    least = _on_both_sides(start, end, view, half, width)
    if start.side * end.side < 0:
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
        least = min(least, away + _on_one_side(_Sight(half, 0, 1.0), end, view, width))
    away = max(0.0, half - wanted - width)
    if away + whole - error + made < least:
        least = min(least, away + _on_one_side(start, _Sight(half, 0, 1.0), view, width))
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
    if _made(high + width) - made_low >= view.least:  # the turn alone may be enough
        turned = high - made_high - _lost(low + width)
        least = min(least, max(0.0, turned, high - low - width - view.most))
    return least


def _started(cell: Cell, leg: Leg, half: float, tick: float) -> float:
    """What the last leg takes from a cell, if its end may be in any heading."""
    least = 0.0
    for view in _views(leg):
        error = _sight(cell, view, half, tick).error
        rest = _made(error) - view.least
        if rest < _made(error):
            least = max(least, view.gain + _lost(error) - _lost(math.asin(max(0.0, rest))))
    return least


def _made(error: float) -> float:
    """The way made in turning from an error to none (radii)."""
    return math.sin(error) if error < math.pi / 2 else 1.0


def _lost(error: float) -> float:
    """The integral of 1 - cos, and of 1 beyond a right angle, from 0 to an error."""
    return error - _made(error)
