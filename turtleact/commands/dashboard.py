"""The live dashboard of ``serve``: the world, the goals and what has happened, on a terminal.

It looks at the world and hears of the goals; neither knows of it, nor waits for it. What anybody
prints in this process meanwhile is a line of its log. When it ends, its lines are left standing.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TextIO, TypeAlias

import anyio

from turtleact import render
from turtleact.commands import frames
from turtleact.commands.printed import Log
from turtleact.commands.terminal import Region
from turtleact.commands.tracks import POSES_A_FRAME, Course, sends_a_turtle
from turtleact.interfaces.standard import TurtlePose
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.goal import GoalStatus
    from turtleact.server import ServerGoalHandle
    from turtleact.sim.turtlesim import Turtlesim
    from turtleact.topics import Subscription

    Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]

__all__ = ["Dashboard"]

MOST_LEFT: Final = 20
"""So many lines of the log are left standing."""

PATIENCE: Final = 0.5
"""So long a terminal has to take them (wall seconds)."""

MOST_GOALS: Final = 100
"""So many goals, the newest, are looked at for a frame."""

MOST_ENDED: Final = 50
"""So many goals that have ended stay in the table."""

MOST_TURTLES: Final = 50
"""So many turtles are on the map, and are followed on their way: of more, nothing could be told."""


class Dashboard:
    """What ``serve`` tells, on a terminal.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._region = Region(stream)
        self._heading: list[str] = []
        self._log = Log()
        self._goals: dict[bytes, _Served] = {}
        self._ended: deque[bytes] = deque()
        self._followed = 0
        self._sim: Turtlesim | None = None
        self._has_said = anyio.Event()

    def begin(self, sim: Turtlesim) -> None:
        """Show this world."""
        self._sim = sim

    def say(self, line: str) -> None:
        """A line that is always there."""
        self._heading.append(line)
        self._has_said.set()

    def tell(self, goal: Handle, new: GoalStatus, line: str, time: str) -> None:
        """A change of a goal.

        Args:
            goal: The goal.
            new: Its state now.
            line: The change as the log tells it.
            time: When it was, as the line says it.
        """
        goal_id = goal.goal_id
        if goal_id not in self._goals:
            self._goals[goal_id] = _Served(goal, may_follow=self._followed < MOST_TURTLES)
            self._followed += self._goals[goal_id].is_followed
        served = self._goals[goal_id]
        served.change(new)
        if new.is_terminal:
            self._followed -= served.is_followed
            self._ended.append(goal_id)
        short = line.replace(goal_id.hex(), goal_id.hex()[:8]).replace(time, time[:8])
        self._log.add(line, short)
        while len(self._ended) > MOST_ENDED:
            del self._goals[self._ended.popleft()]

    def close(self) -> None:
        """Give the terminal back; never blocks."""
        self._region.restore()

    @contextmanager
    def listening(self) -> Iterator[None]:
        """A block in which what is printed goes to the log; if that was never seen, to stderr."""
        try:
            with self._log.listening():
                yield
        finally:
            if not self._has_said.is_set():
                for line in self._log.lines():
                    print(line.full, file=sys.stderr)

    async def run(self) -> None:
        """Draw from the first line that is said until it is canceled; lines are left standing."""
        if not self._has_said.is_set():
            await self._has_said.wait()
        with suppress(OSError), self._region.held():  # if it goes, the server goes on without
            try:
                await frames.keep_drawing(self._region, self.compose)
            finally:
                kept = [line.full for line in self._log.lines()[-MOST_LEFT:]]
                self._region.say("".join(f"{line}\n" for line in (*self._heading, *kept)))
                with anyio.move_on_after(PATIENCE, shield=True):
                    await self._region.drained()

    def compose(self, *, width: int, height: int) -> render.Picture:
        """The picture as it is now."""
        turtles: list[render.Turtle] = []
        targets: list[render.Target] = []
        sim = self._sim
        if sim is not None:
            for name, pose, colour in sim.turtles(MOST_TURTLES):
                style = _style(colour)
                turtles.append(render.Turtle(pose.x, pose.y, pose.theta, name, style))
        goals = self._in_order()
        for goal in goals:
            targets += goal.look()
        world = None if sim is None else render.MapView(SIDE, turtles, _Drawn(sim), targets)
        rows = [goal.row() for goal in goals]
        log = [line.short for line in self._log.lines()]
        more = len(self._goals) - len(goals)
        shown = render.Board(self._heading, world, rows, more, log=log)
        return render.board(shown, width=width, height=height)

    def _in_order(self) -> list[_Served]:
        """The goals that run, then those that have ended, the newest of them first; not all."""
        newest = list(islice(reversed(self._goals.values()), MOST_GOALS))
        return sorted(newest, key=lambda goal: goal.ended_at is not None)


class _Served:
    """A goal that is served.

    Args:
        goal: The goal.
        may_follow: Whether the turtle that it drives may be followed.

    Attributes:
        is_followed: Whether it is.
        ended_at: When it ended, by the clock of its node (s), if it has.
    """

    def __init__(self, goal: Handle, *, may_follow: bool) -> None:
        self._goal = goal
        self._name = goal.action_name
        self._goal_id = goal.goal_id.hex()
        self._clock = goal.node.clock
        self._began = self._clock.time()
        self._course = Course(goal.request)
        self._poses: Subscription[TurtlePose] | None = None
        self._status: GoalStatus = goal.status
        self.ended_at: float | None = None
        drives, leader = sends_a_turtle(self._name, goal.request)
        self.is_followed = may_follow and drives and self._course.stops > 0
        if self.is_followed:
            self._poses = goal.node.subscription(TurtlePose, leader, QoS(depth=POSES_A_FRAME))

    def change(self, status: GoalStatus) -> None:
        """It has another state."""
        self._status = status
        if status.is_terminal:
            self.ended_at = self._clock.time()
            if self._poses is not None and self._poses.membership is not None:
                self._poses.membership.close()

    def look(self) -> list[render.Target]:
        """Where its turtle has yet to go."""
        if self._poses is None or self.ended_at is not None:
            return []
        for pose in self._poses.drain():
            self._course.follow(pose.x, pose.y)
        return self._course.ahead()

    def row(self) -> render.GoalRow:
        """Its row in the table."""
        now = self._clock.time() if self.ended_at is None else self.ended_at
        told = "" if self._poses is None else self._course.told()
        return render.GoalRow(self._name, self._goal_id, self._status, now - self._began, told)


class _Drawn:
    """What the turtles of a world have drawn."""

    def __init__(self, sim: Turtlesim) -> None:
        self._sim = sim

    def canvas(self, columns: int, rows: int) -> render.Braille:
        """The drawing in dots."""
        canvas = render.Braille(columns, rows)
        top = canvas.height - 1
        for row, pixels in enumerate(self._sim.thumbnail(canvas.width, canvas.height)):
            for column, colour in enumerate(pixels):
                if colour is not None:
                    canvas.dot(column, top - row, _style(colour))
        return canvas


def _style(colour: tuple[int, int, int]) -> str:
    return "#" + bytes(colour).hex()
