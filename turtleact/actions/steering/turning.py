"""What turning takes at least from a turtle that turns while it drives.

Each leg of a tour has a direction, in which the turtle must come a certain way. While it heads off
by an angle e it makes cos(e) of its speed in that direction, or nothing where that is negative; so
in a tick it loses 1 - cos(e) of it. The error changes no faster than the turn rate. So turning
from an error e to none loses F(e) over the turn rate, and what a leg loses depends on the errors
at its ends:

- on two sides, F of both; and where the way is too short for so long a turn, what is left over;
- on one side, the same, but for what lies below the error at which the way is done.

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
from collections.abc import Iterator, Sequence
from itertools import pairwise

import msgspec

__all__ = ["ROOM", "Cell", "Leg", "least_loss"]

ROOM = 2.0
"""Radii in which there is room for both turns of a leg."""


class Leg(msgspec.Struct, frozen=True):
    """One leg: its unit vector, and how far along it the turtle must come, and can (radii)."""

    unit: complex
    least: float
    most: float


class Cell(msgspec.Struct, frozen=True):
    """Headings between two legs: the least errors before and after, their sides, their range."""

    before: float
    side_before: int
    after: float
    side_after: int
    width: float
    cost: float = 0.0


def least_loss(
    heading: complex,
    legs: Sequence[Leg],
    *,
    half: float,
    tick: float,
    cells: int,
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
        cells: How many headings to try between the directions of two legs; a quarter of it beyond.
        known: What has been found out of the first legs of other tours with the same heading at the
            start and as many cells; more is added.
        last: The least error there must be at the end; any may be if left out.
        slack: How much more that error may be (rad).
    """
    first = _turn(heading, legs[0].unit, half)
    tried = [Cell(0.0, 0, max(0.0, abs(first) - tick), _side(-first), 0.0)]
    for i, (leg, following) in enumerate(pairwise(legs)):
        begun = tuple(legs[: i + 2])
        if begun not in known:
            turn = _turn(leg.unit, following.unit, half)
            if min(leg.least, following.least) >= ROOM:
                corner = iter([_halved(turn, tick)])
            else:
                corner = _corner(turn, half, tick, cells)
            known[begun] = _pass(leg, tried, corner, half)
        tried = known[begun]
    leg = legs[-1]
    if last is None:
        return min(cell.cost + _started(cell.after, leg.least) for cell in tried)
    return min(
        cell.cost + _on_one_side(cell.after, last, leg, max(cell.width, slack)) for cell in tried
    )


def _turn(heading: complex, unit: complex, half: float) -> float:
    """The angle from a direction to another (rad), the short way round."""
    return math.remainder(cmath.phase(unit * heading.conjugate()), 2.0 * half)


def _side(angle: float) -> int:
    return 1 if angle >= 0.0 else -1


def _corner(turn: float, half: float, tick: float, cells: int) -> Iterator[Cell]:
    """All headings at a corner: between its directions, before, behind, and opposite to them."""
    angle, side, few = abs(turn), _side(turn), cells // 4
    arcs = (
        (angle, cells, 0.0, side, angle, -1, -side),
        (half - angle, few, 0.0, -side, angle, 1, -side),
        (half - angle, few, angle, side, 0.0, 1, side),
        (angle, few, half - angle, -side, half, -1, side),
    )
    for length, count, before, side_before, after, changes, side_after in arcs:
        width = length / count
        for i in range(count):
            low, least = before + i * width, after + changes * i * width
            if changes < 0:
                least -= width
            yield Cell(low, side_before, max(0.0, least - tick), side_after, width)


def _halved(turn: float, tick: float) -> Cell:
    """The best heading where there is room for both turns: half before the target, half after."""
    angle, side = max(0.0, abs(turn) - tick) / 2.0, _side(turn)
    return Cell(angle, side, angle, -side, 0.0)


def _pass(leg: Leg, starts: Sequence[Cell], ends: Iterator[Cell], half: float) -> list[Cell]:
    """The cells at the end of a leg, each with the least cost up to there."""
    if leg.least >= ROOM:
        least = min(start.cost + _lost(start.after) for start in starts)
        return [msgspec.structs.replace(end, cost=least + _lost(end.before)) for end in ends]
    starts = sorted(starts, key=_cost)
    return [msgspec.structs.replace(end, cost=_cheapest(leg, starts, end, half)) for end in ends]


def _cost(cell: Cell) -> float:
    return cell.cost


def _cheapest(leg: Leg, starts: Sequence[Cell], end: Cell, half: float) -> float:
    """The least cost up to a cell, from starts in order of theirs."""
    least = math.inf
    for start in starts:
        if start.cost >= least:
            break
        least = min(least, start.cost + _between(start, end, leg, half))
    return least


def _between(start: Cell, end: Cell, leg: Leg, half: float) -> float:
    """What a leg takes between two cells."""
    width = max(start.width, end.width)
    if start.side_after == end.side_before:
        return _on_one_side(start.after, end.before, leg, width)
    lost_start, lost_end = _lost(start.after), _lost(end.before)
    least = max(lost_start + lost_end, start.after + end.before - leg.most)
    # Or it turns by the back, where an error of half a turn has two sides.
    whole = _lost(half) - width
    away = max(0.0, half - start.after - width)
    if away + whole - lost_end < least:
        least = min(least, away + _on_one_side(half, end.before, leg, width))
    away = max(0.0, half - end.before - width)
    if away + whole - lost_start < least:
        least = min(least, away + _on_one_side(start.after, half, leg, width))
    return least


def _on_one_side(one: float, other: float, leg: Leg, width: float) -> float:
    """What a leg takes from one error to another on the same side, each more by a width at most.

    The error falls until the way that is left is that of the turn to the other, and rises.
    """
    low, high = (one, other) if one < other else (other, one)
    made_low, made_high = _made(low), _made(high)
    sine = (made_low + made_high - leg.least) / 2.0
    least = math.inf
    if sine <= 0.0:
        least = low - made_low + high - made_high
    elif sine < made_low:
        least = low - made_low + high - made_high - 2.0 * (math.asin(sine) - sine)
    if _made(high + width) - made_low >= leg.least:  # the turn alone may be enough
        left = max(0.0, high - made_high - _lost(low + width), high - low - width - leg.most)
        least = min(least, left)
    return least


def _started(error: float, way: float) -> float:
    """What the last leg takes from an error, if its end may be in any heading."""
    rest = _made(error) - way
    if rest >= _made(error):
        return 0.0
    return _lost(error) - _lost(math.asin(max(0.0, rest)))


def _made(error: float) -> float:
    """The way made in turning from an error to none (radii)."""
    return math.sin(min(error, math.pi / 2))


def _lost(error: float) -> float:
    """The integral of 1 - cos, and of 1 beyond a right angle, from 0 to an error."""
    return error - math.sin(min(error, math.pi / 2))
