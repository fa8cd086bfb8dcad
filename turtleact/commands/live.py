"""The live display of a goal: what is shown of it on a terminal, when, and where.

`LiveTranscript` redraws a region at the end of the screen, 15 times a second by the wall at most
and never for more than a fifth of the time; the goal, its body and the world know nothing of it.
What is to stay is printed above the region, as plain text.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, TextIO

import anyio

from turtleact import render
from turtleact.commands.stderr import note
from turtleact.commands.terminal import Region
from turtleact.commands.transcript import PlainTranscript
from turtleact.geometry import distance
from turtleact.interfaces import to_dict
from turtleact.interfaces.standard import TurtlePose
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from turtleact.client import Outcome
    from turtleact.commands.transcript import Sent
    from turtleact.goal import GoalStatus
    from turtleact.interfaces import Message
    from turtleact.topics import Subscription

__all__ = ["LiveTranscript"]

PERIOD: Final = 1 / 15
"""Wall seconds from frame to frame, at least."""

SHARE: Final = 0.2
"""The part of the time that drawing may take."""

FULL: Final = 2
"""Lines of a frame that fill the window, beside one that may: they become two if it shrinks."""

NEAR: Final = 0.15
"""A place that the turtle has come as near as this (m) is behind it."""

STRIDE: Final = 0.08
"""A trail goes on after so many metres."""

LONGEST_TRAIL: Final = 2000
POSES_A_FRAME: Final = 8192


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
        self._plain = PlainTranscript(wants_feedback=wants_feedback, say=self._region.say)

    def sending(self, goal: Message) -> None:
        """The goal is about to be sent."""
        self._plain.sending(goal)

    def rejected(self, reason: str) -> None:
        """The server did not take the goal."""
        self._plain.rejected(reason)

    def accepted(self, sent: Sent) -> None:
        """The server took the goal."""
        self._plain.accepted(sent)
        self._picture = _Picture(sent)

    async def animate(self) -> None:
        """Draw a frame now and then."""
        with self._region.held():
            while True:
                began = time.monotonic()
                self._draw()
                spent = time.monotonic() - began
                await anyio.sleep(max(PERIOD, spent / SHARE) - spent)

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
        self._draw()
        self._plain.ended(outcome)

    def note(self, text: str) -> None:
        """Something that belongs to no goal happened."""
        self._region.clear()
        note(text)

    def close(self) -> None:
        """Take the display away, and give the terminal back."""
        self._region.restore()

    def _draw(self) -> None:
        columns, rows = self._region.size()
        width, height = columns - 1, max(rows - 1 - FULL, 1)
        content = self._picture.compose(width=width, height=height)
        self._region.draw(render.lines(content, width=width, height=height))


class _Picture:
    """What is to be seen of a goal."""

    def __init__(self, sent: Sent) -> None:
        self._sent = sent
        self._clock = sent.node.clock
        self._began = self._clock.time()
        self._tracks = _Tracks.of(sent)
        self._feedback: Message | None = None
        self._heard = 0.0
        self._most_remaining = 0.0

    def compose(self, *, width: int, height: int) -> render.Picture:
        """The picture as it is now."""
        handle = self._sent.handle
        world = self._tracks.look() if self._tracks is not None else None
        now = self._clock.time()
        if handle.last_feedback is not self._feedback:
            self._feedback, self._heard = handle.last_feedback, now
        fraction, progress = self._progress(now)
        goal = render.GoalView(
            name=self._sent.name,
            goal=self._sent.goal,
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
        tracks = self._tracks
        if tracks is not None and tracks.stops:
            return tracks.passed / tracks.stops, f"{tracks.passed} of {tracks.stops} places"
        if self._feedback is None:
            return None, ""
        return None, f"last feedback {now - self._heard:.1f} s ago"


class _Tracks:
    """Where the turtles are and have been, and where the one that the goal drives is to go.

    Attributes:
        stops: How many places it is to go to, over all rounds.
        passed: How many of them it has come near to, in order.
    """

    def __init__(self, sent: Sent, topics: Sequence[str], leader: str) -> None:
        self._leader = leader
        self._poses: dict[str, Subscription[TurtlePose]] = {
            topic: sent.node.subscription(TurtlePose, topic, QoS(depth=POSES_A_FRAME))
            for topic in topics
        }
        self._trail: list[tuple[float, float]] = []
        self._places = list(_places(to_dict(sent.goal)))
        self.stops = len(self._places) * (1 + max(0, int(getattr(sent.goal, "loops", 0))))
        self.passed = 0

    @classmethod
    def of(cls, sent: Sent) -> _Tracks | None:
        """The tracks of a goal that drives a turtle; None for any other goal."""
        topics = [
            topic
            for topic, types in sent.node.graph().topics.items()
            if topic.endswith("/pose") and TurtlePose.type_name in types
        ]
        named = str(getattr(sent.goal, "turtle", "")) or sent.name.rpartition("/")[0].strip("/")
        has_places = any(True for _ in _places(to_dict(sent.goal)))
        leader = f"/{(named or 'turtle1').strip('/')}/pose"
        if leader not in topics or not (named or has_places):
            return None
        return cls(sent, topics, leader)

    def look(self) -> render.MapView:
        """Take in where the turtles have gone since the last look."""
        for pose in self._poses[self._leader].drain():
            self._follow(pose.x, pose.y)
        latest = [each.latest for each in self._poses.values() if each.latest is not None]
        first = self.passed % len(self._places) if self._places else 0
        ahead = self._places[first:] if self.passed < self.stops else []
        return render.MapView(
            side=SIDE,
            turtles=[render.Turtle(pose.x, pose.y, pose.theta) for pose in latest],
            trails=[self._trail],
            targets=ahead,
            first=first + 1,
        )

    def _follow(self, x: float, y: float) -> None:
        if not self._trail or distance(*self._trail[-1], x, y) >= STRIDE:
            self._trail.append((x, y))
            del self._trail[:-LONGEST_TRAIL]
        if self.passed < self.stops:
            target = self._places[self.passed % len(self._places)]
            self.passed += distance(x, y, *target) <= NEAR


def _places(value: object) -> Iterator[tuple[float, float]]:
    """Whatever has an x and a y in a message, as plain values, in order."""
    if isinstance(value, dict):
        if isinstance(value.get("x"), float) and isinstance(value.get("y"), float):
            yield value["x"], value["y"]
            return
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from _places(item)
