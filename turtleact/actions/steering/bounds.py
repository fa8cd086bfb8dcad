"""How long a tour takes: at least, whatever drives the turtle, and at most, as the law drives it.

`shortest_time` is proven for every law that keeps to a style. `time_bound` is proven where
accelerations are not limited; how, stands in `turtleact.actions.steering.law`. Where they are, it
is an allowance, which the tests try to exceed.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from turtleact.actions.steering.aiming import late
from turtleact.actions.steering.easing import ramp_time
from turtleact.actions.steering.law import Steering
from turtleact.actions.steering.limits import Limits, Point, Pose, Style
from turtleact.geometry import distance, wrap_angle

__all__ = ["shortest_time", "time_bound"]

# In half turns: what a style may spend on turning for one target.
_TURNING: dict[Style, float] = {"arc": 1.0, "forward": 1.5, "rotate_then_drive": 1.0}
_SPARE = 4  # Ticks for one target lost to rounding up: the end of the turn, the landing.
_ROUNDS = 6  # Of improving the points of a tour; more would not show in the bound.


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
    must lose by turning. Where it turns while it drives, that is F(e) over the turn rate for an
    angle e to the line at the start, and twice F(e / 2) at a corner: F(e) is the integral of
    1 - cos, so e - sin(e), and of 1 beyond a right angle. A turtle that also drives in reverse
    counts the angle to the line either way. The two turns at the ends of a leg count within half
    of its time each. Where it turns first and then drives, it is all of the turns.

    From rest it takes no less than the time to get up to speed; in a heading, no less than the
    turn to it.

    The line need not be exact: by duality any unit vectors prove the length that they measure along
    the legs with each point at its worst in its disc.

    Args:
        pose: Where the turtle starts, at rest.
        targets: In order; none take no time.
        steering: The style and the limits; the default ones if left out.
        theta: The heading (rad) wanted at the last target; any if left out.

    Source: Boyd and Vandenberghe, Convex Optimization, section 5.2 (weak duality).
    """
    if not targets:
        return 0.0
    steering = steering or Steering()
    limits = steering.limits
    start, centres = complex(pose[0], pose[1]), [complex(*target) for target in targets]
    stops = [start, *_tour(start, centres, limits.tolerance)]
    units = [_unit(b - a) for a, b in pairwise(stops)]
    length = _proven_length(start, centres, units, limits.tolerance)
    if steering.style == "rotate_then_drive":
        losses = _turns([start, *centres], pose[2], limits)
    else:
        headings = [cmath.rect(1.0, pose[2]), *units]
        losses = _turning_losses([start, *centres], headings, steering, theta)
    driven = max(
        length / limits.max_linear + sum(losses),
        ramp_time(length, limits.max_linear, limits.max_acceleration),
    )
    return driven if theta is None else max(driven, _turn_time(theta - pose[2], limits))


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
    """The least sum of unit * leg; a point weighs by how much the units at its sides differ."""
    total = -(start * units[0].conjugate()).real
    for centre, unit, leaving in zip(centres, units, [*units[1:], 0j], strict=True):
        pull = unit - leaving
        total += (centre * pull.conjugate()).real - tolerance * abs(pull)
    return max(0.0, total)


def _turns(stops: Sequence[complex], theta: float, limits: Limits) -> Iterator[float]:
    """The time (s) of each turn on the spot, if it is made towards the best point of its disc."""
    heading, off = cmath.rect(1.0, theta), 0.0
    for i, (stop, target) in enumerate(pairwise(stops)):
        leg, ends = target - stop, (2.0 if i else 1.0) * limits.tolerance
        if abs(leg) <= ends:  # it may lead anywhere
            off = math.pi
            continue
        leaves = math.asin(ends / abs(leg))
        angle = abs(cmath.phase(leg * heading.conjugate()))
        yield max(0.0, angle - off - leaves - late(limits)) / limits.max_angular
        heading, off = leg, leaves


def _turning_losses(
    stops: Sequence[complex],
    headings: Sequence[complex],
    steering: Steering,
    theta: float | None,
) -> Iterator[float]:
    """The time (s) lost at the start, at each corner and at the end; none in a leg of no length."""
    limits, ends = steering.limits, steering.limits.tolerance
    before = math.inf
    for i, (stop, target) in enumerate(pairwise(stops)):
        time = max(0.0, abs(target - stop) - ends) / limits.max_linear
        half = time if theta is None and i + 2 == len(stops) else time / 2
        legs = 2 if i else 1  # They share the turn of a corner; at the start there is but one.
        turn = _turn(headings[i], headings[i + 1], steering)
        yield legs * _loss(turn / legs, min(before, half), limits)
        before, ends = half, 2.0 * limits.tolerance
    if theta is not None:
        turn = _turn(headings[-1], cmath.rect(1.0, theta), steering) - limits.heading_tolerance
        yield _loss(max(0.0, turn), before, limits)


def _turn(heading: complex, leaving: complex, steering: Steering) -> float:
    """The angle (rad) by which a turtle must turn, but for what it turns in a tick."""
    angle = abs(cmath.phase(heading * leaving.conjugate()))
    if steering.style == "arc":
        angle = min(angle, math.pi - angle)
    return max(0.0, angle - steering.limits.turn)


def _loss(angle: float, time: float, limits: Limits) -> float:
    """What turning by an angle, in a time (s), takes from the time for progress."""
    turned = min(angle, limits.max_angular * time)
    return (_lost(angle) - _lost(angle - turned)) / limits.max_angular


def _lost(angle: float) -> float:
    """The integral of what a heading takes from the progress along a line, from 0 to an angle."""
    return angle - math.sin(min(angle, math.pi / 2))
