"""Draws two live displays on a terminal: one shows a goal, and the other shows a server.

`LiveTranscript` redraws a region at the end of the screen while a goal runs. Lines that must stay
on the screen are printed above the region as plain text. When the goal ends, the last frame of the
region stays on the screen, and the result follows below it.

`Dashboard` shows a running ``serve``: the world, the goals and the log.

The goals, their bodies and the world know nothing of the displays, and never wait for the terminal.
"""

from __future__ import annotations

import io
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import aclosing, contextmanager, redirect_stderr, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TextIO, TypeAlias

import anyio

from turtleact import render
from turtleact.commands.output import note
from turtleact.commands.terminal import (
    LogLines,
    Region,
    animate,
    keep_drawing,
    print_last,
    typed_keys,
)
from turtleact.commands.trails import (
    POSE,
    POSES_A_FRAME,
    Course,
    Motion,
    PoseTrails,
    colour_of,
    places_in,
    pose_topics,
    sends_a_turtle,
)
from turtleact.commands.transcript import PlainTranscript, result_text
from turtleact.errors import TurtleactError
from turtleact.interfaces import to_dict
from turtleact.interfaces.standard import TurtlePose
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.client import Outcome
    from turtleact.commands.transcript import Followed, Sent
    from turtleact.goal import GoalStatus
    from turtleact.interfaces import Message
    from turtleact.node import ServerGoalHandle
    from turtleact.sim.turtlesim import Turtlesim
    from turtleact.sim.world import Pose
    from turtleact.topics import Subscription

    Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]

__all__ = ["Dashboard", "GoalPicture", "LiveTranscript"]

MOST_LINES = 40
"""At most this many lines of a goal are printed."""

PAUSE = "p"
"""The key that pauses the goal, and resumes it."""

LEFT_FREE = 2
"""How many lines are kept free below the result, for an abort's reason and the shell's prompt."""


class LiveTranscript:
    """Shows a running goal in a live display, and prints the plain transcript above the display.

    Args:
        stream: The terminal.
        wants_feedback: Whether to print each feedback message too.
    """

    _picture: GoalPicture  # from the acceptance on

    def __init__(self, stream: TextIO, *, wants_feedback: bool) -> None:
        self.wants_feedback = wants_feedback
        self._has_keys = sys.stdin is not None and sys.stdin.isatty()
        self._region = Region(stream, sys.stdin if self._has_keys else None)
        self._plain = PlainTranscript(
            wants_feedback=wants_feedback, say=self._region.say, most_lines=MOST_LINES
        )

    def sending(self, goal: Message) -> None:
        """Called when the goal is about to be sent."""
        self._plain.sending(goal)

    def rejected(self, reason: str) -> None:
        """Called when the server has rejected the goal."""
        self._plain.rejected(reason)

    def accepted(self, sent: Sent) -> None:
        """Called when the server has accepted the goal."""
        self._plain.accepted(sent)
        self.follows(sent.followed())

    def follows(self, goal: Followed) -> None:
        """Called when the display starts to follow the goal."""
        self._picture = GoalPicture(goal)

    def served(self, *, is_served: bool) -> None:
        """Show whether the goal has a server."""
        self._picture.is_served = is_served

    async def animate(self) -> None:
        """Draw frames and react to keys until the task is cancelled."""
        with redirect_stderr(_Above(self._region, sys.stderr)):
            async with anyio.create_task_group() as beside:
                if self._has_keys:
                    beside.start_soon(self._obey_keys)
                await animate(self._region, self._picture.compose)

    async def _obey_keys(self) -> None:
        """Pause or resume the goal when the user presses P."""
        goal = self._picture.shown.handle
        async with aclosing(typed_keys(self._region)) as keys:
            async for key in keys:
                if key == PAUSE:
                    # One request at a time: the next key is read when the server has answered. It
                    # then does the opposite of the state that the server has told by then.
                    try:
                        await (goal.resume() if goal.is_paused else goal.pause())
                    except TurtleactError as error:
                        self.note(str(error))

    def feedback(self, feedback: Message) -> None:
        """Called with each feedback message."""
        self._plain.feedback(feedback)

    def status(self, status: GoalStatus) -> None:
        """Do nothing, because the next frame shows the state."""

    def canceling(self) -> None:
        """Called when the client asks the server to cancel the goal."""
        self._plain.canceling()

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the last frame, which stays on the screen, and then the result of the goal."""
        text = result_text(outcome)
        self._picture.has_ended = True
        print_last(self._region, self._picture.compose, below=text.count("\n") + LEFT_FREE)
        self._region.say(text)

    def note(self, text: str) -> None:
        """Print a note on stderr, above the next frame."""
        self._region.clear()
        note(text)

    async def drained(self) -> None:
        """Wait until the terminal has taken all text."""
        await self._region.drained()

    def close(self) -> None:
        """Restore the terminal, and remove the display unless the goal has ended."""
        self._region.restore()


class _Above(io.TextIOBase):
    """A stream on the same terminal as a display. Written text appears above the display.

    Args:
        region: The region of the display.
        stream: The stream to write to.
    """

    def __init__(self, region: Region, stream: TextIO) -> None:
        super().__init__()
        self._region = region
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, which appears above the next frame."""
        self._region.clear()
        return self._stream.write(text)

    def flush(self) -> None:
        """Flush the stream."""
        self._stream.flush()

    def fileno(self) -> int:
        """Return the file descriptor of the stream."""
        return self._stream.fileno()


class GoalPicture:
    """Composes the frames of a goal's display.

    Attributes:
        shown: The goal to display.
        has_ended: Whether the goal has ended. The display of an ended goal shows no progress.
        is_served: Whether the goal's server is on the graph.
    """

    def __init__(self, shown: Followed) -> None:
        self.has_ended = False
        self.is_served = True
        self.shown = shown
        self._clock = shown.node.clock
        self._began = self._clock.time() - shown.age
        self._course: Course | None = None
        self._trails: PoseTrails | None = None
        self._feedback: Message | None = None
        self._heard = 0.0
        self._most_remaining = 0.0
        topics = pose_topics(shown.node)
        if shown.goal is not None:
            drives, self._leader = sends_a_turtle(shown.name, shown.goal)
            drives = drives and self._leader in topics
            self._course = Course(shown.goal)
        else:  # unknown, unless the action's name says which turtle it drives
            goal = shown.goal_type()
            drives, self._leader = sends_a_turtle(shown.name, goal)
            drives = self._leader in topics if shown.name.count("/") > 1 else drives
            drives = bool(topics) and (drives or hasattr(goal, "targets"))
        if drives:
            self._trails = PoseTrails(shown.node, self._leader)

    def compose(self, *, width: int, height: int) -> render.Picture:
        """Compose the current frame for a window of this many columns and lines."""
        handle = self.shown.handle
        world = None
        if self._trails is not None:
            world = self._trails.look(self._course)
        now = self._clock.time()
        if handle.last_feedback is not self._feedback:
            self._feedback, self._heard = handle.last_feedback, now
        if world is not None and self.shown.goal is None:
            world = world._replace(targets=_target(self._feedback))
        fraction, progress = (None, "") if self.has_ended else self._progress(now)
        is_moving = self._trails is not None and not self.has_ended
        goal = render.GoalView(
            name=self.shown.name,
            goal=self.shown.goal,
            goal_id=handle.goal_id.hex(),
            status=handle.status,
            age=now - self._began,
            feedback=self._feedback,
            fraction=fraction,
            progress=progress,
            is_paused=handle.is_paused and not self.has_ended,
            is_served=self.is_served or self.has_ended,
            motion=self._trails.motion.told() if is_moving and self._trails is not None else "",
        )
        return render.frame(goal, world, width=width, height=height)

    def _progress(self, now: float) -> tuple[float | None, str]:
        """Return the goal's progress as a fraction (0 to 1; None if unknown) and in words.

        The progress comes from the first feedback field with ``remaining`` in its name. Without a
        ``remaining`` field, the progress is the fraction of the goal's targets that the turtle has
        passed. If the goal has no targets, the text says how old the last feedback is.
        """
        # Without the goal's message, nobody knows how much remained when the goal began.
        feedback = self._feedback if self.shown.goal is not None else None
        values = {} if feedback is None else to_dict(feedback)
        for name, value in values.items():
            if "remaining" in name and isinstance(value, float):
                self._most_remaining = max(self._most_remaining, abs(value), 1e-9)
                return 1 - abs(value) / self._most_remaining, f"{name} {abs(value):.2f}"
        course = self._course
        if course is not None and course.stops:
            return course.passed / course.stops, course.told()
        if self._feedback is None:
            return None, ""
        return None, f"last feedback {now - self._heard:.1f} s ago"


def _target(feedback: Message | None) -> list[render.Target]:
    """Return the target in the feedback, as a list. The list is empty if there is no target."""
    values: Any = {} if feedback is None else to_dict(feedback)
    number = values.get("index", 0)
    places = places_in(values.get("target"))
    is_reached = values.get("is_reached") is True
    return [
        render.Target(*place, number + 1, is_reached=is_reached)
        for place in places
        if isinstance(number, int)
    ]


MOST_LEFT: Final = 20
"""When the display ends, this many lines of the log stay on the screen."""

PATIENCE: Final = 0.5
"""How long the terminal may take to show the last lines of the log (s, wall clock)."""

MOST_GOALS: Final = 100
"""A frame shows at most this many goals: the newest ones."""

MOST_ENDED: Final = 50
"""At most this many ended goals stay in the table."""

MOST_TURTLES: Final = 50
"""The map shows and follows at most this many turtles."""

FIRST_LOOK: Final = 0.1
"""How often `Dashboard.run` checks whether the log has its first line (s)."""

NOT_READY: Final = "not ready yet"
"""The dashboard's heading before the first call of `Dashboard.say`."""


class Dashboard:
    """The live display of ``serve`` on a terminal.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._region = Region(stream)
        self._heading: dict[str, str] = {}  # by subject
        self._log = LogLines()
        self._goals: dict[bytes, _Served] = {}
        self._ended: deque[bytes] = deque()
        self._followed = 0
        self._sim: Turtlesim | None = None
        self._has_said = anyio.Event()
        self._is_shown = False

    def begin(self, sim: Turtlesim) -> None:
        """Show this world from now on."""
        self._sim = sim

    def say(self, line: str, subject: str = "") -> None:
        """Add a line to the heading, which is always shown.

        If the heading has a line about the same subject, the new line replaces that line. Without
        ``subject``, the line replaces no other line.
        """
        self._heading[subject or line] = line
        self._has_said.set()

    def retell(self, subject: str, text: str) -> None:
        """Add a text to the log. The new text replaces the last text about the same subject."""
        self._log.retell(subject, text)

    def tell(self, goal: Handle, new: GoalStatus, line: str, time: str) -> None:
        """Show a change of a goal's state.

        Args:
            goal: The goal.
            new: The goal's new state.
            line: The line for the log.
            time: The time as it is written in ``line``. The dashboard shortens it to whole seconds.
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
        """Restore the terminal. This never blocks."""
        self._region.restore()

    @contextmanager
    def listening(self) -> Iterator[None]:
        """During a block, add all printed lines to the log.

        If the dashboard has not been shown by the end of the block, the log is printed on stderr.
        """
        try:
            with self._log.listening():
                yield
        finally:
            if not self._is_shown:
                for line in self._log.lines():
                    print(line.full, file=sys.stderr)

    async def run(self) -> None:
        """Wait for a line in the heading or the log, then draw frames until cancelled.

        The display does not wait until the server is ready, because the log may say what the
        server waits for. At the end, print the heading and the last lines of the log, which stay on
        the screen.
        """
        while not (self._heading or self._log.lines()):
            # Any thread may print the first line of the log, so that line sets no event.
            with anyio.move_on_after(FIRST_LOOK):
                await self._has_said.wait()
        self._is_shown = True
        with (
            suppress(OSError),
            self._region.held(),
        ):  # if the terminal goes away, the server goes on
            try:
                await keep_drawing(self._region, self.compose)
            finally:
                kept = [line.full for line in self._log.lines()[-MOST_LEFT:]]
                self._region.say("".join(f"{line}\n" for line in (*self._heading.values(), *kept)))
                with anyio.move_on_after(PATIENCE, shield=True):
                    await self._region.drained()

    def compose(self, *, width: int, height: int) -> render.Picture:
        """Compose the current frame for a window of this many columns and lines."""
        sim = self._sim
        turtles = [] if sim is None else [_turtle(*each) for each in sim.turtles(MOST_TURTLES)]
        goals = self._in_order()
        rows = [goal.row({turtle.name for turtle in turtles}) for goal in goals]
        ahead = [target for row in rows for target in row.targets if not target.is_reached]
        world = None if sim is None else render.MapView(SIDE, turtles, _Drawn(sim), ahead)
        log = [line.short for line in self._log.lines()]
        more = len(self._goals) - len(goals)
        paused = ["the world is paused"] if sim is not None and sim.is_paused else []
        heading = list(self._heading.values()) or [NOT_READY]
        shown = render.Board([*heading, *paused], world, rows, more, log=log)
        return render.board(shown, width=width, height=height)

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
        self._course = Course(goal.request)
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

    def row(self, turtles: set[str]) -> render.GoalRow:
        """Return the goal's row in the table.

        The row names the goal's turtle only if ``turtles`` contains its name.
        """
        self.look()
        is_over = self.ended_at is not None
        turtle = self._turtle if self._turtle in turtles else ""
        colour = colour_of(turtle) if turtle else ""
        targets = [] if is_over or self._poses is None else self._course.targets()
        return render.GoalRow(
            self._name,
            self._goal_id,
            self._status,
            (self._clock.time() if self.ended_at is None else self.ended_at) - self._began,
            "" if self._poses is None else self._course.told(),
            turtle,
            colour,
            [target._replace(colour=colour or target.colour) for target in targets],
            ", ".join(self._marks()),
        )

    def _marks(self) -> Iterator[str]:
        """Yield remarks: that the goal was resumed, that it is paused, or how its turtle moves."""
        if self._goal.resumed is not None:
            yield "resumed"
        if self._goal.is_paused:
            yield "paused"
        elif self.ended_at is None and (motion := self._motion.told()):
            yield motion


class _Drawn:
    """The lines that the turtles of a world have drawn."""

    def __init__(self, sim: Turtlesim) -> None:
        self._sim = sim

    def canvas(self, columns: int, rows: int) -> render.Braille:
        """Return the turtles' lines as dots on a canvas of ``columns`` by ``rows`` characters."""
        canvas = render.Braille(columns, rows)
        top = canvas.height - 1
        for row, pixels in enumerate(self._sim.thumbnail(canvas.width, canvas.height)):
            for column, colour in enumerate(pixels):
                if colour is not None:
                    canvas.dot(column, top - row, _style(colour))
        return canvas


def _turtle(name: str, pose: Pose, _pen: object) -> render.Turtle:
    return render.Turtle(pose.x, pose.y, pose.theta, name, colour_of(name))


def _style(colour: tuple[int, int, int]) -> str:
    return "#" + bytes(colour).hex()
