"""The steering law: drives a turtle through targets in nearly the shortest time.

A pose and a target go in; a speed and a turn rate come out. The law remembers nothing between
calls, so if somebody else moves the turtle, it continues from its new place. The rules:

- **Turn hard, drive hard.** The turtle turns towards its aim at full rate, the short way round, and
  drives at full speed meanwhile. The shortest paths consist of arcs and straight lines (Dubins
  1957).
- **Choose the gear.** The style ``fastest`` reverses to a target behind the turtle. The style
  ``natural`` does so only if turning round and driving forwards would take three times as long.
- **Never orbit.** At full speed, a turtle would circle for ever round a target inside its turning
  circle. The shortest way to such a target begins with an arc in the other gear and keeps turning
  the same way (Souères, Fourquet and Laumond 1994). ``fastest`` drives that arc; the other styles
  turn on the spot.
- **Look one target ahead.** Before a turn, the turtle swings wide: a turn by an angle phi costs
  phi - sin(phi) over the turn rate, and only a quarter of that if half of the turn is made before
  the target. The turtle also cuts the inner side of the target's disc. It does neither if the
  target would then get into the turning circle. Styles that drive forwards turn to the next target
  as soon as the arc to that target leads through the current one. If the discs of two targets
  overlap, the turtle may drive to a point between them. It drives to that point if an arc leads
  there, or if it would otherwise have to turn round for the second target.
- **Land.** No tick turns beyond the aim or drives beyond the target. A step that would leave the
  area ends at its edge; there the turtle continues to turn.
- **Face last.** If a heading is wanted at the target, the turtle turns to that heading there, on
  the spot.
- **Ease.** With limited accelerations, the turtle does not swing wide, and only stops at the last
  target. It slows down early enough to stop before the target and the edge of the area, and to
  finish its turn on the way. While it rolls the wrong way, it does not turn. A turtle that comes
  fast into a corner may leave the area by centimetres.

`Helm` holds a command as long as the law would repeat it. Most ticks are like the one before:
straight on, or turning at full rate. So the helm asks the law twice: for this pose, and for the
pose to which the command leads some ticks later. If the answers are the same, the helm assumes the
same answer for all ticks in between, and holds the command for them. Then the helm looks ahead
again, twice as far each time, up to eight ticks. If the answers differ, the hold is not extended,
and the answer for the pose where it ends is the next command. The helm checks each pose: as soon as
the turtle is not where it should be, the hold ends. The helm holds no command while commands come
late. With limited accelerations it holds none either, because then the speeds change with every
tick. A hold ends before the target is reached, and never leads out of the area.

Why the turtle always arrives: let e be the angle to the target, d its distance, and R = v/omega the
radius of the turning circle. The law drives forwards only if tan(e) <= d / R. Then e/omega + d/v,
the time to turn on the spot and then drive, falls at least as fast as time passes, also at lower
speeds. In the other gear, this time falls at least half as fast, and e falls faster than at the
rate omega, so the turtle leaves that gear within e/omega. Therefore a target takes at most 1.5
e/omega + d/v; `time_bound` adds room for swinging wide. With limited accelerations, the turtle
drives at v <= omega d / (2 tan(e)) in the same region, and stands still elsewhere.

The law assumes that a command acts in the tick after the pose was seen, and that the turtle first
turns and then moves.

Source: L. E. Dubins, "On curves of minimal length with a constraint on average curvature", 1957;
J. A. Reeds and L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990;
P. Souères, J.-Y. Fourquet and J.-P. Laumond, "Set of reachable positions for a car", 1994;
R. Siegwart and I. R. Nourbakhsh, Introduction to Autonomous Mobile Robots, section 3.6.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Final, NamedTuple, get_args

import msgspec

from turtleact.actions.steering.limits import (
    MISS,
    Frame,
    Limits,
    Style,
    approach,
    inside,
    is_clear,
    landing,
    late,
    leads_back,
    ramp,
    reach,
    room,
    stopping_speed,
    sway,
    sweep,
    turn_to,
)
from turtleact.errors import InvalidMessage
from turtleact.geometry import distance, phase, wrap_angle

if TYPE_CHECKING:
    from turtleact.actions.steering.limits import Area, Point, Pose, Speeds

__all__ = ["LONGEST", "OLDEST", "STILL", "Helm", "Steering"]

# In half turns: the sharpest corner that a style takes without changing gear.
_CORNER: dict[Style, float] = {"natural": 1.0, "fastest": 0.5, "forward": 1.0}
_FORMER = {"arc": "fastest"}  # Former names of styles.
_WORTH = 3.0  # The style natural reverses if turning round would take this many times as long.
# With limited accelerations, the turtle drives at this share of the highest speed that its turn
# allows.
_SHARE = 0.5
_ROOM = 0.8  # Share of the way to the edge of the area in which it could stop.
_GLANCES = (0.0, 0.25, 0.5, 0.75, 1.0)  # Shares of a turn after which it may have to stop.

LONGEST: Final = 8
"""A command is held for at most this many ticks."""

OLDEST: Final = 32
"""After this many ticks even the same command is sent again, because a command lasts one second."""

STILL: Final = (0.0, 0.0)
"""The speeds of a turtle that stands still."""

_SAME = 3e-3
"""How far a held turn rate may lead away from the law's own course, as a share of the tolerance.

The error is computed as if the turn rates differed all the time by as much as at the end.
"""

_FOR_GOOD = 32 * LONGEST
"""A turn that shows no effect within this many ticks counts as zero, because poses are rounded."""

_ROUNDING = 1e-5
"""How far (m, rad) a pose may be from the expected one after a tick, because poses are float32."""


class Steering(msgspec.Struct, frozen=True):
    """A style of driving, under limits.

    Attributes:
        style: ``fastest`` drives forwards or in reverse, whichever is faster. ``natural`` reverses
            only to targets close behind it. ``forward`` never reverses. ``rotate_then_drive`` turns
            on the spot to face each target, then drives straight. ``arc`` is the former name of
            ``fastest``.
        limits: What the turtle may do.

    Raises:
        InvalidMessage: if there is no such style.

    Example:
        >>> Steering().command((5.0, 5.0, 0.0), (1.0, 5.0))
        (-2.0, 0.0)
        >>> Steering("forward").command((5.0, 5.0, 0.0), (1.0, 5.0))
        (0.0, -2.0)
    """

    style: Style = "fastest"
    limits: Limits = Limits()

    def __post_init__(self) -> None:
        if self.style in _FORMER:
            msgspec.structs.force_setattr(self, "style", _FORMER[self.style])
        if self.style not in get_args(Style):
            raise InvalidMessage("style", f"'{self.style}' is none of {', '.join(get_args(Style))}")

    def is_reached(self, pose: Pose, target: Point, *, theta: float | None = None) -> bool:
        """Whether the target is reached and, if given, the heading ``theta`` (rad)."""
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

        At the target the turtle stops, or turns to the heading. To make it drive through, pass the
        next target instead.

        Args:
            pose: Where the turtle is (m), and its heading (rad).
            target: Where to go.
            next_target: Where to go next. It shapes the approach to ``target``.
            speeds: The last command. Accelerations are counted from these speeds. If both ways
                round are equally good, the turtle keeps turning the same way, so that it does not
                dither when commands come late.
            theta: The heading (rad) at the target. If left out, any heading will do.

        Returns:
            Linear (m/s) and angular (rad/s) speed, each within its limit.
        """
        if distance(pose[0], pose[1], *target) <= self.limits.tolerance:
            return self._rest(pose, theta, speeds)
        goal = complex(*target)
        frame = Frame(complex(pose[0], pose[1]), cmath.rect(1.0, pose[2]))
        gear = self._gear(frame.see(goal), speeds[1])
        frame = Frame(frame.at, gear * frame.heading)
        if gear < 0.0 and self.style == "natural":
            next_target = None  # it will mostly leave the target forwards: no swing
        if self.limits.is_eased:
            driven = gear * speeds[0], speeds[1]
            linear, angular = self._eased(frame, goal, driven, is_last=next_target is None)
        else:
            after = None if next_target is None else complex(*next_target)
            linear, angular = self._at_once(frame, goal, after, speeds[1])
        return gear * linear + 0.0, angular

    def _rest(self, pose: Pose, theta: float | None, speeds: Speeds) -> Speeds:
        """The speeds to stop, and to turn to a heading if one is given."""
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

    @property
    def _turns_round(self) -> bool:
        """Whether the turtle drives forwards even to a target that lies behind the one before."""
        return self.style in ("natural", "forward")

    def _gear(self, seen: complex, turning: float) -> float:
        """1 to drive forwards, -1 in reverse."""
        if self.style == "natural":
            return -1.0 if self._is_worth_reversing(seen) else 1.0
        if self.style != "fastest":
            return 1.0
        if turning and abs(seen.real) < sway(abs(seen.imag), self.limits):
            return math.copysign(1.0, seen.imag * turning)
        return math.copysign(1.0, seen.real)

    def _is_worth_reversing(self, seen: complex) -> bool:
        """Whether turning round and driving forwards takes far longer than reversing.

        Both times are those of a turn on the spot and a straight drive to the target's disc. The
        choice does not change on the way: turning round leaves less to turn, and reversing brings
        the disc nearer.
        """
        limits, away = self.limits, abs(seen)
        half_width = math.asin(
            min(1.0, limits.tolerance / away)
        )  # the width of the disc as seen from here
        error, length = abs(phase(seen)), (away - limits.tolerance) / limits.radius
        reversing = max(0.0, math.pi - error - half_width) + length
        return max(0.0, error - half_width) + length >= _WORTH * reversing

    def _push(self, error: float, *, clear: bool) -> float:
        """1 to drive on in the gear, -1 to back away, 0 to turn on the spot."""
        if not clear:
            return -1.0 if self.style == "fastest" else 0.0
        return float(self.style != "rotate_then_drive" or abs(error) <= late(self.limits))

    def _at_once(
        self, frame: Frame, goal: complex, after: complex | None, turning: float
    ) -> Speeds:
        """Both speeds in the gear of ``frame`` when speeds may jump."""
        limits, miss = self.limits, MISS * self.limits.tolerance
        if after is not None and abs(after - goal) <= 2.0 * miss:
            # Both are reached from a point between them, unless the turtle would have to back away
            # for that. If it may not, and the second target lies back, turning to that point is
            # still less than turning round.
            between, less = (goal + after) / 2, miss - abs(after - goal) / 2
            turns = self._turns_round and leads_back(frame, goal, after, limits)
            if turns or is_clear(frame.see(between), limits, slack=less):
                goal, after, miss = between, None, less
        clear = is_clear(frame.see(goal), limits, slack=miss)
        area, aim = inside(goal, limits)
        if clear and after is not None and self.style in _CORNER:
            if self._turns_round and (turn := sweep(frame, goal, after, limits, area=area)):
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
        """Both speeds in the gear of ``frame`` when accelerations are limited."""
        limits = self.limits
        area, aim = inside(goal, limits)
        facing = late(limits) if self.style == "rotate_then_drive" else math.pi / 2
        error = turn_to(frame.see(aim), speeds[1], limits)
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
        """The speed (m/s) from which the turtle can still turn to its aim, and stop in time."""
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
            ends = min(ends, _ROOM * reach(area, ahead.at, ahead.heading, limits))
        return min(fastest, stopping_speed(ends, limits.max_acceleration, limits.dt))


class Course(NamedTuple):
    """The arguments of the law besides the pose and the speeds."""

    target: Point
    next_target: Point | None
    theta: float | None


class Helm:
    """Asks the law for commands, and holds each command as long as the law would repeat it.

    Args:
        steering: The steering law. Its ``limits.dt`` is the turtle's tick.
        longest: For how many ticks a command may be held, 1 or more.

    Attributes:
        speeds: The last command: linear (m/s) and angular (rad/s).
        at: The pose at which it was given, or the last pose at which it still held.
        left: For how many more ticks it holds; 0 if the next tick needs a new one.
    """

    def __init__(self, steering: Steering, longest: int = LONGEST) -> None:
        self.speeds: Speeds = STILL
        self.at: Pose = (0.0, 0.0, 0.0)
        self._steering = steering
        self._dt = steering.limits.dt
        self._longest = longest
        self.left = 0
        self._tried = 1
        self._age = 0
        self._step = self._turn = 0.0
        self._stride = (math.nan, 0.0, 0.0)
        self._known: tuple[Course, Speeds] | None = None

    @property
    def steering(self) -> Steering:
        """The steering law. A new law drops the held command, but keeps the first law's tick."""
        return self._steering

    @steering.setter
    def steering(self, steering: Steering) -> None:
        self._steering = steering
        self._let_go()

    def command(
        self,
        pose: Pose,
        target: Point,
        next_target: Point | None = None,
        *,
        theta: float | None = None,
    ) -> Speeds:
        """The speeds from this pose on, as from `Steering.command`."""
        course = Course(target, next_target, theta)
        is_obeyed = self.foresees(pose)
        if self._known is not None and self._known[0] == course and self.at == pose:
            self.speeds = self._known[1]
        else:
            self.speeds = self._ask(pose, course)
        straight = self.speeds[0], 0.0
        if self._longest > 1 and self._is_same(straight, _FOR_GOOD):
            self.speeds = straight
        self.at = pose
        self._known = None
        self._age = 0
        self._step, self._turn = self.speeds[0] * self._dt, self.speeds[1] * self._dt
        self._stride = (math.nan, 0.0, 0.0)
        self.left = self._hold(course) if is_obeyed else 0
        return self.speeds

    def holds(self, pose: Pose) -> bool:
        """Whether the command still applies at the next pose, so that no new one is needed."""
        if not self.left:
            return False
        if not self.foresees(pose):
            self._let_go()
            return False
        self.at = pose
        self._age += 1
        self.left -= 1
        if not self.left and self._known is not None and self._age < OLDEST:
            self.left = self._hold(self._known[0])
        return self.left > 0

    def foresees(self, pose: Pose) -> bool:
        """Whether a pose is that of the last command, or the expected pose one tick later."""
        (x, y, theta), (new_x, new_y, new_theta) = self.at, pose
        along, step_x, step_y = self._stride
        if along != new_theta:  # else it goes straight on
            step_x, step_y = self._step * math.cos(new_theta), self._step * math.sin(new_theta)
            self._stride = new_theta, step_x, step_y
        off = abs(theta + self._turn - new_theta)
        return (
            (off <= _ROUNDING or abs(wrap_angle(off)) <= _ROUNDING)
            and abs(x + step_x - new_x) <= _ROUNDING
            and abs(y + step_y - new_y) <= _ROUNDING
        ) or pose == self.at

    def stop(self) -> None:
        """Record that the turtle was told to stop."""
        self.speeds = STILL
        self._let_go()

    def _let_go(self) -> None:
        self.left = 0
        self._known = None

    def _ask(self, pose: Pose, course: Course) -> Speeds:
        target, next_target, theta = course
        return self._steering.command(pose, target, next_target, self.speeds, theta=theta)

    def _hold(self, course: Course) -> int:
        """For how many more ticks the command holds; 0 if only for the next one."""
        pose = self.at
        ticks = min(self._longest, 2 * self._tried, self._before(course.target))
        self._tried = max(1, ticks // 4)
        if ticks < 2:
            return 0
        there = self.pose_after(ticks)
        area, bulge = self._steering.limits.area, self._bulge(ticks)
        if not (_is_within(area, pose, bulge) and _is_within(area, there, bulge)):
            return 0
        command = self._ask(there, course)
        if not self._is_same(command, ticks):
            return 0
        self._tried = ticks
        self._known = course, command
        return ticks

    def _before(self, target: Point) -> int:
        """The number of ticks in which the turtle cannot yet reach the target."""
        limits = self._steering.limits
        if limits.is_eased:
            return 0
        away = distance(self.at[0], self.at[1], *target) - limits.tolerance
        step = abs(self._step)
        return int(away / step) if step and away < LONGEST * step else LONGEST

    def pose_after(self, ticks: int) -> Pose:
        """The pose to which the command leads in ``ticks`` ticks."""
        x, y, theta = self.at
        half = self._turn / 2.0
        # The sum of the steps, each along the heading at its end.
        sine = math.sin(half)
        length = self._step * (math.sin(ticks * half) / sine if sine else ticks)
        along = theta + (ticks + 1) * half
        return (
            x + length * math.cos(along),
            y + length * math.sin(along),
            theta + ticks * self._turn,
        )

    def _bulge(self, ticks: int) -> float:
        """How far the path of ``ticks`` ticks can deviate from a straight line (m)."""
        return abs(self._step * self._turn) * ticks * ticks / 8.0

    def _is_same(self, command: Speeds, ticks: int) -> bool:
        """Whether a command leads to nearly the same place as the held one in ``ticks`` ticks."""
        limits, speeds = self._steering.limits, self.speeds
        if command[0] != speeds[0] or not speeds[0]:
            return command == speeds
        lasts = ticks * self._dt
        aside = abs((command[1] - speeds[1]) * speeds[0]) * lasts * lasts / 2.0
        return aside <= _SAME * limits.tolerance


def _is_within(area: Area, pose: Pose, margin: float) -> bool:
    x, y, _ = pose
    return (
        area.left + margin <= x <= area.right - margin
        and area.bottom + margin <= y <= area.top - margin
    )
