"""The helm: commands of the law, held for as long as it would say nothing new.

The law is asked for one tick. Most ticks are like the one before, though: straight on, or turning
as hard as can be. So when it is asked, it is asked once more, for the pose to which its command
leads in some ticks. If its command there is the same, it is taken to be the same at all ticks
between, and is held so long; there it looks ahead anew, each time twice as far, eight ticks at
most. The command that it found last is the one to go on with where that fails.

Nothing is held any more from the tick on in which the turtle is not where it should be, so whatever
moves it is answered at once; nor while commands come late, as it is then not where they lead. A
hold ends before the target is reached, and no way that is held leaves the area. Speeds that change
by and by, as accelerations are limited, are not held at all.

Knows a pose each tick, of a turtle that first turns and then moves; no clock and no topic.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from turtleact.geometry import distance, wrap_angle

if TYPE_CHECKING:
    from turtleact.actions.steering.law import Steering
    from turtleact.actions.steering.limits import Area, Point, Pose, Speeds

__all__ = ["STILL", "Helm"]

LONGEST: Final = 8
"""Ticks that a command is held at most."""

OLDEST: Final = 32
"""Ticks after which a command is not held on: it lasts a second, though it would be the same."""

STILL: Final = (0.0, 0.0)
"""The speeds of a turtle that stands."""

_SAME = 3e-3
"""Share of the tolerance by which a turn rate that is held may lead aside of where the law would.

It is counted as if the turn rates differed all the while by what they differ at the end.
"""

_FOR_GOOD = 32 * LONGEST
"""Ticks in which a turn that does not show counts as none: it is but the rounding of poses."""

_ROUNDING = 1e-5
"""How far (m, rad) a turtle may be from where it should be after a tick: poses are float32."""


class Course(NamedTuple):
    """What the law is asked besides the pose and the speeds."""

    target: Point
    next_target: Point | None
    theta: float | None


class Helm:
    """A turtle's helm.

    Args:
        steering: The law; its tick is the turtle's.
        longest: How many ticks a command may be held, 1 or more.

    Attributes:
        speeds: What was commanded last: linear (m/s) and angular (rad/s).
        at: The pose at which that was, or the last one at which it still stood.
    """

    def __init__(self, steering: Steering, longest: int = LONGEST) -> None:
        self.speeds: Speeds = STILL
        self.at: Pose = (0.0, 0.0, 0.0)
        self._steering = steering
        self._dt = steering.limits.dt
        self._longest = longest
        self._left = 0
        self._tried = 1
        self._age = 0
        self._step = self._turn = 0.0
        self._stride = (math.nan, 0.0, 0.0)
        self._known: tuple[Course, Speeds] | None = None

    @property
    def steering(self) -> Steering:
        """The law; another one ends what is held. The turtle's tick stays that of the first."""
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
        """The speeds from here on, as `Steering.command` has them."""
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
        self._left = self._hold(course) if is_obeyed else 0
        return self.speeds

    def holds(self, pose: Pose) -> bool:
        """Whether the command stands at the next pose, too: nothing new is to be said there."""
        if not self._left:
            return False
        if not self.foresees(pose):
            self._let_go()
            return False
        self.at = pose
        self._age += 1
        self._left -= 1
        if not self._left and self._known is not None and self._age < OLDEST:
            self._left = self._hold(self._known[0])
        return self._left > 0

    def foresees(self, pose: Pose) -> bool:
        """Whether it is the pose of the last command, or the one to which that leads in a tick."""
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
        """Note that the turtle is told to stand still."""
        self.speeds = STILL
        self._let_go()

    def _let_go(self) -> None:
        self._left = 0
        self._known = None

    def _ask(self, pose: Pose, course: Course) -> Speeds:
        target, next_target, theta = course
        return self._steering.command(pose, target, next_target, self.speeds, theta=theta)

    def _hold(self, course: Course) -> int:
        """For how many ticks the command stands from here; 0 if it is for the next one alone."""
        pose = self.at
        ticks = min(self._longest, 2 * self._tried, self._before(course.target))
        self._tried = max(1, ticks // 4)
        if ticks < 2:
            return 0
        there = self._after(ticks)
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
        """For how many ticks the target is surely not reached; one that is reached is no more."""
        limits = self._steering.limits
        if limits.is_eased:
            return 0
        away = distance(self.at[0], self.at[1], *target) - limits.tolerance
        step = abs(self._step)
        return int(away / step) if step and away < LONGEST * step else LONGEST

    def _after(self, ticks: int) -> Pose:
        """The pose to which the command leads."""
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
        """How far the way there may lead aside of a straight line (m), at most."""
        return abs(self._step * self._turn) * ticks * ticks / 8.0

    def _is_same(self, command: Speeds, ticks: int) -> bool:
        """Whether a command is as good as the one that is held until there."""
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
