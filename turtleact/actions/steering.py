"""The law that drives a turtle through targets in nearly the shortest time.

A pose and a target go in, a speed and a turn rate come out. Nothing is remembered from call to
call: a turtle that somebody else moves is driven on from where it is. The rules:

- **Turn hard, drive hard.** It turns at its limit towards the aim, the short way round, and drives
  at its limit meanwhile: the shortest paths are arcs and straight lines (Dubins 1957).
- **Choose the gear.** A target behind is driven to in reverse, style permitting.
- **Never orbit.** A full-speed arc circles for ever round a target inside its turning circle. The
  shortest way to such a point begins with an arc in the other gear, and keeps turning the same way
  (Souères, Fourquet and Laumond 1994). Where reversing is not allowed, it turns on the spot.
- **Look one target ahead.** A turn by an angle a costs a - sin(a) over the turn rate: made half
  before the target and half after, a quarter of that. So the approach swings wide, as long as the
  target stays outside the turning circle, and cuts the inner side of its disc.
- **Land.** No tick turns beyond the aim or drives beyond the target. A step that would leave the
  area ends at its edge, and the turtle turns on there.

Why it always arrives: let e be the angle to the target, d its distance, R = v/omega the radius of
the turning circle. The law only drives forwards where tan(e) <= d / R; there e/omega + d/v, the
time to turn on the spot and then drive, falls at least as fast as time passes, at lower speeds
too. In reverse it falls at least half as fast, and e faster than omega, so that this ends after
e/omega. So a target takes at most 1.5 e/omega + d/v; `time_bound` allows more, for the swing.

Knows no topic, message, clock or simulator: only that a command acts in the tick after the pose
was seen, and that the turtle first turns and then moves.

Source: L. E. Dubins, "On curves of minimal length with a constraint on average curvature", 1957;
J. A. Reeds and L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990;
P. Souères, J.-Y. Fourquet and J.-P. Laumond, "Set of reachable positions for a car", 1994;
R. Siegwart and I. R. Nourbakhsh, Introduction to Autonomous Mobile Robots, section 3.6.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, TypeAlias, get_args

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.geometry import distance, saturate, wrap_angle

__all__ = ["Area", "Limits", "Point", "Pose", "Steering", "Style", "shortest_time", "time_bound"]

Pose: TypeAlias = tuple[float, float, float]
Point: TypeAlias = tuple[float, float]
Style: TypeAlias = Literal["arc", "forward", "rotate_then_drive"]

# Shares of the tolerance: how far the aim is moved from the target to the inner side of a corner,
# and by how much a turning circle may miss the target and still count as passing through it.
_CUT = 0.75
_MISS = 0.9
_FACING = 0.5  # Cosine of the angle to the target within which an approach is shaped,
_SWING = 1.0 / 3.0  # and over what share of the way at most.
_MARGIN = 1e-3  # How far aims keep from the edge of the area (m), or a tenth of the tolerance.
# In half turns: what a style may spend on turning for one target, and the sharpest corner that it
# takes without changing gear.
_TURNING: dict[Style, float] = {"arc": 1.0, "forward": 1.5, "rotate_then_drive": 1.0}
_CORNER: dict[Style, float] = {"arc": 0.5, "forward": 1.0}
_LATE = 3  # Ticks that a command may come late and do no harm.
_SPARE = 4  # Ticks for one target lost to rounding up: the end of the turn, the landing.
_ROUNDS = 6  # Of improving the points of a tour; more would not show in the bound.


class Area(msgspec.Struct, frozen=True):
    """The rectangle that the turtle stays in (m); without arguments it has no end."""

    left: float = -math.inf
    bottom: float = -math.inf
    right: float = math.inf
    top: float = math.inf


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What a turtle may do, and how near is near enough.

    Attributes:
        max_linear: Highest speed, forwards and backwards (m/s).
        max_angular: Highest turn rate, to either side (rad/s).
        tolerance: A target at this distance or nearer is reached (m).
        dt: Length of a tick (s).
        area: Where the turtle stays; a target outside is driven to all the same.

    Raises:
        InvalidMessage: if a number is not finite and above zero, or a tick turns over pi/2 rad.
    """

    max_linear: float = 2.0
    max_angular: float = 2.0
    tolerance: float = 0.1
    dt: float = 0.016
    area: Area = Area(0.0, 0.0, 11.088889, 11.088889)

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "tolerance", "dt"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidMessage(name, f"must be finite and above zero, not {value}")
        if self.turn > math.pi / 2:
            raise InvalidMessage("dt", f"a tick may turn pi/2 rad at most, not {self.turn}")

    @property
    def step(self) -> float:
        """The way of one tick at full speed (m)."""
        return self.max_linear * self.dt

    @property
    def turn(self) -> float:
        """The turn of one tick at full rate (rad)."""
        return self.max_angular * self.dt

    @property
    def radius(self) -> float:
        """Of the turning circle at full speed (m)."""
        return self.max_linear / self.max_angular


class Steering(msgspec.Struct, frozen=True):
    """A style of driving, under limits.

    Attributes:
        style: ``arc`` drives both ways, ``forward`` forwards only, ``rotate_then_drive`` turns to
            face each target and then drives straight, for those who want to see it.
        limits: What the turtle may do.

    Raises:
        InvalidMessage: if there is no such style.

    Example:
        >>> Steering().command((5.0, 5.0, 0.0), (1.0, 5.0))
        (-2.0, 0.0)
        >>> Steering("forward").command((5.0, 5.0, 0.0), (1.0, 5.0))
        (0.0, -2.0)
    """

    style: Style = "arc"
    limits: Limits = Limits()

    def __post_init__(self) -> None:
        if self.style not in get_args(Style):
            raise InvalidMessage("style", f"'{self.style}' is none of {', '.join(get_args(Style))}")

    def is_reached(self, pose: Pose, target: Point) -> bool:
        """Whether the target is within the tolerance."""
        return distance(pose[0], pose[1], *target) <= self.limits.tolerance

    def command(
        self, pose: Pose, target: Point, next_target: Point | None = None, turning: float = 0.0
    ) -> tuple[float, float]:
        """The speeds for the next tick.

        Both are zero once the target is reached: go on with the next one before asking.

        Args:
            pose: Where the turtle is (m), and its heading (rad).
            target: Where it shall go.
            next_target: Where it shall go after that, to shape the approach.
            turning: The angular speed last commanded. Where both ways are as good, the turtle
                turns on that way, and does not dither when commands come late.

        Returns:
            Linear (m/s) and angular (rad/s) speed, each within its limit.
        """
        if self.is_reached(pose, target):
            return 0.0, 0.0
        limits, goal = self.limits, complex(*target)
        frame = _Frame(complex(pose[0], pose[1]), cmath.rect(1.0, pose[2]))
        gear = self._gear(frame.see(goal), turning)
        frame = _Frame(frame.at, gear * frame.heading)
        is_clear = _is_clear(frame.see(goal), limits, slack=_MISS * limits.tolerance)
        area, aim = _inside(goal, limits)
        if is_clear and next_target is not None and self.style in _CORNER:
            sharpest = _CORNER[self.style] * math.pi
            after = complex(*next_target)
            shaped = _approach(frame, goal, after, limits, area=area, sharpest=sharpest)
            aim = aim if shaped is None else shaped
        error = _error(frame.see(aim), turning, limits)
        angular = saturate(error / limits.dt, limits.max_angular) + 0.0
        frame = frame.turned(angular * limits.dt)
        share = self._push(error, is_clear=is_clear) * _landing(frame.see(goal), limits)
        share *= _room(area, frame.at, share * limits.step * frame.heading, limits)
        return gear * share * limits.max_linear + 0.0, angular

    def _gear(self, seen: complex, turning: float) -> float:
        """1 to drive forwards, -1 in reverse."""
        if self.style != "arc":
            return 1.0
        if turning and abs(seen.real) < _late(self.limits) * abs(seen.imag):
            return math.copysign(1.0, seen.imag * turning)
        return math.copysign(1.0, seen.real)

    def _push(self, error: float, *, is_clear: bool) -> float:
        """1 to drive on in the gear, -1 to back away, 0 to turn on the spot."""
        if not is_clear:
            return -1.0 if self.style == "arc" else 0.0
        return float(self.style != "rotate_then_drive" or abs(error) <= _late(self.limits))


def time_bound(pose: Pose, targets: Sequence[Point], steering: Steering) -> float:
    """A time (s) within which the law reaches all targets in order; the module says why.

    It holds where every command acts for its tick and nobody else moves the turtle.
    """
    limits = steering.limits
    length = sum(distance(*a, *b) for a, b in pairwise([(pose[0], pose[1]), *targets]))
    spare = _SPARE * limits.dt + limits.tolerance / limits.max_linear
    turning = _TURNING[steering.style] * math.pi / limits.max_angular
    return length / limits.max_linear + len(targets) * (turning + spare)


def shortest_time(pose: Pose, targets: Sequence[Point], limits: Limits | None = None) -> float:
    """A time (s) below which no law at all reaches the targets in order.

    It is that of the shortest line through the discs of all targets, and on top what any turtle
    loses while its heading, driving either way, is not along the line: e - sin(e) over the turn
    rate for an angle e at the start, and twice that of half the angle at each corner. The two
    turns at the ends of a leg count within half of its time each.

    The line need not be exact: by duality any unit vectors prove the length that they measure along
    the legs with each point at its worst in its disc.

    Source: Boyd and Vandenberghe, Convex Optimization, section 5.2 (weak duality).
    """
    if not targets:
        return 0.0
    limits = limits or Limits()
    start, centres = complex(pose[0], pose[1]), [complex(*target) for target in targets]
    stops = [start, *_tour(start, centres, limits.tolerance)]
    units = [_unit(b - a) for a, b in pairwise(stops)]
    length = _proven_length(start, centres, units, limits.tolerance)
    losses = _turning_losses([start, *centres], [cmath.rect(1.0, pose[2]), *units], limits)
    return length / limits.max_linear + sum(losses)


class _Frame(msgspec.Struct, frozen=True):
    """Where the turtle is, and the unit vector along which it drives.

    Points are complex numbers from here on, so that a turn is a product.
    """

    at: complex
    heading: complex

    def see(self, point: complex) -> complex:
        """How far a point is ahead and, as the imaginary part, to the left (m)."""
        return (point - self.at) * self.heading.conjugate()

    def turned(self, angle: float) -> _Frame:
        return _Frame(self.at, self.heading * cmath.rect(1.0, angle))


def _error(seen: complex, turning: float, limits: Limits) -> float:
    """The angle to a point (rad), the short way round; as before where that is a tie."""
    error = wrap_angle(cmath.phase(seen))
    if error * turning < 0.0 and abs(error) > math.pi - _late(limits):
        return math.copysign(math.pi, turning)
    return error


def _late(limits: Limits) -> float:
    """How far a late command may turn (rad): as near to each other, two ways to turn are equal."""
    return min(_LATE * limits.turn, math.pi / 8)


def _nearest(area: Area, point: complex, limits: Limits) -> complex:
    """The nearest point that is in the area, by a margin."""
    margin = min(_MARGIN, limits.tolerance / 10)
    x = max(area.left + margin, min(area.right - margin, point.real))
    y = max(area.bottom + margin, min(area.top - margin, point.imag))
    return complex(x, y)


def _inside(target: complex, limits: Limits) -> tuple[Area, complex]:
    """The area and the target within it; no area if the target is not reached from inside."""
    aim = _nearest(limits.area, target, limits)
    return (limits.area, aim) if abs(aim - target) <= limits.tolerance / 2 else (Area(), target)


def _room(area: Area, at: complex, step: complex, limits: Limits) -> float:
    """The share of a step, 0 to 1, that stays in the area; all of it if it leads inwards."""
    # Half the margin of the aims, so that no rounding on the way to an aim ends at the edge.
    margin = min(_MARGIN, limits.tolerance / 10) / 2
    right = area.right - margin if step.real > 0.0 else area.left + margin
    top = area.top - margin if step.imag > 0.0 else area.bottom + margin
    across = (right - at.real) / step.real if step.real else 1.0
    up = (top - at.imag) / step.imag if step.imag else 1.0
    return max(0.0, min(1.0, across, up))


def _is_clear(seen: complex, limits: Limits, *, slack: float = 0.0) -> bool:
    """Whether driving on is the shortest way to a point.

    It is if the last turn is a quarter turn or less: the point is outside the turning circle and,
    where it is farther aside than the circle's centre, a radius ahead. Inside by no more than a
    slack (m) still counts as outside.
    """
    if seen.real >= limits.radius:
        return True
    # Steps that first turn and then move walk on a circle that begins half a turn later.
    begun = complex(seen.real, abs(seen.imag)) * cmath.rect(1.0, -limits.turn / 2)
    short = max(0.0, limits.radius - begun.imag)
    return begun.real > 0.0 and math.hypot(begun.real, short) >= limits.radius - slack


def _approach(
    frame: _Frame, target: complex, after: complex, limits: Limits, *, area: Area, sharpest: float
) -> complex | None:
    """Where to aim on the way to a target that is not the last; at itself if None.

    The path is two lines, to a corner and from there through the inner side of the target's disc,
    and the arc that joins them. It is the corner that is aimed at, as long as a tick towards it
    leaves the disc outside the turning circle; from there on it is the disc.
    """
    way, leg = target - frame.at, after - target
    if abs(leg) <= limits.tolerance or frame.see(target).real < _FACING * abs(way):
        return None
    inwards = leg / abs(leg) - way / abs(way)
    # Two legs in one line have no inner side; the shift fades out towards that.
    cut = _CUT * limits.tolerance / max(0.5, abs(inwards))
    aim = _nearest(area, target + cut * inwards, limits)
    corner = aim - _arm(aim - frame.at, after - aim, limits.radius, sharpest)
    if _nearest(area, corner, limits) != corner or not _is_clear(frame.see(corner), limits):
        return aim
    turned = frame.turned(saturate(cmath.phase(frame.see(corner)), limits.turn))
    return corner if _is_clear(turned.see(aim) - limits.step, limits) else aim


def _arm(way: complex, leg: complex, radius: float, sharpest: float) -> complex:
    """From corner to aim: halfway between arriving and leaving, as long as the arc needs."""
    turn = cmath.phase(leg / way)
    if abs(turn) > sharpest:
        turn -= math.copysign(math.pi, turn)
    length = min(radius * math.tan(abs(turn) / 4), _SWING * abs(way))
    return cmath.rect(length, turn / 2) * way / abs(way)


def _landing(seen: complex, limits: Limits) -> float:
    """The share of a full step to make: all, or up to where it is nearest to the target."""
    lands = 0.0 < seen.real < limits.step and abs(seen.imag) <= limits.tolerance
    return seen.real / limits.step if lands else 1.0


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


def _turning_losses(
    stops: Sequence[complex], headings: Sequence[complex], limits: Limits
) -> Iterator[float]:
    """The time (s) lost at the start and at each corner; none in a leg without a direction."""
    before, ends = math.inf, limits.tolerance
    for i, (stop, target) in enumerate(pairwise(stops)):
        half = max(0.0, abs(target - stop) - ends) / limits.max_linear / 2
        angle = abs(cmath.phase(headings[i] * headings[i + 1].conjugate()))
        turn = max(0.0, min(angle, math.pi - angle) - limits.turn)
        legs = 2 if i else 1  # They share the turn of a corner; at the start there is but one.
        yield legs * _loss(turn / legs, min(before, half), limits)
        before, ends = half, 2.0 * limits.tolerance


def _loss(angle: float, time: float, limits: Limits) -> float:
    """What turning by an angle, in a time (s), takes from the time for progress."""
    turned = min(angle, limits.max_angular * time)
    return (turned - math.sin(angle) + math.sin(angle - turned)) / limits.max_angular
