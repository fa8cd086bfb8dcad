"""The steering law: drives a turtle through targets in nearly the shortest time.

From a pose and a target, the law computes a speed and a turn rate. The law keeps no state between
calls, so if somebody else moves the turtle, the turtle continues from its new place. The law
follows these rules:

- **Turn and drive at full speed.** The turtle turns at full rate, the short way round, towards the
  point that it aims at. Meanwhile, it drives at full speed. The shortest paths consist of arcs and
  straight lines (Dubins 1957).
- **Choose the gear.** The turtle has two gears, forwards and reverse. With the style ``fastest``,
  the turtle drives in reverse to a target behind it. With the style ``natural``, the turtle drives
  in reverse only if turning round and driving forwards would take at least three times as long as
  reversing.
- **Never circle round a target.** At full speed, a turtle would circle for ever round a target
  inside its turning circle. The shortest path to a target inside the turning circle begins with an
  arc in the other gear, forwards or reverse. Along the whole path, the turtle turns only to the
  left or only to the right (Souères, Fourquet and Laumond 1994). With ``fastest``, the turtle
  drives the arc in the other gear. With the other styles, the turtle turns on the spot instead.
- **Look one target ahead.** A turn by an angle phi after a target costs the time (phi - sin(phi)) /
  omega, where omega is the turn rate. If the turtle makes half of the turn before the target, the
  turn costs only about a quarter of that time. The turtle therefore swings wide, so that it makes
  half of the turn before the target. The disc of a target contains all points that count as
  reached. The turtle drives through the inner side of this disc to shorten its way. The turtle
  swings wide and cuts through the disc only while the target is outside the turning circle. With
  ``natural`` and ``forward``, the turtle begins to turn to the next target as soon as this turn
  leads through the disc of the current target. If the discs of two targets overlap, the turtle may
  drive to the point midway between the two targets. The turtle drives there if it can reach that
  point without changing gear, or if it would otherwise have to turn round for the second target.
- **Stop in time.** Within a tick, the turtle never turns past its aim or drives past its target. If
  a step would leave the area, the turtle stops at the edge of the area and turns there.
- **Turn to a wanted heading last.** If a heading is wanted at the target, the turtle turns to that
  heading at the target, on the spot.
- **Brake early.** If the accelerations are limited, the turtle brakes early enough to finish its
  turn without swinging wide, to stop at the last target, and to stop before the edge of the area.
  The turtle drives through earlier targets without stopping, unless it drives farther than the
  tolerance in one tick at full speed. A turtle that moves away from its aim first brakes to a halt,
  and only then turns. If a turtle drives fast into a corner of the area, it may leave the area by a
  few centimetres.

`Helm` holds a command, which means that the turtle follows the command for several ticks without
asking the law again. In most ticks, the turtle drives straight on or turns at full rate, as in the
tick before. `Helm` therefore asks the law for two commands: one for the present pose, and one for
the pose of the turtle some ticks later. If the two commands differ, the turtle follows the first
command for only one tick. If the two commands are the same, `Helm` holds the command for all ticks
up to the later pose. After the held ticks, `Helm` looks ahead again, each time twice as far, up to
eight ticks. If `Helm` then needs a new command, it uses the command that the law has already
computed for the later pose.

`Helm` compares each pose with the expected pose. If the two poses differ, for example because a
command took effect late, `Helm` holds no command. With limited accelerations, `Helm` also holds no
command, because the speeds change with every tick. `Helm` stops holding a command before the turtle
reaches the target. A held command never leads out of the area.

The turtle always arrives, for the following reason. Let e be the angle between the turtle's heading
and the direction to the target, and d the distance to the target. Let v be the full speed, omega
the full turn rate, and R = v/omega the radius of the turning circle. The turtle drives on without a
change of gear only if tan(e) <= d / R. Let T = e/omega + d/v be the time to turn on the spot and
then drive straight. While the turtle drives on in the same gear, T falls by at least one second per
second, even below full speed. While the turtle drives an arc in the other gear, T falls by at least
half a second per second. On such an arc, e falls by more than omega per second, so the arc ends
within the time e/omega. The turtle therefore reaches a target within 1.5 e/omega + d/v.
`time_bound` adds time for the detour when the turtle swings wide. With limited accelerations, the
turtle drives no faster than omega d / (2 tan(e)) while e is below a quarter turn. If e is larger,
the turtle stands still and turns.

The law assumes that a command for a pose takes effect in the next tick. The law also assumes that
the turtle first turns and then moves in each tick.

Source: Dubins, "On curves of minimal length with a constraint on average curvature", 1957; Reeds
and Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990; Souères, Fourquet
and Laumond, "Set of reachable positions for a car", 1994; Siegwart and Nourbakhsh, Introduction to
Autonomous Mobile Robots, section 3.6.
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
"""A command lasts one second, so an unchanged command is sent again after this many ticks."""

STILL: Final = (0.0, 0.0)
"""The speeds of a turtle that stands still."""

_SAME = 3e-3
"""The allowed gap between a held command's path and the law's path, as a share of the tolerance.

The computation assumes that the turn rates of the two paths differ all the time as much as they
differ at the end.
"""

_FOR_GOOD = 32 * LONGEST
"""A turn that has no clear effect within this many ticks is replaced by driving straight on.

Poses are rounded, so a turn rate of the law may be a rounding error.
"""

_ROUNDING = 1e-5
"""How far (m, rad) a pose may be from the expected pose, because poses are float32."""


class Steering(msgspec.Struct, frozen=True):
    """A steering law: a style of driving, and the limits of the turtle.

    Attributes:
        style: With ``fastest``, the turtle drives forwards or in reverse, whichever is faster. With
            ``natural``, it reverses only to targets close behind it. With ``forward``, it never
            reverses. With ``rotate_then_drive``, it turns on the spot to face each target, then
            drives straight. ``arc`` is the former name of ``fastest``.
        limits: The highest speeds and accelerations, the tolerances, and the area.

    Raises:
        InvalidMessage: if the style does not exist.

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
        """Whether a pose is at the target and, if ``theta`` is given, has that heading (rad)."""
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

    @property
    def _turns_round(self) -> bool:
        """Whether the turtle keeps driving while it turns towards a next target behind it."""
        return self.style in ("natural", "forward")

    def _gear(self, seen: complex, turning: float) -> float:
        """Return 1 to drive forwards, or -1 to drive in reverse."""
        if self.style == "natural":
            return -1.0 if self._is_worth_reversing(seen) else 1.0
        if self.style != "fastest":
            return 1.0
        if turning and abs(seen.real) < sway(abs(seen.imag), self.limits):
            return math.copysign(1.0, seen.imag * turning)
        return math.copysign(1.0, seen.real)

    def _is_worth_reversing(self, seen: complex) -> bool:
        """Return whether turning round and driving forwards takes far longer than reversing.

        Each of the two ways consists of a turn on the spot and a straight drive to the target's
        disc. The choice does not change on the way, because the chosen way gets shorter as the
        turtle follows it. While the turtle turns round, the angle that is left to turn shrinks.
        While the turtle reverses, the distance to the target's disc shrinks.
        """
        limits, away = self.limits, abs(seen)
        half_width = math.asin(
            min(1.0, limits.tolerance / away)
        )  # the width of the disc as seen from here
        error, length = abs(phase(seen)), (away - limits.tolerance) / limits.radius
        reversing = max(0.0, math.pi - error - half_width) + length
        return max(0.0, error - half_width) + length >= _WORTH * reversing

    def _push(self, error: float, *, clear: bool) -> float:
        """Return 1 to keep the driving direction, -1 to reverse it, or 0 to turn on the spot.

        ``clear`` tells whether `is_clear` is true for the target.
        """
        if not clear:
            return -1.0 if self.style == "fastest" else 0.0
        return float(self.style != "rotate_then_drive" or abs(error) <= late(self.limits))

    def _at_once(
        self, frame: Frame, goal: complex, after: complex | None, turning: float
    ) -> Speeds:
        """Return the speeds for a turtle whose accelerations are unlimited.

        The linear speed is the speed along ``frame.heading``.
        """
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
        """Return the speeds for a turtle whose accelerations are limited.

        The linear speed is the speed along ``frame.heading``.
        """
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
            ends = min(ends, _ROOM * reach(area, ahead.at, ahead.heading, limits))
        return min(fastest, stopping_speed(ends, limits.max_acceleration, limits.dt))


class Course(NamedTuple):
    """The arguments of `Steering.command` other than the pose and the speeds."""

    target: Point
    next_target: Point | None
    theta: float | None


class Helm:
    """Gets commands from the steering law, and uses a command for several ticks if possible.

    Args:
        steering: The steering law. Its ``limits.dt`` is the length of the turtle's ticks.
        longest: The largest number of ticks for which a command may be held, 1 or more.

    Attributes:
        speeds: The last command: linear (m/s) and angular (rad/s).
        at: The newest pose for which the last command was computed or held.
        left: The number of ticks for which the last command is still held. If ``left`` is 0, the
            next tick needs a new command.
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
        """The steering law.

        If you set a new law, the helm no longer holds the last command. The helm keeps the tick
        length of its first law.
        """
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
        """Return the speeds for the next tick. The arguments are those of `Steering.command`."""
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
        """Return whether the last command is still held at a new pose."""
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
        """Return whether a pose equals ``at`` or the pose expected one tick after ``at``."""
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
        """Return the number of ticks to hold the command; 0 if the next tick needs a new one."""
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
        """Return a lower bound of the number of ticks until the turtle reaches the target.

        The bound is 0 if an acceleration is limited, and at most `LONGEST`.
        """
        limits = self._steering.limits
        if limits.is_eased:
            return 0
        away = distance(self.at[0], self.at[1], *target) - limits.tolerance
        step = abs(self._step)
        return int(away / step) if step and away < LONGEST * step else LONGEST

    def pose_after(self, ticks: int) -> Pose:
        """Return the pose to which the last command leads in ``ticks`` ticks."""
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
        """Return the largest distance (m) between an arc of ``ticks`` ticks and its chord."""
        return abs(self._step * self._turn) * ticks * ticks / 8.0

    def _is_same(self, command: Speeds, ticks: int) -> bool:
        """Return whether ``command`` leads to nearly the same place as the last command does.

        The places are compared after ``ticks`` ticks.
        """
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
