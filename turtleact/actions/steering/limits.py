"""What a turtle may do, how its speed may change, and where it aims.

- `Limits`: speeds, accelerations, tolerances, and the `Area` in which the turtle stays.
- `ramp` and `stopping_speed`: the speed of the next tick under limited accelerations. The speed is
  constant within a tick. From one tick to the next, the speed changes by at most the acceleration
  times the length of a tick.
- `ramp_time`: the time to cover a length under a limited acceleration. These three functions work
  for lengths (m) and for angles (rad), and the acceleration may be infinite.
- `Frame`, `approach` and the other functions: where a turtle sees its target, and where it aims on
  the way there. Points are complex numbers, so that a multiplication by a unit vector turns them.

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
"""How far a turning circle may miss a target, as a fraction of the target's tolerance."""

_CUT = 0.75  # Share of the tolerance by which an aim is moved to the inner side of a corner.
_FACING = 0.5  # Approaches are shaped up to the angle to the target that has this cosine,
_SWING = 1.0 / 3.0  # and over at most this share of the way.
_MARGIN = 1e-3  # How far aims keep from the edge of the area (m), or a tenth of the tolerance.
_LATE = 3  # A command may come this many ticks late without harm.


class Area(msgspec.Struct, frozen=True):
    """The rectangle in which the turtle stays (m). Without arguments, the rectangle is infinite."""

    left: float = -math.inf
    bottom: float = -math.inf
    right: float = math.inf
    top: float = math.inf


class Limits(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """How fast a turtle may move, and how close to its targets it must come.

    Attributes:
        max_linear: Highest speed, forwards and backwards (m/s).
        max_angular: Highest turn rate, to either side (rad/s).
        max_acceleration: How fast the speed may change (m/s²); may be infinite.
        max_angular_acceleration: How fast the turn rate may change (rad/s²); may be infinite.
        tolerance: A target counts as reached at this distance or less (m).
        heading_tolerance: How far the turtle's heading may be from the wanted heading (rad).
        dt: Length of a tick (s).
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


def ramp_time(length: float, speed: float, acceleration: float) -> float:
    """Return the shortest time (s) to cover a length from rest, without stopping at its end.

    The speed rises at the highest acceleration up to the highest speed, and then stays constant.

    Args:
        length: The length or angle, 0 or more (m or rad).
        speed: The highest speed, above zero (m/s or rad/s).
        acceleration: The highest acceleration, above zero; may be infinite (m/s² or rad/s²).

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
        """Return how far a point is ahead (real part) and to the left (imaginary part), in m."""
        return (point - self.at) * self.heading.conjugate()

    def turned(self, angle: float) -> Frame:
        """Return the same place with the heading turned to the left by an angle (rad)."""
        return Frame(self.at, self.heading * cmath.rect(1.0, angle))


def turn_to(seen: complex, turning: float, limits: Limits) -> float:
    """Return the smaller angle by which a turtle can turn to a point (rad, positive to the left).

    If turning left and turning right are about equally long (see `late`), the sign of ``turning``
    decides.
    """
    error = wrap_angle(phase(seen))
    if error * turning < 0.0 and abs(error) > math.pi - late(limits):
        return math.copysign(math.pi, turning)
    return error


def late(limits: Limits) -> float:
    """Return how far the turtle can turn (rad) before a late command arrives.

    If a point is within this angle of the direction straight behind the turtle, turning left and
    turning right to the point count as equally long.
    """
    return min(_LATE * limits.turn, math.pi / 8)


def sway(aside: float, limits: Limits) -> float:
    """Return how far (m) a turtle's own motion can shift a point before a late command arrives.

    The shift is forwards or backwards in the turtle's frame. If the point is ahead or behind by
    less than the shift, it may change to the other side before a late command arrives. Driving
    forwards and reversing then count as equally good.

    Args:
        aside: How far the point is to the side (m).
        limits: The speeds of the turtle and the length of a tick.
    """
    return min(_LATE * (limits.turn * aside + limits.step), math.pi / 8 * aside)


def leads_back(frame: Frame, target: complex, after: complex, limits: Limits) -> bool:
    """Return whether the turtle must turn by more than 90° from the target to the next target.

    If the turtle can drive farther than the tolerance before a late command arrives, it could miss
    both ``target`` and ``after``. In this case, the function returns False.
    """
    back = ((target - frame.at) * (after - target).conjugate()).real < 0.0
    return back and _LATE * limits.step <= limits.tolerance


def nearest(area: Area, point: complex, limits: Limits) -> complex:
    """Return the nearest point to ``point`` that is in the area, with a margin to the edge."""
    margin = min(_MARGIN, limits.tolerance / 10)
    x = max(area.left + margin, min(area.right - margin, point.real))
    y = max(area.bottom + margin, min(area.top - margin, point.imag))
    return complex(x, y)


def inside(target: complex, limits: Limits) -> tuple[Area, complex]:
    """Return the area in which the turtle must stay, and the point to aim at for a target.

    If the target cannot be reached from inside the area, the returned area is infinite and the aim
    is the target itself.
    """
    aim = nearest(limits.area, target, limits)
    return (limits.area, aim) if abs(aim - target) <= limits.tolerance / 2 else (Area(), target)


def room(area: Area, at: complex, step: complex, limits: Limits) -> float:
    """Return the share of a step, 0 to 1, that the turtle can drive without leaving the area.

    The share is 1 for a turtle that is outside the area and moves towards the area.
    """
    # Half the margin of the aims, so that rounding on the way to an aim does not end at the edge.
    margin = min(_MARGIN, limits.tolerance / 10) / 2
    right = area.right - margin if step.real > 0.0 else area.left + margin
    top = area.top - margin if step.imag > 0.0 else area.bottom + margin
    across = (right - at.real) / step.real if step.real else 1.0
    up = (top - at.imag) / step.imag if step.imag else 1.0
    return max(0.0, min(1.0, across, up))


def reach(area: Area, at: complex, heading: complex, limits: Limits) -> float:
    """Return the distance straight ahead to the edge of the area (m)."""
    margin = min(_MARGIN, limits.tolerance / 10) / 2
    right = area.right - margin if heading.real > 0.0 else area.left + margin
    top = area.top - margin if heading.imag > 0.0 else area.bottom + margin
    across = (right - at.real) / heading.real if heading.real else math.inf
    up = (top - at.imag) / heading.imag if heading.imag else math.inf
    return max(0.0, min(across, up))


def is_clear(seen: complex, limits: Limits, *, slack: float = 0.0) -> bool:
    """Return whether the shortest path to a point begins without a change of gear.

    The turtle keeps its gear if it can face the point after an arc of at most a quarter turn. For
    this, the point must lie ahead of the turtle and outside its turning circle. If the point is
    farther to the side than the centre of the turning circle, it must lie at least one radius
    ahead. A point inside the turning circle by up to ``slack`` (m) counts as outside.
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
    aim = nearest(area, target + cut * inwards, limits)
    corner = aim - _arm(aim - frame.at, after - aim, limits.radius, sharpest)
    if nearest(area, corner, limits) != corner or not is_clear(frame.see(corner), limits):
        return aim
    turned = frame.turned(saturate(phase(frame.see(corner)), limits.turn))
    return corner if is_clear(turned.see(aim) - limits.step, limits) else aim


def sweep(frame: Frame, target: complex, after: complex, limits: Limits, *, area: Area) -> float:
    """Return the side of a turn to the next target: 1 for left, -1 for right, 0 to wait.

    The turn begins if its arc reaches the current target. The arc ends after a
    quarter turn, or as soon as the turtle heads in the direction from the current target to the
    next target. The turn does not begin if the turtle would leave the area in the next tick.
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
    """Return the vector from a path's corner to the point in the target's disc; see `approach`.

    The direction of the vector is midway between the direction to the target and the direction from
    the target to the next target. The arc determines the length of the vector, which is at most
    `_SWING` times the distance from the turtle to the point.
    """
    turn = phase(leg / way)
    if abs(turn) > sharpest:
        turn -= math.copysign(math.pi, turn)
    length = min(radius * math.tan(abs(turn) / 4), _SWING * abs(way))
    return cmath.rect(length, turn / 2) * way / abs(way)


def landing(seen: complex, limits: Limits) -> float:
    """Return the fraction of a full step that the turtle may drive without passing its target."""
    lands = 0.0 < seen.real < limits.step and abs(seen.imag) <= limits.tolerance
    return seen.real / limits.step if lands else 1.0
