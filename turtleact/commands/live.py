"""Shows two live displays on a terminal: one of a goal, and one of a server.

`LivePrinter` shows a goal while it runs. When the goal ends, the last frame stays on the screen,
and the result follows below it. `Dashboard` shows the world and the goals of a running ``serve``.

The goals, their bodies and the world know nothing of the displays.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import anyio

from turtleact.commands.goal_printer import GoalPrinter
from turtleact.commands.panels import GoalRow, GoalView, PanelData, Picture, board, frame, inline
from turtleact.commands.screen import Screen, can_read_keys, typed_keys
from turtleact.commands.world_map import (
    POSE,
    POSES_A_FRAME,
    Braille,
    GoalPath,
    MapView,
    Motion,
    PoseTrails,
    Target,
    Turtle,
    colour_of,
    places_in,
    pose_topics,
    sends_a_turtle,
)
from turtleact.errors import TurtleactError
from turtleact.interfaces import to_dict
from turtleact.interfaces.standard import TurtlePose
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.commands.goal_printer import Followed
    from turtleact.goals.state import GoalStatus
    from turtleact.interfaces import Message
    from turtleact.node import ServerGoalHandle
    from turtleact.node.topics import Subscription
    from turtleact.sim.turtlesim import Turtlesim
    from turtleact.sim.world import Pose

    Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]

__all__ = ["Dashboard", "LivePrinter"]

MOST_LINES = 40
"""At most this many lines of a goal are printed."""

PAUSE = "p"
"""The key that pauses the goal, and resumes it."""


class LivePrinter(GoalPrinter):
    """Shows a running goal in a live display, and prints the plain text around it.

    Args:
        wants_feedback: Whether to print each feedback message too, on one line.
    """

    _shown: Followed  # from the acceptance on

    def __init__(self, *, wants_feedback: bool) -> None:
        super().__init__(wants_feedback=wants_feedback, most_lines=MOST_LINES)
        self._screen = Screen(self._compose)
        self._is_served = True
        self._course: GoalPath | None = None
        self._trails: PoseTrails | None = None
        self._feedback: Message | None = None
        self._heard = 0.0
        self._most_remaining = 0.0

    def follows(self, goal: Followed) -> None:
        """Show this goal. Its fields are unknown if another program has sent it."""
        self._shown = goal
        self._began = goal.node.clock.time() - goal.age
        request = goal.handle.request
        if request is not None:
            self._course = GoalPath(request)
        request = request or goal.action_type.Goal()
        drives, leader = sends_a_turtle(goal.name, request)
        if (drives or hasattr(request, "targets")) and leader in pose_topics(goal.node):
            self._trails = PoseTrails(goal.node, leader)

    def served(self, *, is_served: bool) -> None:
        """Show whether the goal has a server."""
        self._is_served = is_served

    def feedback(self, feedback: Message) -> None:
        """Print a feedback message on one line, because the display shows the last one in full."""
        print(f"Feedback: {inline(to_dict(feedback))}")

    async def animate(self) -> None:
        """Draw frames and react to keys until the task is cancelled."""
        async with anyio.create_task_group() as beside:
            if can_read_keys():
                beside.start_soon(self._obey_keys)
            await self._screen.run()

    async def _obey_keys(self) -> None:
        """Pause or resume the goal when the user presses P."""
        goal = self._shown.handle
        async for key in typed_keys():
            if key == PAUSE:
                # One request at a time: the next key is read when the server has answered. It then
                # does the opposite of the state that the server has told by then.
                try:
                    await (goal.resume() if goal.is_paused else goal.pause())
                except TurtleactError as error:
                    self.note(str(error))

    def close(self) -> None:
        """Restore the terminal."""
        self._screen.close()

    def _compose(self, *, width: int, height: int) -> Picture:
        handle = self._shown.handle
        has_ended = handle.status.is_terminal
        now = self._shown.node.clock.time()
        if handle.last_feedback is not self._feedback:
            self._feedback, self._heard = handle.last_feedback, now
        world = None if self._trails is None else self._trails.look(self._course)
        if world is not None and self._course is None:
            world = world._replace(targets=_target(self._feedback))
        fraction, progress = (None, "") if has_ended else self._progress(now)
        goal = GoalView(
            name=self._shown.name,
            goal=handle.request,
            goal_id=handle.goal_id.hex(),
            status=handle.status,
            age=now - self._began,
            feedback=self._feedback,
            fraction=fraction,
            progress=progress,
            marks=[] if has_ended else list(self._marks()),
        )
        return frame(goal, world, width=width, height=height)

    def _marks(self) -> Iterator[str]:
        if self._shown.handle.is_paused:
            yield "paused"
        if not self._is_served:
            yield "server gone"
        if self._trails is not None and self._trails.motion.is_reversing:
            yield "reversing"

    def _progress(self, now: float) -> tuple[float | None, str]:
        """Return the goal's progress as a fraction (0 to 1; None if unknown) and in words.

        The progress comes from the first feedback field with ``remaining`` in its name. Without a
        ``remaining`` field, the progress is the fraction of the goal's targets that the turtle has
        passed. If the goal has no targets, the text says how old the last feedback is.
        """
        course = self._course
        # Without the goal's message, nobody knows how much remained when the goal began.
        values = {} if self._feedback is None or course is None else to_dict(self._feedback)
        for name, value in values.items():
            if "remaining" in name and isinstance(value, float):
                self._most_remaining = max(self._most_remaining, abs(value), 1e-9)
                return 1 - abs(value) / self._most_remaining, f"{name} {abs(value):.2f}"
        if course is not None and course.stops:
            return course.passed / course.stops, course.told()
        if self._feedback is None:
            return None, ""
        return None, f"last feedback {now - self._heard:.1f} s ago"


def _target(feedback: Message | None) -> list[Target]:
    """Return the target in the feedback, as a list. The list is empty if there is no target."""
    values: Any = {} if feedback is None else to_dict(feedback)
    number = values.get("index", 0)
    places = places_in(values.get("target"))
    is_reached = values.get("is_reached") is True
    return [
        Target(*place, number + 1, is_reached=is_reached)
        for place in places
        if isinstance(number, int)
    ]


MOST_GOALS: Final = 100
"""A frame shows at most this many goals: the newest ones."""

MOST_ENDED: Final = 50
"""At most this many ended goals stay in the table."""

MOST_TURTLES: Final = 50
"""The map shows and follows at most this many turtles."""

NOT_READY: Final = "not ready yet"
"""The dashboard's heading before the first call of `Dashboard.say`."""


class Dashboard:
    """The live display of ``serve`` on a terminal. The lines of the log scroll above it."""

    def __init__(self) -> None:
        self._screen = Screen(self.compose)
        self._heading: list[str] = []
        self._goals: dict[bytes, _Served] = {}
        self._ended: deque[bytes] = deque()
        self._followed = 0
        self._sim: Turtlesim | None = None

    def begin(self, sim: Turtlesim) -> None:
        """Show this world from now on."""
        self._sim = sim

    def say(self, line: str) -> None:
        """Add a line to the heading, which is always shown."""
        self._heading.append(line)

    def tell(self, goal: Handle, new: GoalStatus) -> None:
        """Show a goal's new state."""
        goal_id = goal.goal_id
        if goal_id not in self._goals:
            self._goals[goal_id] = _Served(goal, may_follow=self._followed < MOST_TURTLES)
            self._followed += self._goals[goal_id].is_followed
        served = self._goals[goal_id]
        served.change(new)
        if new.is_terminal:
            self._followed -= served.is_followed
            self._ended.append(goal_id)
        while len(self._ended) > MOST_ENDED:
            del self._goals[self._ended.popleft()]

    def close(self) -> None:
        """Restore the terminal. A signal handler may call this."""
        self._screen.close()

    async def run(self) -> None:
        """Draw frames until the task is cancelled."""
        await self._screen.run()

    def compose(self, *, width: int, height: int) -> Picture:
        """Compose the current frame for a window of this many columns and lines."""
        sim = self._sim
        turtles = [] if sim is None else [_turtle(*each) for each in sim.turtles(MOST_TURTLES)]
        goals = self._in_order()
        rows = [goal.row({turtle.name for turtle in turtles}) for goal in goals]
        ahead = [target for row in rows for target in row.targets if not target.is_reached]
        world = None if sim is None else MapView(SIDE, turtles, _Drawn(sim), ahead)
        more = len(self._goals) - len(goals)
        paused = ["the world is paused"] if sim is not None and sim.is_paused else []
        heading = self._heading or [NOT_READY]
        shown = PanelData([*heading, *paused], world, rows, more)
        return board(shown, width=width, height=height)

    def _in_order(self) -> list[_Served]:
        """Return the newest goals: first those that still run, then those that have ended."""
        newest = list(islice(reversed(self._goals.values()), MOST_GOALS))
        return sorted(newest, key=lambda goal: goal.ended_at is not None)


class _Served:
    """A goal that the server runs, as shown on the dashboard.

    Args:
        goal: The goal.
        may_follow: Whether this object may subscribe to the pose of the goal's turtle.

    Attributes:
        is_followed: Whether this object has subscribed to the pose of the goal's turtle.
        ended_at: When the goal ended, by the clock of its node (s); None while the goal runs.
    """

    def __init__(self, goal: Handle, *, may_follow: bool) -> None:
        self._goal = goal
        self._name = goal.action_name
        self._goal_id = goal.goal_id.hex()
        self._clock = goal.node.clock
        self._began = self._clock.time()
        self._course = GoalPath(goal.request)
        self._motion = Motion()
        self._poses: Subscription[TurtlePose] | None = None
        self._status: GoalStatus = goal.status
        self.ended_at: float | None = None
        drives, leader = sends_a_turtle(self._name, goal.request)
        self._turtle = leader.removesuffix(POSE).strip("/") if drives else ""
        self.is_followed = may_follow and drives and self._course.stops > 0
        if self.is_followed:
            self._poses = goal.node.subscription(TurtlePose, leader, QoS(depth=POSES_A_FRAME))

    def change(self, status: GoalStatus) -> None:
        """Record the goal's new state."""
        self._status = status
        if status.is_terminal:
            self.look()  # the last place is often reached after the last frame
            self.ended_at = self._clock.time()
            if self._poses is not None:
                self._poses.close()

    def look(self) -> None:
        """Update the goal's progress with the new poses of its turtle."""
        if self._poses is None or self.ended_at is not None:
            return
        for pose in self._poses.drain():
            self._course.follow(pose.x, pose.y)
            self._motion.follow(pose.x, pose.y, pose.theta)

    def row(self, turtles: set[str]) -> GoalRow:
        """Return the goal's row in the table.

        The row names the goal's turtle only if ``turtles`` contains its name.
        """
        self.look()
        is_over = self.ended_at is not None
        turtle = self._turtle if self._turtle in turtles else ""
        colour = colour_of(turtle) if turtle else ""
        targets = [] if is_over or self._poses is None else self._course.targets()
        return GoalRow(
            self._name,
            self._goal_id,
            self._status,
            (self._clock.time() if self.ended_at is None else self.ended_at) - self._began,
            "" if self._poses is None else self._course.told(),
            turtle,
            colour,
            [target._replace(colour=colour or target.colour) for target in targets],
            list(self._marks()),
        )

    def _marks(self) -> Iterator[str]:
        """Yield remarks: that the goal was resumed, is paused, or that its turtle is reversing."""
        if self._goal.resumed is not None:
            yield "resumed"
        if self._goal.is_paused:
            yield "paused"
        elif self.ended_at is None and self._motion.is_reversing:
            yield "reversing"


class _Drawn:
    """The lines that the turtles of a world have drawn."""

    def __init__(self, sim: Turtlesim) -> None:
        self._sim = sim

    def canvas(self, columns: int, rows: int) -> Braille:
        """Return the turtles' lines as dots on a canvas of ``columns`` by ``rows`` characters."""
        canvas = Braille(columns, rows)
        top = canvas.height - 1
        for row, pixels in enumerate(self._sim.thumbnail(canvas.width, canvas.height)):
            for column, colour in enumerate(pixels):
                if colour is not None:
                    canvas.dot(column, top - row, _style(colour))
        return canvas


def _turtle(name: str, pose: Pose, _pen: object) -> Turtle:
    return Turtle(pose.x, pose.y, pose.theta, name, colour_of(name))


def _style(colour: tuple[int, int, int]) -> str:
    return "#" + bytes(colour).hex()
