"""The live display of a goal: what is shown of it on a terminal, when, and where.

`LiveTranscript` redraws a region at the end of the screen; the goal, its body and the world know
nothing of it. What is to stay is printed above the region, as plain text.
"""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stderr
from typing import TYPE_CHECKING, Any, TextIO

from turtleact import render
from turtleact.commands import frames
from turtleact.commands.stderr import note
from turtleact.commands.terminal import Region
from turtleact.commands.tracks import Course, Tracks, places_in, pose_topics, sends_a_turtle
from turtleact.commands.transcript import PlainTranscript
from turtleact.interfaces import to_dict

if TYPE_CHECKING:
    from turtleact.client import Outcome
    from turtleact.commands.transcript import Followed, Sent
    from turtleact.goal import GoalStatus
    from turtleact.interfaces import Message

__all__ = ["LiveTranscript"]

MOST_LINES = 40
"""A goal is printed on so many lines at most; the display shows where it leads."""


class LiveTranscript:
    """A display while the goal runs, the plain transcript above it and when it has ended.

    Args:
        stream: The terminal.
        wants_feedback: Whether each feedback message is printed too, and stays.
    """

    _picture: _Picture  # from the acceptance on

    def __init__(self, stream: TextIO, *, wants_feedback: bool) -> None:
        self.wants_feedback = wants_feedback
        self._region = Region(stream)
        self._plain = PlainTranscript(
            wants_feedback=wants_feedback, say=self._region.say, most_lines=MOST_LINES
        )

    def sending(self, goal: Message) -> None:
        """The goal is about to be sent."""
        self._plain.sending(goal)

    def rejected(self, reason: str) -> None:
        """The server did not take the goal."""
        self._plain.rejected(reason)

    def accepted(self, sent: Sent) -> None:
        """The server took the goal."""
        self._plain.accepted(sent)
        self.follows(sent.followed())

    def follows(self, goal: Followed) -> None:
        """The goal is looked at from now on."""
        self._picture = _Picture(goal)

    async def animate(self) -> None:
        """Draw a frame now and then."""
        with redirect_stderr(_Above(self._region, sys.stderr)):
            await frames.animate(self._region, self._picture.compose)

    def feedback(self, feedback: Message) -> None:
        """A feedback message came."""
        self._plain.feedback(feedback)

    def status(self, status: GoalStatus) -> None:
        """The next frame tells it."""

    def canceling(self) -> None:
        """The goal is asked to cancel."""
        self._plain.canceling()

    def ended(self, outcome: Outcome[Message]) -> None:
        """The goal has ended: its last state is drawn, and gives way to its result."""
        frames.draw(self._region, self._picture.compose)
        self._plain.ended(outcome)

    def note(self, text: str) -> None:
        """Something that belongs to no goal happened."""
        self._region.clear()
        note(text)

    async def drained(self) -> None:
        """Wait until the terminal has taken all that is to stay."""
        await self._region.drained()

    def close(self) -> None:
        """Take the display away, and give the terminal back."""
        self._region.restore()


class _Above(io.TextIOBase):
    """A stream that shares the terminal with a display, which gives way to what is written.

    Args:
        region: Where the display is.
        stream: The stream.
    """

    def __init__(self, region: Region, stream: TextIO) -> None:
        super().__init__()
        self._region = region
        self._stream = stream

    def write(self, text: str) -> int:
        """Write above the next frame."""
        self._region.clear()
        return self._stream.write(text)

    def flush(self) -> None:
        """Let it be seen."""
        self._stream.flush()

    def fileno(self) -> int:
        """The descriptor of the stream."""
        return self._stream.fileno()


class _Picture:
    """What is to be seen of a goal."""

    def __init__(self, shown: Followed) -> None:
        self._shown = shown
        self._clock = shown.node.clock
        self._began = self._clock.time() - shown.age
        self._course: Course | None = None
        self._tracks: Tracks | None = None
        self._feedback: Message | None = None
        self._heard = 0.0
        self._most_remaining = 0.0
        topics = pose_topics(shown.node)
        if shown.goal is not None:
            drives, self._leader = sends_a_turtle(shown.name, shown.goal)
            drives = drives and self._leader in topics
            self._course = Course(shown.goal)
        else:  # which turtle it drives is not known, if the action's name does not say it
            goal = shown.goal_type()
            drives, self._leader = sends_a_turtle(shown.name, goal)
            drives = self._leader in topics if shown.name.count("/") > 1 else drives
            drives = bool(topics) and (drives or hasattr(goal, "targets"))
        if drives:
            self._tracks = Tracks(shown.node, self._leader)

    def compose(self, *, width: int, height: int) -> render.Picture:
        """The picture as it is now."""
        handle = self._shown.handle
        world = None
        if self._tracks is not None:
            world = self._tracks.look(self._course)
        now = self._clock.time()
        if handle.last_feedback is not self._feedback:
            self._feedback, self._heard = handle.last_feedback, now
        if world is not None and self._shown.goal is None:
            world = world._replace(targets=_target(self._feedback))
        fraction, progress = self._progress(now)
        goal = render.GoalView(
            name=self._shown.name,
            goal=self._shown.goal,
            goal_id=handle.goal_id.hex(),
            status=handle.status,
            age=now - self._began,
            feedback=self._feedback,
            fraction=fraction,
            progress=progress,
        )
        return render.frame(goal, world, width=width, height=height)

    def _progress(self, now: float) -> tuple[float | None, str]:
        """How much is done, and in words: by what remains, by the places, else how fresh it is."""
        values = {} if self._feedback is None else to_dict(self._feedback)
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
    """The place that a turtle goes to, if its feedback tells of one."""
    values: Any = {} if feedback is None else to_dict(feedback)
    number = values.get("index", 0)
    places = places_in(values.get("target"))
    return [render.Target(*place, number + 1) for place in places if isinstance(number, int)]
