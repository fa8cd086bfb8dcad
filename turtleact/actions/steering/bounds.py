"""How long a tour takes: at least, whatever drives the turtle, and at most, as the law drives it.

`shortest_time` is proven for every law that keeps to a style. `time_bound` is proven where
accelerations are not limited; how, stands in `turtleact.actions.steering.law`. Where they are, it
is an allowance, which the tests try to exceed.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, product

from turtleact.actions.steering.aiming import late
from turtleact.actions.steering.easing import ramp_time
from turtleact.actions.steering.law import Steering
from turtleact.actions.steering.limits import Limits, Point, Pose, Style
from turtleact.actions.steering.turning import ROOM, Cell, Leg, View, least_loss
from turtleact.geometry import distance, phase, wrap_angle

__all__ = ["rising_times", "shortest_time", "time_bound"]

# In half turns: what a style may spend on turning for one target.
_TURNING: dict[Style, float] = {"arc": 1.0, "forward": 1.5, "rotate_then_drive": 1.0}
_SPARE = 4  # Ticks for one target lost to rounding up: the end of the turn, the landing.
_ROUNDS = 6  # Of improving the points of a tour; more would not show in the bound.
_ANGLES = 0.5, 0.2  # By which directions are turned (rad), while that proves more:
_GAIN = 1e-3  # by more than this (s),
_TUNED = 6  # and in tours of so many targets.
_COARSE, _FINE = 1, 3  # Cells of headings to a part: to turn directions, and to prove by them,
_VIEWS = 8  # where a short leg is seen from as many directions too.


def time_bound(
    pose: Pose, targets: Sequence[Point], steering: Steering, *, theta: float | None = None
) -> float:
    """A time (s) within which the law reaches all targets in order, the last in a heading.

    For each target the time to drive to it at full speed, up to half a turn (``forward``: three
    quarters of one), and four ticks. With limited accelerations three times that, and four
    times for each target and once more the time to get up to speed, driving and turning.
    It holds where every command acts for its tick and nobody else moves the turtle.

    Args:
        pose: Where the turtle starts.
        targets: In order; none take no time.
        steering: The style and the limits.
        theta: The heading (rad) wanted at the last target; any if left out.
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
    """A time (s) below which no law of the style reaches the targets in order.

    It is that of the shortest line through the discs of all targets, and on top what a turtle
    must lose by turning: where it turns while it drives, the least sum over all headings that it
    may have at the targets (`turtleact.actions.steering.turning`), where it turns first and then
    drives, all of the turns.

    From rest it takes no less than the time to get up to speed; in a heading, no less than the
    turn to it.

    The line need not be exact: by duality any unit vectors prove the length that they measure along
    the legs with each point at its worst in its disc. A vector of no length leaves its leg out.
    Where a leg is too short for its turns, the vectors are turned until they prove no more, and
    such legs are seen from all around, in tours of six targets at most.

    Args:
        pose: Where the turtle starts, at rest.
        targets: In order; none take no time.
        steering: The style and the limits; the default ones if left out.
        theta: The heading (rad) wanted at the last target; any if left out.

    Source: Boyd and Vandenberghe, Convex Optimization, section 5.2 (weak duality).
    """
    return max(rising_times(pose, targets, steering or Steering(), theta=theta), default=0.0)


def rising_times(
    pose: Pose, targets: Sequence[Point], steering: Steering, *, theta: float | None = None
) -> Iterator[float]:
    """Times (s) below which no law of the style does it; the greatest is the `shortest_time`.

    A few milliseconds pass between two of them at most, so that others can have their turn. None
    where there are no targets.
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
    """The time (s) to turn to a heading, the short way round, if it need not be exact."""
    turn = max(0.0, abs(wrap_angle(angle)) - limits.heading_tolerance)
    return ramp_time(turn, limits.max_angular, limits.max_angular_acceleration)


def _tour(start: complex, centres: Sequence[complex], tolerance: float) -> list[complex]:
    """Points of the targets' discs that make a nearly shortest line."""
    touches = list(centres)
    for _ in range(_ROUNDS):
        before = start
        for i, centre in enumerate(centres):
            after = touches[i + 1] if i + 1 < len(centres) else before
            touches[i] = before = _touch(before, after - before, centre, tolerance)
    return touches


def _touch(before: complex, leg: complex, centre: complex, tolerance: float) -> complex:
    """The point of a disc that is nearest to a leg."""
    along = ((centre - before) * _unit(leg).conjugate()).real
    foot = before + max(0.0, min(abs(leg), along)) * _unit(leg)
    away = foot - centre
    return centre + away * min(1.0, tolerance / max(tolerance, abs(away)))


def _unit(leg: complex) -> complex:
    """The direction of a leg; zero if it has none."""
    return leg / abs(leg) if leg else leg


def _proven_length(
    start: complex, centres: Sequence[complex], units: Sequence[complex], tolerance: float
) -> float:
    """The least sum of unit * leg; a point weighs by how much the units at its sides differ.

    It is negative where units lead back: what turning takes is counted from there, not from zero.
    """
    total = -(start * units[0].conjugate()).real
    for centre, unit, leaving in zip(centres, units, [*units[1:], 0j], strict=True):
        pull = unit - leaving
        total += (centre * pull.conjugate()).real - tolerance * abs(pull)
    return total


def _turns(stops: Sequence[complex], theta: float, limits: Limits) -> Iterator[float]:
    """The time (s) of each turn on the spot, if it is made towards the best point of its disc."""
    heading, off = cmath.rect(1.0, theta), 0.0
    for i, (stop, target) in enumerate(pairwise(stops)):
        leg, ends = target - stop, (2.0 if i else 1.0) * limits.tolerance
        if abs(leg) <= ends:  # it may lead anywhere, on the way of the turn
            off += late(limits)
            continue
        leaves = math.asin(ends / abs(leg))
        angle = abs(phase(leg * heading.conjugate()))
        yield max(0.0, angle - off - leaves - late(limits)) / limits.max_angular
        heading, off = leg, leaves


class _Tour:
    """What unit vectors along its legs prove of a tour on which the turtle turns as it drives."""

    def __init__(
        self, pose: Pose, centres: Sequence[complex], steering: Steering, theta: float | None
    ) -> None:
        self._start, self._heading = complex(pose[0], pose[1]), cmath.rect(1.0, pose[2])
        self._centres = centres
        self._limits = steering.limits
        self._half = math.pi / 2 if steering.style == "arc" else math.pi
        self._theta = theta

    def proofs(self, units: Sequence[complex]) -> Iterator[tuple[float, float]]:
        """Proven lengths (m) and times (s), by these directions and better ones."""
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
        """The directions turned, or left out, one by one for as long as they prove more.

        After each attempt the best so far: the time (s) that they prove, they themselves, and the
        headings (rad) at the targets that they allow.
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
        """The legs that have a direction, or are seen in others, by which they are."""
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
        """A way seen in a direction, if both its ends together may be off by so much (m)."""
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
        """The time (s) that the directions prove, and headings (rad) at the targets that take it.

        No more than enough will do, if the tried headings take that.
        """
        limits, driven = self._limits, self._length(units) / self._limits.max_linear
        legs = self._legs(units, views)
        if not legs:
            return driven, [phase(self._heading)] * len(units)
        corners = list(legs)[:-1]  # each at the target of its leg
        turned, headings = least_loss(
            self._heading,
            list(legs.values()),
            half=self._half,
            tick=limits.turn,
            parts=parts,
            known=known,
            last=self._theta,
            slack=limits.heading_tolerance,
            tried=tried and [tried[i] for i in corners],
            enough=(enough - driven) * limits.max_angular,
        )
        found = dict(zip(corners, headings, strict=True))
        heading, all_ = phase(self._heading), []
        for i in range(len(units)):
            heading = found.get(i, heading)
            all_.append(heading)
        return driven + turned / limits.max_angular, all_
