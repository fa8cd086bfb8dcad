"""What a turtle may do, how its speed may change, and where it aims.

- `Limits`: speeds, accelerations, tolerances, and the `Area` in which the turtle stays.
- `ramp`, `stopping_speed`, `ramp_time`: speeds under limited accelerations. These functions count
  in ticks: a speed holds for a tick, and the next speed differs by at most the acceleration times
  the tick. The functions work for lengths (m) and for angles (rad). An acceleration may be
  infinite.
- `Frame`, `approach` and the rest: where a turtle sees its target, and where it aims on the way
  there. Points are complex numbers here, so a turn is a product.

Source: Lynch and Park, Modern Robotics, section 9.2.2.2 (trapezoidal motion profiles); for aiming,
the sources of `turtleact.actions.steering.law`.
"""

from __future__ import annotations

import cmath
import math
from functools import cached_property
from typing import Literal, TypeAlias

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.geometry import phase, saturate, wrap_angle

__all__ = [
    "MISS",
    "Area",
    "Frame",
    "Limits",
    "Point",
    "Pose",
    "Speeds",
    "Style",
    "approach",
    "inside",
    "is_clear",
    "landing",
    "late",
    "leads_back",
    "ramp",
    "ramp_time",
    "reach",
    "room",
    "stopping_speed",
    "sway",
    "sweep",
    "turn_to",
]

Pose: TypeAlias = tuple[float, float, float]
"""x and y (m), and the heading (rad, any angle)."""

Point: TypeAlias = tuple[float, float]
"""x and y (m)."""

Speeds: TypeAlias = tuple[float, float]
"""Linear (m/s, negative in reverse) and angular speed (rad/s, positive to the left)."""

Style: TypeAlias = Literal["natural", "fastest", "forward", "rotate_then_drive"]

MISS = 0.9
"""Share of the tolerance by which a turning circle may miss the target."""

_CUT = 0.75  # Share of the tolerance by which an aim is moved to the inner side of a corner.
_FACING = 0.5  # Approaches are shaped up to the angle to the target that has this cosine,
_SWING = 1.0 / 3.0  # and over at most this share of the way.
_MARGIN = 1e-3  # How far aims keep from the edge of the area (m), or a tenth of the tolerance.
_LATE = 3  # A command may come this many ticks late without harm.


class Area(msgspec.Struct, frozen=True):
    """The rectangle in which the turtle stays (m); without arguments it is infinite."""

    left: float = -math.inf
    bottom: float = -math.inf
    right: float = math.inf
    top: float = math.inf


class Limits(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """What a turtle may do, and how close to its targets it must come.

    Attributes:
        max_linear: Highest speed, forwards and backwards (m/s).
        max_angular: Highest turn rate, to either side (rad/s).
        max_acceleration: How fast the speed may change (m/s²); may be infinite.
        max_angular_acceleration: How fast the turn rate may change (rad/s²); may be infinite.
        tolerance: A target at this distance or nearer is reached (m).
        heading_tolerance: How far a wanted heading may be off (rad).
        dt: Length of a tick (s).
        area: Where the turtle stays. It leaves the area only for a target outside.

    Raises:
        InvalidMessage: if a number is not above zero, or not finite where it must be, or a tick at
            full rate turns by more than pi/2 rad.
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
        """Whether an acceleration is limited."""
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


def ramp(wanted: float, now: float, most: float) -> float:
    """The speed of the next tick: the wanted one, or as near to it as the limit allows.

    Args:
        wanted: The wanted speed.
        now: The speed of this tick, in the same unit.
        most: The largest change from tick to tick, zero or more; may be infinite.

    Example:
        >>> ramp(2.0, 0.5, 0.25), ramp(0.5, 0.6, 0.25)
        (0.75, 0.5)
    """
    return max(now - most, min(now + most, wanted))


def stopping_speed(room: float, acceleration: float, dt: float) -> float:
    """The highest speed for the next tick after which the turtle can still stop within some room.

    From a speed v, the ticks until it stops cover v dt + (v - a dt) dt + …, at most
    (v + a dt / 2)² / 2a. From any speed v <= a dt, the turtle stops within the tick.

    Args:
        room: The length or angle that it may still cover, 0 or more (m or rad).
        acceleration: Above zero (m/s² or rad/s²).
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


def ramp_time(length: float, speed: float, acceleration: float) -> float:
    """The shortest time (s) to cover a length from rest, without stopping at its end.

    The speed rises with the acceleration up to its limit, and then stays there.

    Args:
        length: 0 or more (m or rad).
        speed: The highest speed, above zero (m/s or rad/s).
        acceleration: Above zero (m/s² or rad/s²).

    Example:
        >>> ramp_time(4.0, 2.0, math.inf), ramp_time(4.0, 2.0, 2.0), ramp_time(0.25, 2.0, 2.0)
        (2.0, 2.5, 0.5)
    """
    rising = speed / acceleration
    if length >= speed * rising / 2.0:
        return length / speed + rising / 2.0
    return math.sqrt(2.0 * length / acceleration)


class Frame(msgspec.Struct, frozen=True):
    """Where the turtle is, and the unit vector along which it drives."""

    at: complex
    heading: complex

    def see(self, point: complex) -> complex:
        """How far a point is ahead (real part) and to the left (imaginary part), in m."""
        return (point - self.at) * self.heading.conjugate()

    def turned(self, angle: float) -> Frame:
        """The same place with its heading turned by an angle (rad)."""
        return Frame(self.at, self.heading * cmath.rect(1.0, angle))


def turn_to(seen: complex, turning: float, limits: Limits) -> float:
    """The angle to a point (rad), the short way round. In a tie, the side of ``turning`` wins."""
    error = wrap_angle(phase(seen))
    if error * turning < 0.0 and abs(error) > math.pi - late(limits):
        return math.copysign(math.pi, turning)
    return error


def late(limits: Limits) -> float:
    """How far a late command may turn (rad). Two ways round that differ by less count as equal."""
    return min(_LATE * limits.turn, math.pi / 8)


def sway(aside: float, limits: Limits) -> float:
    """How far late commands may shift a point along the heading (m).

    If a point is less far ahead or behind, both gears count as equally good.

    A turtle that backs away from a point beside it both turns and drives, and both shift the point.

    Args:
        aside: How far the point is to the side (m).
        limits: What the turtle may do.
    """
    return min(_LATE * (limits.turn * aside + limits.step), math.pi / 8 * aside)


def leads_back(frame: Frame, target: complex, after: complex, limits: Limits) -> bool:
    """Whether the next target lies behind this one.

    False if late commands could drive the turtle past both.
    """
    back = ((target - frame.at) * (after - target).conjugate()).real < 0.0
    return back and _LATE * limits.step <= limits.tolerance


def nearest(area: Area, point: complex, limits: Limits) -> complex:
    """The nearest point that lies in the area, with a margin."""
    margin = min(_MARGIN, limits.tolerance / 10)
    x = max(area.left + margin, min(area.right - margin, point.real))
    y = max(area.bottom + margin, min(area.top - margin, point.imag))
    return complex(x, y)


def inside(target: complex, limits: Limits) -> tuple[Area, complex]:
    """The area and the aim in it; an infinite area if the target cannot be reached from inside."""
    aim = nearest(limits.area, target, limits)
    return (limits.area, aim) if abs(aim - target) <= limits.tolerance / 2 else (Area(), target)


def room(area: Area, at: complex, step: complex, limits: Limits) -> float:
    """The share of a step, 0 to 1, that stays in the area; 1 if the step leads inwards."""
    # Half the margin of the aims, so that rounding on the way to an aim does not end at the edge.
    margin = min(_MARGIN, limits.tolerance / 10) / 2
    right = area.right - margin if step.real > 0.0 else area.left + margin
    top = area.top - margin if step.imag > 0.0 else area.bottom + margin
    across = (right - at.real) / step.real if step.real else 1.0
    up = (top - at.imag) / step.imag if step.imag else 1.0
    return max(0.0, min(1.0, across, up))


def reach(area: Area, at: complex, heading: complex, limits: Limits) -> float:
    """The distance straight ahead to the edge of the area (m)."""
    margin = min(_MARGIN, limits.tolerance / 10) / 2
    right = area.right - margin if heading.real > 0.0 else area.left + margin
    top = area.top - margin if heading.imag > 0.0 else area.bottom + margin
    across = (right - at.real) / heading.real if heading.real else math.inf
    up = (top - at.imag) / heading.imag if heading.imag else math.inf
    return max(0.0, min(across, up))


def is_clear(seen: complex, limits: Limits, *, slack: float = 0.0) -> bool:
    """Whether the shortest way to a point is to drive on.

    Driving on is shortest if the last turn is at most a quarter turn. Then the point lies outside
    the turning circle and, if it is farther aside than the circle's centre, at least a radius
    ahead. A point inside by up to ``slack`` (m) counts as outside.
    """
    if seen.real >= limits.radius:
        return True
    # A tick first turns and then moves, so the circle begins half a tick's turn later.
    begun = complex(seen.real, abs(seen.imag)) * cmath.rect(1.0, -limits.turn / 2)
    short = max(0.0, limits.radius - begun.imag)
    return begun.real > 0.0 and math.hypot(begun.real, short) >= limits.radius - slack


def approach(
    frame: Frame, target: complex, after: complex, limits: Limits, *, area: Area, sharpest: float
) -> complex | None:
    """The point to aim at on the way to a target before the last; None for the target itself.

    The path consists of a line to a corner, a line from there through the inner side of the
    target's disc, and the arc that joins them. The turtle aims at the corner while the disc would
    still be outside the turning circle after another tick that way. Then it aims at the disc.
    """
    way, leg = target - frame.at, after - target
    if abs(leg) <= limits.tolerance or frame.see(target).real < _FACING * abs(way):
        return None
    inwards = leg / abs(leg) - way / abs(way)
    # Two legs in one line have no inner side, so the shift fades out towards that case.
    cut = _CUT * limits.tolerance / max(0.5, abs(inwards))
    aim = nearest(area, target + cut * inwards, limits)
    corner = aim - _arm(aim - frame.at, after - aim, limits.radius, sharpest)
    if nearest(area, corner, limits) != corner or not is_clear(frame.see(corner), limits):
        return aim
    turned = frame.turned(saturate(phase(frame.see(corner)), limits.turn))
    return corner if is_clear(turned.see(aim) - limits.step, limits) else aim


def sweep(frame: Frame, target: complex, after: complex, limits: Limits, *, area: Area) -> float:
    """Whether to turn to the next target now: 1 to the left, -1 to the right, 0 not yet.

    The turtle turns if the arc leads through this target: the turning circle cuts its disc within a
    quarter turn, before it leads to the next target. It does not turn if it would leave the area in
    the next tick.
    """
    turn = wrap_angle(phase((after - target) * frame.heading.conjugate()))
    side = math.copysign(1.0, turn)
    seen = frame.see(target)
    begun = complex(seen.real, side * seen.imag) * cmath.rect(1.0, -limits.turn / 2)
    out = complex(limits.radius - begun.imag, begun.real)  # from the centre of the circle
    swept = phase(out)
    if abs(abs(out) - limits.radius) > MISS * limits.tolerance:
        return 0.0
    if not limits.turn < swept <= min(abs(turn), math.pi / 2):
        return 0.0
    turned = frame.turned(side * limits.turn)
    return side if room(area, turned.at, limits.step * turned.heading, limits) == 1.0 else 0.0


def _arm(way: complex, leg: complex, radius: float, sharpest: float) -> complex:
    """The vector from the corner to the aim: midway between way and leg, as long as needed."""
    turn = phase(leg / way)
    if abs(turn) > sharpest:
        turn -= math.copysign(math.pi, turn)
    length = min(radius * math.tan(abs(turn) / 4), _SWING * abs(way))
    return cmath.rect(length, turn / 2) * way / abs(way)


def landing(seen: complex, limits: Limits) -> float:
    """The share of a full step to take: 1, or less to end at the point nearest to the target."""
    lands = 0.0 < seen.real < limits.step and abs(seen.imag) <= limits.tolerance
    return seen.real / limits.step if lands else 1.0
