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
  target stays outside the turning circle, and cuts the inner side of its disc. Driving forwards
  only, it turns to the next target as soon as that arc leads through this one. Two targets whose
  discs overlap are reached from between them, where an arc leads there, or else, driving forwards
  only, if the second lies back.
- **Land.** No tick turns beyond the aim or drives beyond the target. A step that would leave the
  area ends at its edge, and the turtle turns on there.
- **Face last.** A heading that is wanted at the target is turned to there, on the spot.
- **Ease.** Where accelerations are limited, it is only as fast as it can still stop before the
  target and the edge of the area, and as it can turn meanwhile; while it rolls the wrong way it
  does not turn. It swings wide for no corner, and drives through a target without stopping. That
  keeps it in the area but for centimetres, where it comes fast into a corner.

Why it always arrives: let e be the angle to the target, d its distance, R = v/omega the radius of
the turning circle. The law only drives forwards where tan(e) <= d / R; there e/omega + d/v, the
time to turn on the spot and then drive, falls at least as fast as time passes, at lower speeds
too. In reverse it falls at least half as fast, and e faster than omega, so that this ends after
e/omega. So a target takes at most 1.5 e/omega + d/v; `time_bound` allows more, for the swing.
An eased turtle drives at v <= omega d / (2 tan(e)) in the same region, and stands still elsewhere.

Knows only that a command acts in the tick after the pose was seen, and that the turtle first turns
and then moves.

Source: L. E. Dubins, "On curves of minimal length with a constraint on average curvature", 1957;
J. A. Reeds and L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990;
P. Souères, J.-Y. Fourquet and J.-P. Laumond, "Set of reachable positions for a car", 1994;
R. Siegwart and I. R. Nourbakhsh, Introduction to Autonomous Mobile Robots, section 3.6.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, get_args

import msgspec

from turtleact.actions.steering.aiming import (
    MISS,
    Frame,
    approach,
    inside,
    is_clear,
    landing,
    late,
    leads_back,
    reach,
    room,
    sway,
    sweep,
    turn_to,
)
from turtleact.actions.steering.easing import ramp, stopping_speed
from turtleact.actions.steering.limits import Limits, Style
from turtleact.errors import InvalidMessage
from turtleact.geometry import distance, phase, wrap_angle

if TYPE_CHECKING:
    from turtleact.actions.steering.limits import Area, Point, Pose, Speeds

__all__ = ["Steering"]

# In half turns: the sharpest corner that a style takes without changing gear.
_CORNER: dict[Style, float] = {"arc": 0.5, "forward": 1.0}
_SHARE = 0.5  # Of the highest speed that a turn allows: what an eased turtle makes of it.
_ROOM = 0.8  # Share of the way to the edge of the area in which it could stop.
_GLANCES = (0.0, 0.25, 0.5, 0.75, 1.0)  # Shares of a turn after which it may have to stop.


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

    def is_reached(self, pose: Pose, target: Point, *, theta: float | None = None) -> bool:
        """Whether the target is within the tolerance, and a heading (rad) within its own."""
        if distance(pose[0], pose[1], *target) > self.limits.tolerance:
            return False
        return theta is None or abs(wrap_angle(theta - pose[2])) <= self.limits.heading_tolerance

    def command(
        self,
        pose: Pose,
        target: Point,
        next_target: Point | None = None,
        speeds: Speeds = (0.0, 0.0),
        *,
        theta: float | None = None,
    ) -> Speeds:
        """The speeds for the next tick.

        At the target the turtle comes to rest, or turns to the heading: if it shall drive through,
        ask for the next target instead.

        Args:
            pose: Where the turtle is (m), and its heading (rad).
            target: Where it shall go.
            next_target: Where it shall go after that, to shape the approach.
            speeds: What was last commanded. Accelerations are counted from there; and where both
                ways are as good, the turtle turns on that way, and does not dither when commands
                come late.
            theta: The heading (rad) in which it shall be there at last; any if left out.

        Returns:
            Linear (m/s) and angular (rad/s) speed, each within its limit.
        """
        if distance(pose[0], pose[1], *target) <= self.limits.tolerance:
            return self._rest(pose, theta, speeds)
        goal = complex(*target)
        frame = Frame(complex(pose[0], pose[1]), cmath.rect(1.0, pose[2]))
        gear = self._gear(frame.see(goal), speeds[1])
        frame = Frame(frame.at, gear * frame.heading)
        if self.limits.is_eased:
            driven = gear * speeds[0], speeds[1]
            linear, angular = self._eased(frame, goal, driven, is_last=next_target is None)
        else:
            after = None if next_target is None else complex(*next_target)
            linear, angular = self._at_once(frame, goal, after, speeds[1])
        return gear * linear + 0.0, angular

    def _rest(self, pose: Pose, theta: float | None, speeds: Speeds) -> Speeds:
        """The way to stand still, in a heading if one is given."""
        limits = self.limits
        linear = ramp(0.0, speeds[0], limits.max_acceleration * limits.dt)
        error = 0.0 if theta is None else wrap_angle(theta - pose[2])
        if abs(error) <= limits.heading_tolerance:
            error = 0.0
        return linear, self._turn_rate(error, speeds[1])

    def _turn_rate(self, error: float, turning: float) -> float:
        """The turn rate (rad/s) that ends an error (rad) soonest, without turning too far."""
        limits = self.limits
        ends = stopping_speed(abs(error), limits.max_angular_acceleration, limits.dt)
        wanted = math.copysign(min(ends, limits.max_angular), error) + 0.0
        return ramp(wanted, turning, limits.max_angular_acceleration * limits.dt)

    def _gear(self, seen: complex, turning: float) -> float:
        """1 to drive forwards, -1 in reverse."""
        if self.style != "arc":
            return 1.0
        if turning and abs(seen.real) < sway(abs(seen.imag), self.limits):
            return math.copysign(1.0, seen.imag * turning)
        return math.copysign(1.0, seen.real)

    def _push(self, error: float, *, clear: bool) -> float:
        """1 to drive on in the gear, -1 to back away, 0 to turn on the spot."""
        if not clear:
            return -1.0 if self.style == "arc" else 0.0
        return float(self.style != "rotate_then_drive" or abs(error) <= late(self.limits))

    def _at_once(
        self, frame: Frame, goal: complex, after: complex | None, turning: float
    ) -> Speeds:
        """Both speeds, in the gear, where they may change at once."""
        limits, miss = self.limits, MISS * self.limits.tolerance
        if after is not None and abs(after - goal) <= 2.0 * miss:
            # Both are reached from between them, unless it would have to back away for that; where
            # it may not, and the second lies back, turning to there is less than turning round.
            between, less = (goal + after) / 2, miss - abs(after - goal) / 2
            turns = self.style == "forward" and leads_back(frame, goal, after, limits)
            if turns or is_clear(frame.see(between), limits, slack=less):
                goal, after, miss = between, None, less
        clear = is_clear(frame.see(goal), limits, slack=miss)
        area, aim = inside(goal, limits)
        if clear and after is not None and self.style in _CORNER:
            if self.style == "forward" and (turn := sweep(frame, goal, after, limits, area=area)):
                return limits.max_linear, turn * limits.max_angular
            sharpest = _CORNER[self.style] * math.pi
            shaped = approach(frame, goal, after, limits, area=area, sharpest=sharpest)
            aim = aim if shaped is None else shaped
        error = turn_to(frame.see(aim), turning, limits)
        angular = self._turn_rate(error, turning)
        frame = frame.turned(angular * limits.dt)
        share = self._push(error, clear=clear) * landing(frame.see(goal), limits)
        share *= room(area, frame.at, share * limits.step * frame.heading, limits)
        return share * limits.max_linear, angular

    def _eased(self, frame: Frame, goal: complex, speeds: Speeds, *, is_last: bool) -> Speeds:
        """Both speeds, in the gear, where accelerations are limited."""
        limits = self.limits
        area, aim = inside(goal, limits)
        facing = late(limits) if self.style == "rotate_then_drive" else math.pi / 2
        error = turn_to(frame.see(aim), speeds[1], limits)
        if speeds[0] < 0.0 or (speeds[0] and abs(error) >= facing):
            # A turn while it rolls on could lead into a wall.
            wanted, angular = 0.0, self._turn_rate(0.0, speeds[1])
        else:
            angular = self._turn_rate(error, speeds[1])
            frame = frame.turned(angular * limits.dt)
            wanted = self._eased_speed(frame, aim, area, facing=facing, is_last=is_last)
        return ramp(wanted, speeds[0], limits.max_acceleration * limits.dt), angular

    def _eased_speed(
        self, frame: Frame, aim: complex, area: Area, *, facing: float, is_last: bool
    ) -> float:
        """The speed (m/s) from which it can still turn to its aim, and stop in time."""
        limits, seen = self.limits, frame.see(aim)
        error = phase(seen)
        if abs(error) >= facing:
            return 0.0
        rate = min(limits.max_angular, math.sqrt(limits.max_angular_acceleration * abs(error)))
        slope = math.tan(abs(error))
        fastest = min(limits.max_linear, _SHARE * rate * abs(seen) / slope if slope else math.inf)
        ends = max(0.0, abs(seen) - limits.tolerance / 2)
        if not (is_last or limits.step > limits.tolerance):  # it may drive through
            ends = ends / min(1.0, slope) if slope else math.inf
        for share in _GLANCES:
            ahead = frame.turned(share * error)
            ends = min(ends, _ROOM * reach(area, ahead.at, ahead.heading, limits))
        return min(fastest, stopping_speed(ends, limits.max_acceleration, limits.dt))
