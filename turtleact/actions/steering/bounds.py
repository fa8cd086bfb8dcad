"""Lower and upper bounds of the time that a turtle needs for a tour of targets.

`shortest_time` is a lower bound for any steering law that keeps to a given style. `time_bound` is
an upper bound for the law in `turtleact.actions.steering.law`. For unlimited accelerations, that
law's docstring proves the upper bound. For limited accelerations, the upper bound is an estimate
that no test has exceeded.

`least_loss` computes the least time that a turtle loses because it turns while it drives. On each
leg of a tour, the turtle must cover a certain distance in the direction of the leg. The heading
error e is the angle between the turtle's heading and the direction of the leg. The turtle advances
along the leg at cos(e) times its speed. If cos(e) is negative, the bound assumes no advance. The
turtle thus loses the share 1 - cos(e) of its speed, or all of its speed if cos(e) is negative. F(e)
is the integral of the lost share of the speed over the heading errors from 0 to e. The heading
error changes no faster than the turn rate. While the heading error falls from e to zero, the turtle
therefore loses at least the time F(e) divided by the turn rate. The time lost on a leg depends on
the heading errors at the start and at the end of the leg:

- If the two errors are on different sides of the leg's direction, the loss is the sum of F for both
  errors. While the turtle turns, it may drive past the end of the leg. The distance past the end is
  added to the loss.
- If the two errors are on the same side, and the heading error falls to zero on the way, the loss
  is also the sum of F for both errors. On a short leg, the smallest heading error on the way may be
  a value m above zero. For such a leg, the loss is the sum minus 2 F(m).

These formulas project the leg onto only one direction, so the true loss may be larger. The
projection onto any other direction gives another lower bound of the loss. For a short leg, another
direction may give a higher bound than the leg's own. `least_loss` therefore projects short legs
onto several directions. For each pair of headings at the two ends of a leg, it uses the highest of
these lower bounds. `shortest_time` may count the length of a leg as zero. Even then, the leg takes
at least the time to turn from the heading at its start to the heading at its end.

The heading at the end of a leg is the heading at the start of the next leg. The possible headings
between two legs are divided into ranges, called cells, and `least_loss` tries all cells. The loss
of a cell is the smallest loss of any heading in the cell. The result is therefore a lower bound,
even if the cells are wide. In this module, angles are in rad, distances in turning radii, and
losses in rad of turning at full rate. In each tick, the turtle first turns and then moves. The turn
before the move may save time, so the lower bounds are reduced by the largest possible saving.

Source: Boyd and Vandenberghe, Convex Optimization, section 5.2 (weak duality); Pontryagin et al.,
The Mathematical Theory of Optimal Processes, 1962, chapter 1 (the directions are the multipliers of
the positions).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise, product
from typing import TypeAlias

import msgspec

from turtleact.actions.steering.law import Steering
from turtleact.actions.steering.limits import Limits, Point, Pose, Style, late, ramp_time
from turtleact.geometry import distance, phase, wrap_angle

__all__ = [
    "ROOM",
    "Cell",
    "Leg",
    "Turning",
    "View",
    "least_loss",
    "rising_times",
    "shortest_time",
    "time_bound",
]

# How much turning a style may need for one target, in half turns.
_TURNING: dict[Style, float] = {
    "natural": 1.5,
    "fastest": 1.0,
    "forward": 1.5,
    "rotate_then_drive": 1.0,
}
_SPARE = 4  # Ticks that one target may lose to rounding up, after the turn and on arrival.
_ROUNDS = 6  # How often the points of a tour are improved; more would hardly change the bound.
_ANGLES = 0.5, 0.2  # Directions are turned by one of these angles (rad) after the other,
_GAIN = 1e-3  # as long as a turn raises the bound by more than this (s),
_TUNED = 6  # in tours of at most so many targets.
_COARSE, _FINE = 1, 3  # Cells per part while directions are turned, and for the final bound,
_VIEWS = 8  # for which a short leg is also measured in so many directions.

ROOM = 2.0
"""A leg of at least this many turning radii has room for the turns at both of its ends."""

_RIGHT = math.pi / 2
_ROUNDING = 1e-9  # Angles this close (rad) count as equal, so a cell may end at a direction.


def time_bound(
    pose: Pose, targets: Sequence[Point], steering: Steering, *, theta: float | None = None
) -> float:
    """Return a time (s) within which the steering law is sure to have reached all targets in order.

    For each target, the bound adds up a drive at full speed to the target and one tolerance
    farther, a turn, and four ticks. The turn is by 180° at full rate, or by 270° for ``natural``
    and ``forward``. A wanted heading adds another turn by 180° and another four ticks.

    With limited accelerations, the bound is multiplied by 3, and 4 (n + 1) ramp times are added for
    n targets. A ramp time is the time to reach full speed from rest, plus the time to reach the
    full turn rate from rest. The bound holds if every command takes effect in the tick for which it
    was computed, and nobody else moves the turtle.

    Args:
        pose: The pose at which the turtle starts: x and y (m), and the heading (rad).
        targets: The targets in order (m). Without targets, the time is 0.
        steering: The steering law with its style and limits.
        theta: The wanted heading (rad) at the last target; None for any heading.
    """
    limits = steering.limits
    length = sum(distance(*a, *b) for a, b in pairwise([(pose[0], pose[1]), *targets]))
    spare = _SPARE * limits.dt + limits.tolerance / limits.max_linear
    turning = _TURNING[steering.style] * math.pi / limits.max_angular
    bound = length / limits.max_linear + len(targets) * (turning + spare)
    if theta is not None and targets:
        bound += math.pi / limits.max_angular + _SPARE * limits.dt
    if not limits.is_eased:
        return bound
    braking = limits.max_linear / limits.max_acceleration
    easing = braking + limits.max_angular / limits.max_angular_acceleration
    return 3.0 * bound + 4.0 * (len(targets) + 1) * easing


def shortest_time(
    pose: Pose,
    targets: Sequence[Point],
    steering: Steering | None = None,
    *,
    theta: float | None = None,
) -> float:
    """Return a lower bound (s) of the time that a turtle needs to visit the targets in order.

    The bound holds for any steering law with the style and the limits of ``steering``. The function
    computes three lower bounds, and returns the highest:

    - The first bound is the time to drive at full speed along the shortest line through the discs
      of all targets, plus the time that the turtle must lose by turning. The disc of a target
      consists of all points within the tolerance.
    - The second bound is the time to drive along this line from rest with the limited acceleration.
    - The third bound is the time to turn to the wanted heading at the last target.

    For styles that turn while they drive, the time lost by turning is the minimum over all possible
    headings at the targets (see `least_loss`). For ``rotate_then_drive``, the time lost by turning
    is the time of all turns on the spot.

    The function does not compute the exact length of the shortest line. Instead, the function
    chooses one unit vector for each leg. By duality, every choice of unit vectors proves a lower
    bound of the length. For this lower bound, the function projects each leg onto its unit vector
    and adds up the projections. The point where two legs meet may be anywhere in its disc. The
    function chooses the point with the smallest sum. A leg with a zero vector adds nothing to the
    sum. If a leg is too short for its turns, another unit vector may give a higher bound. In a tour
    of at most six targets with short legs, the function therefore rotates unit vectors, or sets
    them to zero, as long as the first bound rises. In the same tours, the function also projects
    the short legs onto several directions.

    Args:
        pose: The pose at which the turtle starts, at rest: x and y (m), and the heading (rad).
        targets: The targets in order (m). Without targets, the time is 0.
        steering: A steering law with the style and the limits; None for ``Steering()``.
        theta: The wanted heading (rad) at the last target; None for any heading.

    Source: Boyd and Vandenberghe, Convex Optimization, section 5.2 (weak duality).
    """
    return max(rising_times(pose, targets, steering or Steering(), theta=theta), default=0.0)


def rising_times(
    pose: Pose, targets: Sequence[Point], steering: Steering, *, theta: float | None = None
) -> Iterator[float]:
    """Yield lower bounds (s) of the time for a tour; `shortest_time` returns the highest.

    Computing one lower bound takes a few milliseconds at most, so that the caller can let other
    tasks run between two bounds. Without targets, the function yields no bound.
    """
    if not targets:
        return
    limits = steering.limits
    start, centres = complex(pose[0], pose[1]), [complex(*target) for target in targets]
    stops = [start, *_tour(start, centres, limits.tolerance)]
    units = [_unit(b - a) for a, b in pairwise(stops)]
    if steering.style == "rotate_then_drive":
        length = max(0.0, _proven_length(start, centres, units, limits.tolerance))
        turns = sum(_turns([start, *centres], pose[2], limits))
        proofs = iter([(length, length / limits.max_linear + turns)])
    else:
        proofs = _Tour(pose, centres, steering, theta).proofs(units)
    turned = 0.0 if theta is None else _turn_time(theta - pose[2], limits)
    for length, least in proofs:
        rising = ramp_time(max(0.0, length), limits.max_linear, limits.max_acceleration)
        yield max(least, turned, rising)


def _turn_time(angle: float, limits: Limits) -> float:
    """Return the least time (s) to turn by ``angle``, give or take the heading tolerance."""
    turn = max(0.0, abs(wrap_angle(angle)) - limits.heading_tolerance)
    return ramp_time(turn, limits.max_angular, limits.max_angular_acceleration)


def _tour(start: complex, centres: Sequence[complex], tolerance: float) -> list[complex]:
    """Return one point in each target's disc, so that the line through all points is short."""
    touches = list(centres)
    for _ in range(_ROUNDS):
        before = start
        for i, centre in enumerate(centres):
            after = touches[i + 1] if i + 1 < len(centres) else before
            touches[i] = before = _touch(before, after - before, centre, tolerance)
    return touches


def _touch(before: complex, leg: complex, centre: complex, tolerance: float) -> complex:
    """Return the point of a target's disc that is nearest to the line of a leg."""
    along = ((centre - before) * _unit(leg).conjugate()).real
    foot = before + max(0.0, min(abs(leg), along)) * _unit(leg)
    away = foot - centre
    return centre + away * min(1.0, tolerance / max(tolerance, abs(away)))


def _unit(leg: complex) -> complex:
    return leg / abs(leg) if leg else leg


def _proven_length(
    start: complex, centres: Sequence[complex], units: Sequence[complex], tolerance: float
) -> float:
    """Compute a lower bound (m) of a tour's length from the unit vectors of its legs.

    The docstring of `shortest_time` explains this bound as a sum over legs. This function
    rearranges the same sum into one term for each point. Each term multiplies a point by the
    difference between the unit vectors before and after the point. The result is negative if the
    unit vectors point backwards along their legs.
    """
    total = -(start * units[0].conjugate()).real
    for centre, unit, leaving in zip(centres, units, [*units[1:], 0j], strict=True):
        pull = unit - leaving
        total += (centre * pull.conjugate()).real - tolerance * abs(pull)
    return total


def _turns(stops: Sequence[complex], theta: float, limits: Limits) -> Iterator[float]:
    """For each turn on the spot, yield the least time (s) to face the disc of the next target."""
    heading, off = cmath.rect(1.0, theta), 0.0
    for i, (stop, target) in enumerate(pairwise(stops)):
        leg, ends = target - stop, (2.0 if i else 1.0) * limits.tolerance
        if abs(leg) <= ends:  # the leg may have any direction
            off += late(limits)
            continue
        leaves = math.asin(ends / abs(leg))
        angle = abs(phase(leg * heading.conjugate()))
        yield max(0.0, angle - off - leaves - late(limits)) / limits.max_angular
        heading, off = leg, leaves


class _Tour:
    """Computes lower bounds for a tour of a turtle that turns while it drives.

    Any choice of one unit vector for each leg proves a lower bound (see `shortest_time`).
    """

    def __init__(
        self, pose: Pose, centres: Sequence[complex], steering: Steering, theta: float | None
    ) -> None:
        self._start, self._heading = complex(pose[0], pose[1]), cmath.rect(1.0, pose[2])
        self._centres = centres
        self._limits = steering.limits
        self._half = math.pi if steering.style == "forward" else math.pi / 2
        self._theta = theta

    def proofs(self, units: Sequence[complex]) -> Iterator[tuple[float, float]]:
        """Yield pairs of lower bounds: the length (m) and the time (s) of the tour."""
        if len(units) > _TUNED:
            yield self._length(units), self._time(units, _COARSE)[0]
            return
        headings: list[float] | None = None
        if any(leg.least < ROOM for leg in self._legs(units).values()):
            for better in self._better(list(units)):
                time, units, headings = better
                yield self._length(units), time
        time, _ = self._time(units, _FINE, views=_VIEWS, tried=headings)
        yield self._length(units), time

    def _better(self, units: list[complex]) -> Iterator[tuple[float, list[complex], list[float]]]:
        """Raise the lower bound of the time by rotating unit vectors or setting them to zero.

        After each attempt, yield the best lower bound of the time (s) so far, its unit vectors, and
        its headings (rad) at the targets.
        """
        known: dict[tuple[Leg, ...], list[Cell]] = {}
        best, headings = self._time(units, _COARSE, known)
        for angle in _ANGLES:
            changes = cmath.rect(1.0, angle), cmath.rect(1.0, -angle), 0j
            for i, change in product(range(len(units)), changes):
                while units[i]:
                    tried = [*units[:i], units[i] * change, *units[i + 1 :]]
                    enough = best + _GAIN
                    time, found = self._time(tried, _COARSE, known, tried=headings, enough=enough)
                    if time <= enough:
                        break
                    best, units, headings = time, tried, found
                yield best, units, headings

    def _length(self, units: Sequence[complex]) -> float:
        return _proven_length(self._start, self._centres, units, self._limits.tolerance)

    def _legs(self, units: Sequence[complex], views: int = 0) -> dict[int, Leg]:
        """Return the legs by index. Omit a leg if its unit vector is zero and it has no views."""
        limits, off, legs = self._limits, self._limits.tolerance, dict[int, Leg]()
        stops = pairwise([self._start, *self._centres])
        for i, ((stop, target), unit) in enumerate(zip(stops, units, strict=True)):
            way = target - stop
            own = self._view(way, unit or _unit(way), off)
            around: tuple[View, ...] = ()
            if own.least < ROOM:
                turns = (cmath.rect(1.0, math.tau * i / views) for i in range(views))
                around = tuple(self._view(way, turn * _unit(way), off, unit) for turn in turns)
            if unit or around:
                legs[i] = Leg(unit or _unit(way), own.least, own.most, around, not unit)
            off = 2.0 * limits.tolerance
        return legs

    def _view(self, way: complex, unit: complex, off: float, own: complex | None = None) -> View:
        """Project the leg ``way`` onto ``unit``; ``off`` (m) sums the tolerances at both ends."""
        limits = self._limits
        along, ends = (way * unit.conjugate()).real, off + limits.step
        more = unit - (unit if own is None else own)
        gain = (way * more.conjugate()).real - off * abs(more)
        least, most = (along - ends) / limits.radius, (along + ends) / limits.radius
        return View(phase(unit), least, most, gain / limits.radius)

    def _time(
        self,
        units: Sequence[complex],
        parts: int,
        known: dict[tuple[Leg, ...], list[Cell]] | None = None,
        *,
        views: int = 0,
        tried: Sequence[float] | None = None,
        enough: float = -math.inf,
    ) -> tuple[float, list[float]]:
        """Return the time bound (s) for some unit vectors, and the headings at the targets.

        If the headings in ``tried`` give a bound of at most ``enough`` (s), the method tries no
        other headings.
        """
        limits, driven = self._limits, self._length(units) / self._limits.max_linear
        legs = self._legs(units, views)
        if not legs:
            return driven, [phase(self._heading)] * len(units)
        corners = list(legs)[:-1]  # each leg ends at a corner
        turning = Turning(
            half=self._half,
            tick=limits.turn,
            parts=parts,
            last=self._theta,
            slack=limits.heading_tolerance,
        )
        turned, headings = least_loss(
            self._heading,
            list(legs.values()),
            turning,
            known=known,
            tried=tried and [tried[i] for i in corners],
            enough=(enough - driven) * limits.max_angular,
        )
        found = dict(zip(corners, headings, strict=True))
        heading, all_ = phase(self._heading), []
        for i in range(len(units)):
            heading = found.get(i, heading)
            all_.append(heading)
        return driven + turned / limits.max_angular, all_


class View(msgspec.Struct, frozen=True):
    """The distance that a turtle covers in one ``direction`` (rad) on a leg.

    The distance is between ``least`` and ``most`` (turning radii). The leg's projection onto
    ``direction`` is at least ``gain`` (turning radii) longer than its projection onto the leg's
    unit vector.
    """

    direction: float
    least: float
    most: float
    gain: float = 0.0


class Leg(msgspec.Struct, frozen=True):
    """A leg of a tour: its unit vector, and the distance that the turtle covers along this vector.

    The distance is between ``least`` and ``most`` (turning radii). If ``is_left_out`` is true, the
    leg adds nothing to the tour's length, and the leg is not projected onto ``unit``.
    """

    unit: complex
    least: float
    most: float
    views: tuple[View, ...] = ()
    is_left_out: bool = False


class Cell(msgspec.Struct, frozen=True):
    """A range of headings (rad) between two legs.

    ``heading`` is the middle of the range. ``cost`` is the least loss (rad) from the start of the
    tour up to this cell. ``before`` is the cell at the previous corner from which this cell has the
    least cost.
    """

    heading: float
    width: float = 0.0
    cost: float = 0.0
    before: Cell | None = None


_Sight: TypeAlias = tuple[float, int, float]
"""A heading error, its side (-1, 0 or 1), and the turtle's advance while the error falls to 0."""


class Turning(msgspec.Struct, frozen=True, kw_only=True):
    """How a turtle turns on a tour, and into how many cells its headings are divided.

    Attributes:
        half: The largest possible heading error (rad): pi, or pi / 2 if the turtle may also drive
            in reverse.
        tick: The largest turn at the start of a tick, before the turtle moves (rad).
        parts: At a corner, the number of cells into which each range of ``half / 8`` (rad) is
            divided.
        last: The wanted heading at the end of the tour (rad); None for any heading.
        slack: How far the heading at the end may be from ``last``, to either side (rad).
    """

    half: float
    tick: float
    parts: int
    last: float | None = None
    slack: float = 0.0


def least_loss(
    heading: complex,
    legs: Sequence[Leg],
    turning: Turning,
    *,
    known: dict[tuple[Leg, ...], list[Cell]] | None = None,
    tried: Sequence[float] | None = None,
    enough: float = -math.inf,
) -> tuple[float, list[float]]:
    """Return the least time lost by turning on a tour, and the headings (rad) at its corners.

    The function adds up the losses on all legs. A loss of 1 rad is the time in which the turtle
    turns by 1 rad at full rate.

    Args:
        heading: The heading at the start, a unit vector.
        legs: The legs in order, at least one.
        turning: How the turtle turns.
        known: A cache for calls with the same ``heading`` and ``turning``. Each key consists of the
            first legs of a tour. The value lists the cells at the corner before the last leg of the
            key. The function adds its own results to the cache.
        tried: A guess of the best headings (rad), one for each corner. The function tries the guess
            first. If ``known`` is not given, the function skips headings that cannot be better than
            the guess.
        enough: A loss (rad). If the headings in ``tried`` lose at most ``enough``, the function
            tries no other headings.
    """
    corners = [_corner(one, next_, turning) for one, next_ in pairwise(legs)]
    wanted = None if turning.last is None else Cell(turning.last, 2.0 * turning.slack)
    limit = math.inf, list[float]()
    begun = [Cell(phase(heading))]
    if tried is not None:
        cells = begun
        for leg, corner, near in zip(legs, corners, tried, strict=False):
            cells = list(_pass(leg, cells, [_nearest(corner, near, turning.half)], turning))
        limit = _ended(cells, legs[-1], wanted, turning)
        if limit[0] <= enough:
            return limit
    most = limit[0] if known is None else math.inf
    known, cells = {} if known is None else known, begun
    for i, (leg, corner) in enumerate(zip(legs, corners, strict=False)):
        first = tuple(legs[: i + 2])
        if first not in known:
            ends = _pass(leg, cells, corner, turning, most, legs[i + 1]) if cells else ()
            known[first] = list(ends)
        cells = known[first]
    found = _ended(cells, legs[-1], wanted, turning) if cells else limit
    return min(found, limit) if most < math.inf else found


def _ended(
    cells: Sequence[Cell], leg: Leg, wanted: Cell | None, turning: Turning
) -> tuple[float, list[float]]:
    """Return the least time lost on the whole tour, and the headings at the tour's corners."""
    if wanted is None:
        costs = [cell.cost + _started(cell, leg, turning) for cell in cells]
        cost = min(costs)
        best: Cell | None = cells[costs.index(cost)]
    else:
        (end,) = _pass(leg, cells, [wanted], turning)
        cost, best = end.cost, end.before
    headings = []
    while best and best.before:
        headings.append(best.heading)
        best = best.before
    return cost, headings[::-1]


def _nearest(corner: Sequence[Cell], heading: float, half: float) -> Cell:
    """Return the cell that contains a heading, or else the nearest cell."""
    apart = [
        abs(math.remainder(cell.heading - heading, 2.0 * half)) - cell.width / 2.0
        for cell in corner
    ]
    return corner[apart.index(min(apart))]


def _corner(leg: Leg, following: Leg, turning: Turning) -> list[Cell]:
    """Return the cells at a corner: ranges that together cover all possible headings.

    Cells end exactly at the directions of the two legs and at the opposite directions. If both legs
    have room for their turns, return a single cell with the best heading. At the best heading, the
    turtle has made half of its turn before the corner.
    """
    half, begun = turning.half, phase(leg.unit)
    turn = math.remainder(phase(following.unit * leg.unit.conjugate()), 2.0 * half)
    if min(leg.least, following.least) >= ROOM:
        return [Cell(begun + math.copysign(max(0.0, abs(turn) - turning.tick) / 2.0, turn))]
    cells, rest = [], math.copysign(half, turn) - turn
    for length in (turn, rest, turn, rest):
        count = turning.parts * max(1, round(8.0 * abs(length) / half))
        width = abs(length) / count
        cells += [Cell(begun + (i + 0.5) / count * length, width) for i in range(count)]
        begun += length
    return cells


def _views(leg: Leg) -> Sequence[View]:
    """Return the projection of a leg onto its unit vector, unless left out, and its ``views``."""
    if leg.is_left_out:
        return leg.views
    return [View(phase(leg.unit), leg.least, leg.most), *leg.views]


def _sight(cell: Cell, view: View, half: float, tick: float = 0.0) -> _Sight:
    """Return a cell's least heading error in a view, after a turn of at most ``tick`` (rad)."""
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
    turning: Turning,
    limit: float = math.inf,
    following: Leg | None = None,
) -> Iterator[Cell]:
    """Yield the cells at the end of a leg. A cell's cost is the least time lost up to that cell.

    Omit a cell if its cost plus the least loss on the following leg exceeds ``limit``.
    """
    half, tick = turning.half, turning.tick
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
            cost = limit + _ROUNDING - _started(end, following, turning)
        most, wanted = cost, dict[int, _Sight]()
        for way in chain(hint, ways):  # try the view that was best for the previous cell first
            start, sights = way
            least = max(0.0, _turned(start, end, half) - tick) if leg.is_left_out else 0.0
            if start.cost + least >= cost:
                continue
            width = max(start.width + tick, end.width)
            for nth, i in enumerate(order):  # try the view that ruled out the previous way first
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
    """Sort cells by cost. Drop a cell if turning on the spot from another cell costs no more."""
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
    """Return the smallest angle (rad) between headings of two cells; negative if they overlap."""
    angle = abs(math.remainder(end.heading - start.heading, 2.0 * half))
    return angle - (start.width + end.width) / 2.0


def _between(start: _Sight, end: _Sight, view: View, half: float, width: float) -> float:
    """Return the least time lost on a leg with the heading errors ``start`` and ``end``.

    The true heading errors may be larger than ``start`` and ``end`` by up to ``width`` (rad).
    """
    sides = start[1] * end[1]
    if sides > 0:
        return _on_one_side(start, end, view, width)
    least = _on_both_sides(start, end, view, half, width)
    if sides < 0:
        return least
    return min(least, _on_one_side(start, end, view, width))


def _on_both_sides(start: _Sight, end: _Sight, view: View, half: float, width: float) -> float:
    """Return the least time lost on a leg whose two heading errors have opposite signs."""
    (error, _, made), (wanted, _, made_wanted) = start, end
    least = max(error - made + wanted - made_wanted, error + wanted - view.most)
    # Or the turtle turns the other way round: an error of half a turn is on both sides.
    whole = half - 1.0 - width
    away = max(0.0, half - error - width)
    if away + whole - wanted + made_wanted < least:
        least = min(least, away + _on_one_side((half, 0, 1.0), end, view, width))
    away = max(0.0, half - wanted - width)
    if away + whole - error + made < least:
        least = min(least, away + _on_one_side(start, (half, 0, 1.0), view, width))
    return least


def _on_one_side(one: _Sight, other: _Sight, view: View, width: float) -> float:
    """Return the least time lost on a leg whose two heading errors are to the same side.

    The heading error first falls, and then rises to its final value as late as possible.
    """
    (low, _, made_low), (high, _, made_high) = (one, other) if one < other else (other, one)
    lost = low - made_low + high - made_high
    sine = (made_low + made_high - view.least) / 2.0
    least = math.inf
    if sine <= 0.0:
        least = lost
    elif sine < made_low:
        least = lost - 2.0 * (math.asin(sine) - sine)
    made = made_high + width  # an upper limit that is quick to compute
    if made - made_low >= view.least and _made(high + width) - made_low >= view.least:
        # The turn alone may be enough.
        turned = high - made_high - _lost(low + width)
        least = min(least, max(0.0, turned, high - low - width - view.most))
    return least


def _started(cell: Cell, leg: Leg, turning: Turning) -> float:
    """Return the least time lost on a leg from a range of headings to any heading."""
    least = 0.0
    for view in _views(leg):
        if view.least > 0.0:
            error, _, made = _sight(cell, view, turning.half, turning.tick)
            rest = math.asin(max(0.0, made - view.least))
            least = max(least, view.gain + error - made - _lost(rest))
    return least


def _made(error: float) -> float:
    """Return how far (turning radii) a turtle advances while its heading error falls to zero."""
    return math.sin(error) if error < _RIGHT else 1.0


def _lost(error: float) -> float:
    """Return the time lost while a heading error falls to zero: F in the module's docstring."""
    return error - _made(error)
