"""The steering law: computes a speed and a turn rate from a pose and a target.

The law only calculates. It uses no topics, messages, clocks or simulator, and keeps no state
between calls, so if somebody else moves the turtle, the turtle continues from its new place. It has
two styles. With ``rotate_then_drive``, the turtle turns on the spot to face its target, then drives
straight. With ``natural``, it follows these rules:

- **Turn and drive at full speed.** The turtle turns the short way round towards the point that it
  aims at, and drives at full speed meanwhile. The shortest paths consist of arcs and straight lines
  (Dubins 1957).
- **Reverse only if it clearly pays.** The turtle reverses only to a target close behind it: if
  turning round and driving forwards would take at least three times as long.
- **Never circle round a target.** At full speed, a turtle would circle for ever round a target
  inside its turning circle. It therefore turns on the spot until the target is outside that circle.
- **Look one target ahead.** The turtle swings wide before a target, so that it can make half of the
  turn to the next target early. It cuts through the inner side of the target's disc, which contains
  all points that count as reached.
- **Stop in time.** Within a tick, the turtle never turns past its aim or drives past its target. If
  a step would leave the area, the turtle stops at the edge of the area and turns there.
- **Turn to a wanted heading last**, at the target, on the spot.
- **Brake early.** If the accelerations are limited, the turtle brakes early enough to finish its
  turn without swinging wide, to stop at the last target, and to stop before the edge of the area.
  A turtle that moves away from its aim first brakes to a halt, and only then turns. If a turtle
  drives fast into a corner of the area, it may leave the area by a few centimetres.

The turtle always arrives, for the following reason. Let e be the angle between the turtle's heading
and the direction to the target, and d the distance to the target. Let v be the full speed, omega
the full turn rate, and R = v/omega the radius of the turning circle. The turtle drives while it
turns only if tan(e) <= d / R. Let T = e/omega + d/v be the time to turn on the spot and then drive
straight. T falls by at least one second per second, so the turtle arrives within T. `time_limit`
adds time for the detour when the turtle swings wide.

The law assumes that a command for a pose takes effect in the next tick. A tick of the law may last
several ticks of the simulator, in which the turtle drives an arc. Points are complex numbers, so
that a multiplication by a unit vector turns them.

Source: Dubins, "On curves of minimal length with a constraint on average curvature", 1957; Lynch
and Park, Modern Robotics, section 9.2.2.2 (trapezoidal motion profiles).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Final, Literal, TypeAlias, get_args

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.geometry import distance, phase, saturate, wrap_angle

__all__ = [
    "STILL",
    "Area",
    "Limits",
    "Point",
    "Pose",
    "Speeds",
    "Steering",
    "Style",
    "ramp",
    "stopping_speed",
    "time_limit",
]

Pose: TypeAlias = tuple[float, float, float]
"""x and y (m), and the heading (rad, any angle)."""

Point: TypeAlias = tuple[float, float]
"""x and y (m)."""

Speeds: TypeAlias = tuple[float, float]
"""Linear (m/s, negative in reverse) and angular speed (rad/s, positive to the left)."""

Style: TypeAlias = Literal["natural", "rotate_then_drive"]

STILL: Final = (0.0, 0.0)
"""The speeds of a turtle that stands still."""

_WORTH = 3.0  # The turtle reverses if turning round would take this many times as long.
_MISS = 0.9  # How far a turning circle may miss a target, as a share of its tolerance.
_CUT = 0.75  # Share of the tolerance by which an aim is moved to the inner side of a corner.
_FACING = 0.5  # Approaches are shaped up to the angle to the target that has this cosine,
_SWING = 1.0 / 3.0  # and over at most this share of the way.
_MARGIN = 1e-3  # How far aims keep from the edge of the area (m), or a tenth of the tolerance.
_LATE = 3  # A command may come this many ticks late without harm.
_SPARE = 4  # Ticks that one target may lose to rounding up, after the turn and on arrival.
# With limited accelerations:
_SHARE = 0.5  # the turtle drives at this share of the highest speed that its turn allows,
_ROOM = 0.8  # and at a speed from which it could stop in this share of the way to the edge
_GLANCES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the area, after each of these shares of its turn.


class Area(msgspec.Struct, frozen=True):
    """The rectangle in which the turtle stays (m). Without arguments, the rectangle is infinite."""

    left: float = -math.inf
    bottom: float = -math.inf
    right: float = math.inf
    top: float = math.inf

    def nearest(self, point: complex, margin: float) -> complex:
        """Return the nearest point to ``point`` that is in the area, ``margin`` from the edge."""
        x = max(self.left + margin, min(self.right - margin, point.real))
        y = max(self.bottom + margin, min(self.top - margin, point.imag))
        return complex(x, y)

    def ahead(self, at: complex, way: complex, margin: float) -> float:
        """Return how many times ``way`` fits between ``at`` and the edge that it leads to."""
        right = self.right - margin if way.real > 0.0 else self.left + margin
        top = self.top - margin if way.imag > 0.0 else self.bottom + margin
        across = (right - at.real) / way.real if way.real else math.inf
        up = (top - at.imag) / way.imag if way.imag else math.inf
        return max(0.0, min(across, up))


class Limits(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """How fast a turtle may move, and how close to its targets it must come.

    Attributes:
        max_linear: Highest speed, forwards and backwards (m/s).
        max_angular: Highest turn rate, to either side (rad/s).
        max_acceleration: How fast the speed may change (m/s²); may be infinite.
        max_angular_acceleration: How fast the turn rate may change (rad/s²); may be infinite.
        tolerance: A target counts as reached at this distance or less (m).
        heading_tolerance: How far the turtle's heading may be from the wanted heading (rad).
        dt: Length of a tick, for which a command lasts (s).
        area: The rectangle in which the turtle stays. The turtle leaves the rectangle only to reach
            a target outside it. If an acceleration is limited, the turtle may also overshoot the
            edge by a few centimetres.

    Raises:
        InvalidMessage: if a number is not above zero, if a number other than an acceleration is not
            finite, or if the turtle would turn by more than pi/2 rad in a tick at full rate.
    """

    max_linear: float = 2.0
    max_angular: float = 2.0
    max_acceleration: float = math.inf
    max_angular_acceleration: float = math.inf
    tolerance: float = 0.1
    heading_tolerance: float = 0.05
    dt: float = 0.016
    area: Area = Area(0.0, 0.0, 11.088889, 11.088889)

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "tolerance", "heading_tolerance", "dt"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidMessage(name, f"must be finite and above zero, not {value}")
        for name in ("max_acceleration", "max_angular_acceleration"):
            value = getattr(self, name)
            if not value > 0.0:
                raise InvalidMessage(name, f"must be above zero, not {value}")
        if self.turn > math.pi / 2:
            raise InvalidMessage("dt", f"a tick may turn pi/2 rad at most, not {self.turn}")

    @cached_property
    def is_eased(self) -> bool:
        """Whether the linear or the angular acceleration is limited."""
        return min(self.max_acceleration, self.max_angular_acceleration) < math.inf

    @cached_property
    def step(self) -> float:
        """The distance driven in one tick at full speed (m)."""
        return self.max_linear * self.dt

    @cached_property
    def turn(self) -> float:
        """The angle turned in one tick at full rate (rad)."""
        return self.max_angular * self.dt

    @cached_property
    def radius(self) -> float:
        """The radius of the turning circle at full speed (m)."""
        return self.max_linear / self.max_angular

    @cached_property
    def margin(self) -> float:
        """How far aims keep from the edge of the area (m)."""
        return min(_MARGIN, self.tolerance / 10)

    @cached_property
    def late(self) -> float:
        """How far the turtle can turn (rad) before a late command arrives.

        If a point is within this angle of the direction straight behind the turtle, turning left
        and turning right to the point count as equally long.
        """
        return min(_LATE * self.turn, math.pi / 8)


def ramp(wanted: float, now: float, most: float) -> float:
    """Return the speed of the next tick: ``wanted``, or the nearest speed that ``most`` allows.

    Args:
        wanted: The wanted speed.
        now: The speed of this tick, in the unit of ``wanted``.
        most: The largest change from tick to tick, zero or more; may be infinite.

    Example:
        >>> ramp(2.0, 0.5, 0.25), ramp(0.5, 0.6, 0.25)
        (0.75, 0.5)
    """
    return max(now - most, min(now + most, wanted))


def stopping_speed(room: float, acceleration: float, dt: float) -> float:
    """Return the highest speed for the next tick that lets the turtle stop within ``room``.

    From a speed v, with ticks of length dt and an acceleration a, the turtle covers v dt + (v - a
    dt) dt + … until it stops. This distance is at most (v + a dt / 2)² / 2a. From any speed v <= a
    dt, the turtle stops within one tick.

    Args:
        room: The length or angle that the turtle may still cover, 0 or more (m or rad).
        acceleration: The highest acceleration, above zero; may be infinite (m/s² or rad/s²).
        dt: Length of a tick (s).

    Example:
        >>> stopping_speed(0.5, math.inf, 0.25)
        2.0
        >>> stopping_speed(8.0, 1.0, 0.5)
        3.75
    """
    at_once = room / dt
    if math.isinf(acceleration):
        return at_once
    change = acceleration * dt
    return min(at_once, max(change, math.sqrt(2.0 * acceleration * room) - change / 2.0))


def time_limit(
    pose: Pose, targets: Sequence[Point], limits: Limits, *, theta: float | None = None
) -> float:
    """Return a time (s) within which the steering law is sure to have reached all targets in order.

    For each target, the limit adds up a drive at full speed to the target and one tolerance
    farther, a turn by 270° at full rate, and four ticks. A wanted heading adds another turn by 180°
    and another four ticks. With limited accelerations, the sum is multiplied by 3, and 4 (n + 1)
    ramp times are added for n targets. A ramp time is the time to reach full speed from rest, plus
    the time to reach the full turn rate from rest. This last part is an estimate that no test has
    exceeded. All of this holds if every command takes effect in the tick for which it was computed,
    and nobody else moves the turtle.

    Args:
        pose: The pose at which the turtle starts: x and y (m), and the heading (rad).
        targets: The targets in order (m). Without targets, the time is 0.
        limits: What the turtle may do.
        theta: The wanted heading (rad) at the last target; None for any heading.
    """
    length = sum(distance(*a, *b) for a, b in pairwise([(pose[0], pose[1]), *targets]))
    spare = _SPARE * limits.dt + limits.tolerance / limits.max_linear
    turning = 1.5 * math.pi / limits.max_angular
    limit = length / limits.max_linear + len(targets) * (turning + spare)
    if theta is not None and targets:
        limit += math.pi / limits.max_angular + _SPARE * limits.dt
    if not limits.is_eased:
        return limit
    braking = limits.max_linear / limits.max_acceleration
    easing = braking + limits.max_angular / limits.max_angular_acceleration
    return 3.0 * limit + 4.0 * (len(targets) + 1) * easing


class Steering(msgspec.Struct, frozen=True):
    """A steering law: a style of driving, and the limits of the turtle.

    Attributes:
        style: ``natural`` or ``rotate_then_drive``.
        limits: The highest speeds and accelerations, the tolerances, and the area.

    Raises:
        InvalidMessage: if the style does not exist.

    Example:
        >>> Steering().command((5.0, 5.0, 0.0), (4.0, 5.0))
        (-2.0, 0.0)
        >>> Steering("rotate_then_drive").command((5.0, 5.0, 0.0), (4.0, 5.0))
        (0.0, -2.0)
    """

    style: Style = "natural"
    limits: Limits = Limits()

    def __post_init__(self) -> None:
        if self.style not in get_args(Style):
            raise InvalidMessage("style", f"'{self.style}' is none of {', '.join(get_args(Style))}")

    def is_reached(self, pose: Pose, target: Point, *, theta: float | None = None) -> bool:
        """Whether a pose is at the target and, if ``theta`` is given, has that heading (rad)."""
        if distance(pose[0], pose[1], *target) > self.limits.tolerance:
            return False
        return theta is None or abs(wrap_angle(theta - pose[2])) <= self.limits.heading_tolerance

    def command(
        self,
        pose: Pose,
        target: Point,
        next_target: Point | None = None,
        speeds: Speeds = STILL,
        *,
        theta: float | None = None,
    ) -> Speeds:
        """Return the speeds for the next tick.

        At the target, the turtle stops, or turns to the heading ``theta``. The turtle does not stop
        at a target if, as soon as the target is reached, you pass the next target as ``target``.

        Args:
            pose: The place of the turtle (m) and its heading (rad).
            target: The target to drive to (m).
            next_target: The target after ``target`` (m). The way to ``target`` also depends on
                ``next_target``.
            speeds: The speeds of the last command. If the accelerations are limited, the new speeds
                depend on the last speeds. If both ways to turn are equally long, the turtle keeps
                turning to the same side, so that it does not swing to and fro when commands come
                late.
            theta: The wanted heading (rad) at the target; None for any heading.

        Returns:
            The linear speed (m/s) and the turn rate (rad/s), each within its limit.
        """
        if distance(pose[0], pose[1], *target) <= self.limits.tolerance:
            return self._rest(pose, theta, speeds)
        goal = complex(*target)
        frame = Frame(complex(pose[0], pose[1]), cmath.rect(1.0, pose[2]))
        gear = self._gear(frame.see(goal))
        frame = Frame(frame.at, gear * frame.heading)
        if self.limits.is_eased:
            driven = gear * speeds[0], speeds[1]
            linear, angular = self._eased(frame, goal, driven, is_last=next_target is None)
        else:
            # After reversing it mostly leaves the target forwards, so it does not swing wide then.
            after = None if next_target is None or gear < 0.0 else complex(*next_target)
            linear, angular = self._at_once(frame, goal, after, speeds[1])
        return gear * linear + 0.0, angular

    def _rest(self, pose: Pose, theta: float | None, speeds: Speeds) -> Speeds:
        """Return the speeds that stop the turtle at the target, or turn it to ``theta`` there."""
        limits = self.limits
        linear = ramp(0.0, speeds[0], limits.max_acceleration * limits.dt)
        error = 0.0 if theta is None else wrap_angle(theta - pose[2])
        if abs(error) <= limits.heading_tolerance:
            error = 0.0
        return linear, self._turn_rate(error, speeds[1])

    def _turn_rate(self, error: float, turning: float) -> float:
        """Return the turn rate (rad/s) for the next tick of a turn by ``error`` (rad).

        With this rate, the turtle turns as fast as it can without turning too far.
        """
        limits = self.limits
        ends = stopping_speed(abs(error), limits.max_angular_acceleration, limits.dt)
        wanted = math.copysign(min(ends, limits.max_angular), error) + 0.0
        return ramp(wanted, turning, limits.max_angular_acceleration * limits.dt)

    def _gear(self, seen: complex) -> float:
        """Return 1 to drive forwards, or -1 to drive in reverse.

        The turtle could turn round on the spot, and drive straight to the target's disc. Or it
        could face away from the target, and reverse. The choice does not change on the way, because
        the chosen way gets shorter as the turtle follows it: while the turtle turns round, the
        angle that is left to turn shrinks. While it reverses, the distance to the disc shrinks.
        """
        if self.style != "natural":
            return 1.0
        limits, away = self.limits, abs(seen)
        half_width = math.asin(min(1.0, limits.tolerance / away))  # of the disc, as seen from here
        error, length = abs(phase(seen)), (away - limits.tolerance) / limits.radius
        reversing = max(0.0, math.pi - error - half_width) + length
        forwards = max(0.0, error - half_width) + length
        return -1.0 if forwards >= _WORTH * reversing else 1.0

    def _at_once(
        self, frame: Frame, goal: complex, after: complex | None, turning: float
    ) -> Speeds:
        """Return the speeds for a turtle whose accelerations are unlimited.

        The linear speed is the speed along ``frame.heading``.
        """
        limits, area = self.limits, self._area_for(goal)
        aim = area.nearest(goal, limits.margin)
        is_clear = _is_clear(frame.see(goal), limits, slack=_MISS * limits.tolerance)
        if self.style == "natural" and is_clear and after is not None:
            aim = _approach(frame, goal, after, limits, area=area) or aim
        error = _turn_to(frame.see(aim), turning, limits)
        angular = self._turn_rate(error, turning)
        if not is_clear or (self.style == "rotate_then_drive" and abs(error) > limits.late):
            return 0.0, angular
        turned = frame.turned(angular * limits.dt)
        share = _landing(turned.see(goal), limits)
        # The turtle moves between its old and its new heading. Half the margin of the aims, so that
        # rounding on the way to an aim does not end it.
        for heading in (frame.heading, turned.heading):
            step = limits.step * heading
            share = min(share, area.ahead(frame.at, step, limits.margin / 2))
        return share * limits.max_linear, angular

    def _eased(self, frame: Frame, goal: complex, speeds: Speeds, *, is_last: bool) -> Speeds:
        """Return the speeds for a turtle whose accelerations are limited.

        The linear speed is the speed along ``frame.heading``.
        """
        limits, area = self.limits, self._area_for(goal)
        aim = area.nearest(goal, limits.margin)
        facing = limits.late if self.style == "rotate_then_drive" else math.pi / 2
        error = _turn_to(frame.see(aim), speeds[1], limits)
        if speeds[0] < 0.0 or (speeds[0] and abs(error) >= facing):
            # While it rolls on, a turn could lead it into a wall.
            wanted, angular = 0.0, self._turn_rate(0.0, speeds[1])
        else:
            angular = self._turn_rate(error, speeds[1])
            frame = frame.turned(angular * limits.dt)
            wanted = self._eased_speed(frame, aim, area, facing=facing, is_last=is_last)
        return ramp(wanted, speeds[0], limits.max_acceleration * limits.dt), angular

    def _eased_speed(
        self, frame: Frame, aim: complex, area: Area, *, facing: float, is_last: bool
    ) -> float:
        """Return the highest speed (m/s) at which the turtle can turn to its aim and stop there."""
        limits, seen = self.limits, frame.see(aim)
        error = phase(seen)
        if abs(error) >= facing:
            return 0.0
        rate = min(limits.max_angular, math.sqrt(limits.max_angular_acceleration * abs(error)))
        slope = math.tan(abs(error))
        fastest = min(limits.max_linear, _SHARE * rate * abs(seen) / slope if slope else math.inf)
        ends = max(0.0, abs(seen) - limits.tolerance / 2)
        if not (is_last or limits.step > limits.tolerance):  # the turtle need not stop there
            ends = ends / min(1.0, slope) if slope else math.inf
        for share in _GLANCES:
            ahead = frame.turned(share * error)
            ends = min(ends, _ROOM * area.ahead(ahead.at, ahead.heading, limits.margin / 2))
        return min(fastest, stopping_speed(ends, limits.max_acceleration, limits.dt))

    def _area_for(self, target: complex) -> Area:
        """Return the area to stay in: none if the target cannot be reached from inside."""
        area, limits = self.limits.area, self.limits
        away = abs(area.nearest(target, limits.margin) - target)
        return area if away <= limits.tolerance / 2 else Area()


class Frame(msgspec.Struct, frozen=True):
    """Where the turtle is, and the unit vector along which it drives."""

    at: complex
    heading: complex

    def see(self, point: complex) -> complex:
        """Return how far a point is ahead (real part) and to the left (imaginary part), in m."""
        return (point - self.at) * self.heading.conjugate()

    def turned(self, angle: float) -> Frame:
        """Return the same place with the heading turned to the left by an angle (rad)."""
        return Frame(self.at, self.heading * cmath.rect(1.0, angle))


def _turn_to(seen: complex, turning: float, limits: Limits) -> float:
    """Return the smaller angle by which a turtle can turn to a point (rad, positive to the left).

    If turning left and turning right are about equally long, the sign of ``turning`` decides.
    """
    error = wrap_angle(phase(seen))
    if error * turning < 0.0 and abs(error) > math.pi - limits.late:
        return math.copysign(math.pi, turning)
    return error


def _is_clear(seen: complex, limits: Limits, *, slack: float = 0.0) -> bool:
    """Return whether the turtle can drive to a point without turning on the spot.

    It can if it faces the point after an arc of at most a quarter turn. For this, the point must
    lie ahead of the turtle and outside its turning circle. If the point is farther to the side than
    the centre of the turning circle, it must lie at least one radius ahead. A point inside the
    turning circle by up to ``slack`` (m) counts as outside.
    """
    if seen.real >= limits.radius:
        return True
    # A tick first turns and then moves, so the circle begins half a tick's turn later.
    begun = complex(seen.real, abs(seen.imag)) * cmath.rect(1.0, -limits.turn / 2)
    short = max(0.0, limits.radius - begun.imag)
    return begun.real > 0.0 and math.hypot(begun.real, short) >= limits.radius - slack


def _approach(
    frame: Frame, target: complex, after: complex, limits: Limits, *, area: Area
) -> complex | None:
    """Return the point to aim at on the way to ``target``, if ``after`` is the next target.

    If the turtle must aim directly at ``target``, return None.

    The path consists of a line to a corner, a line from the corner through the inner side of the
    target's disc, and an arc that joins the two lines. The turtle aims at the corner as long as the
    point on the inner side of the disc will still be outside the turning circle one tick later.
    After that, the turtle aims at the point on the inner side of the disc.
    """
    way, leg = target - frame.at, after - target
    if abs(leg) <= limits.tolerance or frame.see(target).real < _FACING * abs(way):
        return None
    inwards = leg / abs(leg) - way / abs(way)
    # Two legs in one line have no inner side, so the shift fades out towards that case.
    cut = _CUT * limits.tolerance / max(0.5, abs(inwards))
    aim = area.nearest(target + cut * inwards, limits.margin)
    corner = aim - _arm(aim - frame.at, after - aim, limits.radius)
    if area.nearest(corner, limits.margin) != corner or not _is_clear(frame.see(corner), limits):
        return aim
    turned = frame.turned(saturate(phase(frame.see(corner)), limits.turn))
    return corner if _is_clear(turned.see(aim) - limits.step, limits) else aim


def _arm(way: complex, leg: complex, radius: float) -> complex:
    """Return the vector from a path's corner to the point in the target's disc; see `_approach`.

    The direction of the vector is midway between the direction to the target and the direction from
    the target to the next target. The arc determines the length of the vector, which is at most
    `_SWING` times the distance from the turtle to the point.
    """
    turn = phase(leg / way)
    length = min(radius * math.tan(abs(turn) / 4), _SWING * abs(way))
    return cmath.rect(length, turn / 2) * way / abs(way)


def _landing(seen: complex, limits: Limits) -> float:
    """Return the fraction of a full step that the turtle may drive without passing its target."""
    lands = 0.0 < seen.real < limits.step and abs(seen.imag) <= limits.tolerance
    return seen.real / limits.step if lands else 1.0
