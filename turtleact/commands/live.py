"""Shows goals on a terminal: one goal while it runs, or all goals of a server with their turtles.

`LivePrinter` shows a goal with its state, feedback, progress and a map. When the goal ends, the
last frame stays on the screen, and the result follows below it. `Dashboard` shows the world and the
goals of a running ``serve``. `frame` and `board` arrange what they show, with rich.

The goals, their bodies and the world know nothing of the displays.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import anyio
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.commands.goal_printer import GoalPrinter
from turtleact.commands.output import note
from turtleact.commands.screen import Screen, can_read_keys, typed_keys
from turtleact.commands.world_map import (
    POSE,
    POSES_A_FRAME,
    TICK,
    Braille,
    GoalPath,
    MapView,
    PoseTrails,
    Target,
    Turtle,
    colour_of,
    pose_topics,
    printable,
    sends_a_turtle,
    shortened,
    world_map,
)
from turtleact.errors import TurtleactError
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import to_dict
from turtleact.interfaces.standard import TurtlePose
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.commands.goal_printer import Followed
    from turtleact.interfaces import Message
    from turtleact.node import ServerGoalHandle
    from turtleact.node.topics import Subscription
    from turtleact.sim.turtlesim import Turtlesim

    Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]

__all__ = [
    "Dashboard",
    "GoalView",
    "LivePrinter",
    "PanelData",
    "Picture",
    "board",
    "frame",
]

Picture: TypeAlias = RenderableType
"""Anything that rich can draw."""

MOST_LINES = 40
"""At most this many lines of a goal are printed."""

PAUSE = "p"
"""The key that pauses the goal, and resumes it."""

MOST_GOALS: Final = 100
"""A frame shows at most this many goals: the newest ones."""

MOST_ENDED: Final = 50
"""At most this many ended goals stay in the table."""

MOST_TURTLES: Final = 50
"""The map of a server shows at most this many turtles."""

NOT_READY: Final = "not ready yet"
"""The dashboard's heading before the first call of `Dashboard.say`."""


class LivePrinter(GoalPrinter):
    """Shows a running goal in a live display, and prints the plain text around it.

    Args:
        wants_feedback: Whether to print each feedback message too, on one line.
    """

    _shown: Followed  # from the acceptance on

    def __init__(self, *, wants_feedback: bool) -> None:
        super().__init__(wants_feedback=wants_feedback, most_lines=MOST_LINES)
        self._screen = Screen(self._compose)
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

    def feedback(self, feedback: Message) -> None:
        """Print a feedback message on one line, because the display shows the last one in full."""
        print(f"Feedback: {_inline(to_dict(feedback))}")

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
                    note(str(error))

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
        fraction, progress = (None, "") if has_ended else self._progress(now)
        goal = GoalView(
            self._shown.name,
            handle.goal_id.hex(),
            handle.status,
            now - self._began,
            progress,
            ["paused"] if handle.is_paused and not has_ended else [],
            goal=handle.request,
            feedback=self._feedback,
            fraction=fraction,
        )
        return frame(goal, world, width=width, height=height)

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


class Dashboard:
    """The live display of ``serve`` on a terminal. The lines of the log scroll above it."""

    def __init__(self) -> None:
        self._screen = Screen(self.compose)
        self._heading: list[str] = []
        self._goals: dict[bytes, _Served] = {}
        self._ended: deque[bytes] = deque()
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
            self._goals[goal_id] = _Served(goal)
        self._goals[goal_id].change(new)
        if new.is_terminal:
            self._ended.append(goal_id)
        # Goals that have ended make room for others. Those that run are always kept.
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
        turtles = [] if sim is None else sim.turtles(MOST_TURTLES)
        shown = [
            Turtle(pose.x, pose.y, pose.theta, name, colour_of(name)) for name, pose, _ in turtles
        ]
        # The newest goals: first those that still run, then those that have ended.
        newest = list(islice(reversed(self._goals.values()), MOST_GOALS))
        newest.sort(key=lambda goal: goal.ended_at is not None)
        rows = [goal.view({turtle.name for turtle in shown}) for goal in newest]
        ahead = [target for row in rows for target in row.targets if not target.is_reached]
        world = None if sim is None else MapView(SIDE, shown, self._drawn, ahead)
        more = len(self._goals) - len(newest)
        paused = ["the world is paused"] if sim is not None and sim.ticking.is_paused else []
        heading = self._heading or [NOT_READY]
        data = PanelData([*heading, *paused], world, rows, more)
        return board(data, width=width, height=height)

    def _drawn(self, columns: int, rows: int) -> Braille:
        """Return what the turtles have drawn, as dots on a canvas of this size."""
        canvas = Braille(columns, rows)
        top = canvas.height - 1
        pixels = () if self._sim is None else self._sim.thumbnail(canvas.width, canvas.height)
        for y, row in enumerate(pixels):
            for x, colour in enumerate(row):
                if colour is not None:
                    canvas.dot(x, top - y, "#" + bytes(colour).hex())
        return canvas


class _Served:
    """A goal that the server runs, as shown on the dashboard.

    Attributes:
        ended_at: When the goal ended, by the clock of its node (s); None while the goal runs.
    """

    def __init__(self, goal: Handle) -> None:
        self._goal = goal
        self._clock = goal.node.clock
        self._began = self._clock.time()
        self._course = GoalPath(goal.request)
        self._poses: Subscription[TurtlePose] | None = None
        self._status: GoalStatus = goal.status
        self.ended_at: float | None = None
        drives, leader = sends_a_turtle(goal.action_name, goal.request)
        self._turtle = leader.removesuffix(POSE).strip("/") if drives else ""
        if self._course.stops:
            self._poses = goal.node.subscription(TurtlePose, leader, QoS(depth=POSES_A_FRAME))

    def change(self, status: GoalStatus) -> None:
        """Record the goal's new state."""
        self._status = status
        if status.is_terminal:
            self._look()  # the last place is often reached after the last frame
            self.ended_at = self._clock.time()
            if self._poses is not None:
                self._poses.close()

    def _look(self) -> None:
        """Update the goal's progress with the new poses of its turtle."""
        if self._poses is not None and self.ended_at is None:
            for pose in self._poses.drain():
                self._course.follow(pose.x, pose.y)

    def view(self, turtles: set[str]) -> GoalView:
        """Return the goal as shown in the table.

        The table names the goal's turtle only if ``turtles`` contains its name.
        """
        self._look()
        is_over = self.ended_at is not None
        turtle = self._turtle if self._turtle in turtles else ""
        colour = colour_of(turtle) if turtle else ""
        targets = [] if is_over else self._course.targets()
        marks = {"resumed": self._goal.resumed is not None, "paused": self._goal.is_paused}
        return GoalView(
            self._goal.action_name,
            self._goal.goal_id.hex(),
            self._status,
            (self._clock.time() if self.ended_at is None else self.ended_at) - self._began,
            self._course.told(),
            [mark for mark, holds in marks.items() if holds],
            turtle,
            [target._replace(colour=colour or target.colour) for target in targets],
        )


# the arrangement

STYLES: Final = {
    GoalStatus.ACCEPTED: "blue",
    GoalStatus.EXECUTING: "cyan",
    GoalStatus.CANCELING: "yellow",
    GoalStatus.SUCCEEDED: "green",
    GoalStatus.CANCELED: "yellow",
    GoalStatus.ABORTED: "red",
}

NARROWEST: Final = 40
"""The minimum width (columns) of a window that shows a map."""

NARROWEST_BESIDE, NARROWEST_TABLE = 26, 36
"""The minimum widths (columns) of the feedback and of the table of goals beside a map."""

WIDE: Final = 72
"""In a window narrower than this (columns), the feedback is below the map, not beside it.

A table of goals narrower than this has no columns for ids and progress.
"""

LOWEST, HIGHEST = 5, 24
"""The minimum and maximum number of rows of a map, not counting its border."""

LOWEST_ABOVE: Final = 6
"""The minimum height (rows) of a map with the feedback below it.

If the map would have fewer rows, the feedback is beside the map, even in a narrow window.
"""

MOST_VALUE_LINES: Final = 4
"""The maximum number of lines for one value of the feedback."""

MOST_GOAL_LINES: Final = 3
TALL: Final = 20
"""The minimum height (lines) of a window that shows a goal message in up to three lines.

A lower window shows only one line of the goal message.
"""

LONGEST_LIST: Final = 8
"""If a list has more elements than this, only its first and last elements are shown."""

SENT_BEFORE: Final = "sent by another program; the fields of the goal are unknown here"


class GoalView(NamedTuple):
    """A goal as a display shows it.

    Attributes:
        name: The name of the action.
        goal_id: The goal's id, in hexadecimal.
        status: The goal's state.
        age: How long ago the goal was accepted (s); of an ended goal, how long it took.
        progress: The progress in words.
        marks: Remarks on the goal, such as that it is paused.
        turtle: The turtle that the goal drives; empty if the map does not show it.
        targets: The targets of the turtle, in its colour.
        goal: The goal message; None if it is unknown.
        feedback: The last feedback, if there is one.
        fraction: The progress, 0 to 1, if it is known.
    """

    name: str
    goal_id: str
    status: GoalStatus
    age: float
    progress: str = ""
    marks: Sequence[str] = ()
    turtle: str = ""
    targets: Sequence[Target] = ()
    goal: Message | None = None
    feedback: Message | None = None
    fraction: float | None = None


class PanelData(NamedTuple):
    """The data of a server or a robot to show on a display.

    Attributes:
        heading: The lines at the top, which are shown even in a small window.
        world: The world to draw as a map; None if no map is shown.
        goals: The rows of the table of goals; None if no table is shown.
        more: How many further goals there are, besides those in ``goals``.
        keys: The lines that explain the keys of the keyboard.
    """

    heading: Sequence[str]
    world: MapView | None = None
    goals: Sequence[GoalView] | None = None
    more: int = 0
    keys: Sequence[str] = ()


def _inline(value: object) -> str:
    """Return a plain value as text on one line. The middle of a long list is left out."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_braced(item)}" for name, item in value.items()) or "{}"
    if isinstance(value, list | tuple | bytes):
        items = [_braced(item) for item in value]
        if len(items) > LONGEST_LIST:
            half = LONGEST_LIST // 2
            items[half:-half] = [f"… {len(items) - LONGEST_LIST} more …"]
        return f"[{', '.join(items)}]"
    if isinstance(value, float):
        return f"{value:.3f}".rstrip("0").removesuffix(".") if abs(value) < 1e6 else f"{value:g}"
    return printable(str(value))


def _braced(value: object) -> str:
    return f"({_inline(value)})" if isinstance(value, dict) else _inline(value)


def frame(goal: GoalView, world: MapView | None, *, width: int, height: int) -> Picture:
    """Show a goal, with its feedback beside or below a map.

    If the window is too small, there is no map.

    Args:
        goal: The goal to show.
        world: The world to draw as a map, if the goal drives a turtle; otherwise None.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    head = _head(goal, width, MOST_GOAL_LINES if height >= TALL else 1)
    below = [_progress(goal)] if goal.progress else []
    left = max(height - len(head) - len(below), 0)
    # Below a map, each field of the feedback has one line, so that the map keeps its size.
    needed = 1 if goal.feedback is None else max(min(len(to_dict(goal.feedback)), left // 2), 1)
    above = min(HIGHEST, left - 2 - needed, width // 2 - 1)
    beside = min(HIGHEST, left - 2, (width - NARROWEST_BESIDE) // 2)
    if world is not None and above >= LOWEST_ABOVE and NARROWEST <= width < WIDE:
        middle = [world_map(world, above), _feedback(goal, width, needed)]
    elif world is not None and beside >= LOWEST and width >= NARROWEST:
        table = _feedback(goal, width - 2 * beside - 4, beside)
        middle = [_beside(world_map(world, beside), table, beside)]
    else:
        middle = [_feedback(goal, width, left)]
    return Group(*head, *middle, *below)


def board(view: PanelData, *, width: int, height: int) -> Picture:
    """Show a server or a robot: a heading, and a map with a table beside it.

    If no map is shown, the table is as wide as the window.

    Args:
        view: What to show.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    head = [part for line in view.heading for part in _folded(printable(line), width, height // 2)]
    head = head[: max(height // 2, len(view.heading))]
    left = max(height - len(head), 0)
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if view.world is None or rows < LOWEST:
        middle = _table(view, width, left)
    else:
        table = _table(view, width - 2 * rows - 4, rows + 2)
        middle = _beside(world_map(view.world, rows), table, rows)
    return Group(*(_cut(line, "bold") for line in head), middle)


def _beside(world: Text, table: Picture, rows: int) -> Table:
    """Show a map of this many rows, and a table beside it."""
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(width=2 * rows + 2, no_wrap=True)
    grid.add_column(ratio=1)
    grid.add_row(world, table)
    return grid


def _head(view: GoalView, width: int, rows: int) -> list[Picture]:
    """Show a line with a goal's action, state and age, and below it the goal in some lines."""
    style = STYLES.get(view.status, "")
    head = Table.grid(expand=True, padding=(0, 2, 0, 0))
    head.add_column(no_wrap=True, overflow="ellipsis")
    head.add_column(no_wrap=True)
    head.add_column(no_wrap=True, justify="right", style="dim", ratio=1, overflow="crop")
    state = Text.assemble((view.status.name, style), f" {view.age:.1f} s", _marked(view.marks))
    head.add_row(Text.assemble(("● ", style), (view.name, "bold")), state, view.goal_id[:8])
    sent = SENT_BEFORE if view.goal is None else _inline(to_dict(view.goal))
    return [head, *(_cut(f"  {line}", "dim") for line in _folded(sent, width - 2, rows))]


def _progress(view: GoalView) -> Picture:
    """Show the progress in words, and as a bar if the fraction is known."""
    if view.fraction is None:
        return _cut(f"  {view.progress}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(width=1)
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    bar = ProgressBar(total=1.0, completed=view.fraction)
    line.add_row("", bar, f"{view.fraction:4.0%}  {view.progress}")
    return line


def _feedback(goal: GoalView, width: int, rows: int) -> Picture:
    """Show the fields of the last feedback. All values may take the same number of lines.

    If another program sent the goal, feedback from before this display began is unknown.
    """
    if goal.feedback is None:
        since = " since you began to watch" if goal.goal is None else " yet"
        return _cut(f"  no feedback{since}", "dim")
    content = {name: _inline(value) for name, value in to_dict(goal.feedback).items()}
    longest = min(max(map(len, content), default=0), width // 2)
    most = min(max(rows // max(len(content), 1), 1), MOST_VALUE_LINES)
    table = Table.grid(expand=True, padding=(0, 2, 0, 0))
    table.add_column(width=longest + 2, no_wrap=True, style="dim")
    table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    for name, value in list(content.items())[:rows]:
        folded = _folded(value, width - longest - 4, most)
        table.add_row(f"  {shortened(name, longest)}", Text("\n".join(folded)))
    return table


def _table(view: PanelData, width: int, rows: int) -> Picture:
    """Show the legend of the keys, and below it the goals, in at most ``rows`` lines."""
    goals = view.goals or ()
    is_wide = width >= WIDE
    shown = goals[: max(rows - len(view.keys) - 1, 0) // (1 if is_wide else 3)]
    more = len(goals) + view.more - len(shown)
    last = f"… {more} more" if more else "no goals yet" if view.goals == [] else ""
    table = _wide_table(shown) if is_wide else Group(*map(_block, shown))
    return Group(*map(_cut, view.keys), table, *([_cut(last, "dim")] if last else []))


def _wide_table(goals: Sequence[GoalView]) -> Table:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(overflow="fold")
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True, justify="right")
    for _ in range(3):
        table.add_column(no_wrap=True, overflow="ellipsis")
    for goal in goals:
        status = Text(goal.status.name, STYLES.get(goal.status, ""))
        goal_id = Text(goal.goal_id[:8], "dim")
        table.add_row(_name(goal), status, _age(goal), goal_id, goal.progress, _turtle(goal))
    return table


def _block(goal: GoalView) -> Text:
    """Show a goal in two or three short lines."""
    status = (goal.status.name, STYLES.get(goal.status, ""))
    turtle = _turtle(goal)
    text = Text.assemble(_name(goal), "\n  ", status, f"  {_age(goal)}")
    if turtle:
        text.append("\n  ").append(turtle)
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


def _name(goal: GoalView) -> Text:
    return Text.assemble(("● ", STYLES.get(goal.status, "")), (printable(goal.name), "bold"))


def _age(goal: GoalView) -> str:
    return f"{goal.age:.1f} s" if goal.age < 10_000 else f"{goal.age / 3600:.1f} h"


def _turtle(goal: GoalView) -> Text:
    """Show the turtle's name, the numbers of its targets, and the remarks on the goal."""
    text = Text(printable(goal.turtle), colour_of(goal.turtle))
    for target in goal.targets:
        text.append(f" {target.number}{TICK if target.is_reached else ''}", target.style)
    return text.append(*_marked(goal.marks))


def _folded(text: str, width: int, rows: int) -> list[str]:
    """Wrap a text between words into at most ``rows`` lines.

    If the text does not fit, its last line is longer than ``width``.
    """
    found = wrap(text, max(width, 1), break_on_hyphens=False) or [""]
    return [*found[: rows - 1], " ".join(found[rows - 1 :])] if len(found) > rows else found


def _cut(text: str, style: str = "") -> Text:
    """Return a line of text that is cut off at the window's edge."""
    return Text(text, style, no_wrap=True, overflow="ellipsis")


def _marked(marks: Sequence[str]) -> tuple[str, str]:
    return f"  {', '.join(marks)}" if marks else "", "bold yellow"
