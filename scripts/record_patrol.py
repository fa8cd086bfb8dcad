"""Prints docs/patrol.svg: the patrol of README.md from an actual run.

    python scripts/record_patrol.py > docs/patrol.svg

The run is in virtual time, so the picture is the same every time. A test compares it with the file.
The colours are those of turtlesim. The animation is SMIL, in real time. Viewers without SMIL show
the end.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise

import msgspec

from turtleact import QoS, open_world
from turtleact.actions.patrol import Patrol
from turtleact.geometry import shortest_turn
from turtleact.interfaces.standard import Point, TurtlePose
from turtleact.sim.kinematics import DT
from turtleact.sim.pictures import SVG_TURTLE, svg_shades

TARGETS = ((9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0))
TOLERANCE = 0.1

PIXELS = 45  # a metre
SIZE = 500  # turtlesim's window
FOOT = 36  # the lines below it
HOLD = 3.0  # how long the end is shown (s)
SAMPLE = 4  # ticks from one sample of the animation to the next

BACKGROUND = "rgb(69,86,255)"
PEN = "rgb(179,184,255)"
REACHED = "rgb(255,221,87)"


class Message(msgspec.Struct, frozen=True):
    """A line of text, and when it appeared (s)."""

    time: float
    text: str


class Recording(msgspec.Struct, frozen=True):
    """The record of a patrol, with a pose for each tick."""

    poses: Sequence[TurtlePose]
    reached: Sequence[float]
    messages: Sequence[Message]

    @property
    def samples(self) -> range:
        """The ticks at which the animation shows a pose. The last tick is repeated."""
        return range(0, len(self.poses) - 1 + SAMPLE + round(HOLD / DT), SAMPLE)

    @property
    def length(self) -> float:
        """How long the animation takes (s)."""
        return (len(self.samples) - 1) * SAMPLE * DT

    def at_samples(self, values: Sequence[str]) -> str:
        """The values of a pose, for each sample, as SMIL needs them."""
        return ";".join(values[min(tick, len(values) - 1)] for tick in self.samples)


async def record() -> Recording:
    """Run the patrol."""
    poses: list[TurtlePose] = []
    reached: list[float] = []
    messages: list[Message] = []
    async with open_world(speed="max") as node:
        pose_topic = node.subscription(TurtlePose, "turtle1/pose", QoS(depth=10_000))
        client = node.action_client(Patrol, "patrol")

        def hear(feedback: Patrol.Feedback) -> None:
            poses.extend(pose_topic.drain())
            if feedback.is_reached:
                reached.append(len(poses) * DT)
            messages.append(Message(len(poses) * DT, words_of(feedback)))

        targets = [Point(x=x, y=y) for x, y in TARGETS]
        goal = Patrol.Goal(targets=targets, tolerance=TOLERANCE)
        result = await client.send_goal(goal, feedback_callback=hear)
        poses.extend(pose_topic.drain())
    messages.append(Message(len(poses) * DT, words_of_result(result)))
    return Recording(poses, reached, messages)


def words_of(feedback: Patrol.Feedback) -> str:
    """The line of text for a feedback message."""
    state = "reached" if feedback.is_reached else "ahead"
    return (
        f"Feedback: target {feedback.index + 1} {state}, {feedback.distance_remaining:.2f} m to go"
    )


def words_of_result(result: Patrol.Result) -> str:
    """The line of text for the result, which stays."""
    return (
        f"SUCCEEDED: {result.reached} targets, {result.distance:.2f} m,"
        f" {result.duration:.2f} s of simulated time"
    )


def draw(recording: Recording) -> str:
    """The picture."""
    targets = [
        draw_target(number, place, time, recording.length)
        for number, (place, time) in enumerate(
            zip(TARGETS, recording.reached, strict=True), start=1
        )
    ]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE + FOOT}"'
        f' width="{SIZE}" height="{SIZE + FOOT}" font-family="monospace">',
        "<title>A turtle patrols four targets</title>",
        f"<desc>{recording.messages[-1].text}</desc>",
        f'<rect width="{SIZE}" height="{SIZE}" fill="{BACKGROUND}"/>',
        draw_trail(recording),
        *targets,
        draw_turtle(recording),
        f'<rect y="{SIZE}" width="{SIZE}" height="{FOOT}" fill="rgb(24,28,62)"/>',
        *draw_captions(recording),
        "</svg>",
    ]
    return "\n".join(lines)


def draw_trail(recording: Recording) -> str:
    """The line that the pen draws, up to the turtle."""
    points = [(round(px(pose.x), 1), round(py(pose.y), 1)) for pose in recording.poses]
    grown = list(accumulate((math.dist(*leg) for leg in pairwise(points)), initial=0.0))
    length = short(grown[-1])
    path = "M" + "L".join(f"{short(x)} {short(y)}" for x, y in points)
    hidden = recording.at_samples([short(grown[-1] - so_far) for so_far in grown])
    return (
        f'<path d="{path}" fill="none" stroke="{PEN}" stroke-width="3" stroke-linejoin="round"'
        f' stroke-dasharray="{length} {length}">\n'
        f"{animate('animate', 'stroke-dashoffset', hidden, recording.length)}\n</path>"
    )


def draw_target(number: int, place: tuple[float, float], time: float, length: float) -> str:
    """A target's disc of tolerance and its number. Both light up when the target is reached."""
    x, y = short(px(place[0])), short(py(place[1]))
    times = f'keyTimes="0;{short(time / length, 4)}" calcMode="discrete"'
    lit = animate("animate", "fill", f"white;{REACHED}", length, times)
    radius = short(TOLERANCE * PIXELS)
    return (
        f'<g fill="{REACHED}" font-size="18" font-weight="bold">{lit}\n'
        f'<circle cx="{x}" cy="{y}" r="{radius}" fill-opacity="0.8" stroke="white"/>'
        f'<text x="{x}" y="{y}" dx="21" dy="6">{number}</text></g>'
    )


def draw_turtle(recording: Recording) -> str:
    """The turtle in its last pose. The animation moves it."""
    places = [f"{short(px(pose.x))},{short(py(pose.y))}" for pose in recording.poses]
    turns = [short(-math.degrees(theta)) for theta in unwrapped(recording.poses)]
    along, turn = (
        animate(
            "animateTransform",
            "transform",
            recording.at_samples(values),
            recording.length,
            f'type="{kind}"',
        )
        for kind, values in (("translate", places), ("rotate", turns))
    )
    return (
        f'<g {svg_shades("turtle1")} transform="translate({places[-1]})">\n{along}\n'
        f'<g transform="rotate({turns[-1]})">\n{turn}\n{SVG_TURTLE}\n</g>\n</g>'
    )


def draw_captions(recording: Recording) -> Iterable[str]:
    """The feedback lines, each shown until the next comes. The result stays."""
    length = recording.length
    said = [Message(0.0, "Goal accepted"), *recording.messages]
    for message, after in pairwise([*said, Message(length, "")]):
        is_last = message is said[-1]
        shown = "1" if is_last else "0"
        values = "0;1" if is_last else "0;1;0"
        times = [0.0, message.time, after.time][: 2 if is_last else 3]
        key_times = ";".join(short(time / length, 4) for time in times)
        more = f'keyTimes="{key_times}" calcMode="discrete"'
        yield (
            f'<text x="12" y="{SIZE + 23}" font-size="13.5" fill="white" opacity="{shown}">'
            f"{message.text}{animate('animate', 'opacity', values, length, more)}</text>"
        )


def animate(element: str, attribute: str, values: str, length: float, more: str = "") -> str:
    """A SMIL animation that runs over and over."""
    return (
        f'<{element} attributeName="{attribute}" {more and more + " "}dur="{short(length, 3)}s"'
        f' repeatCount="indefinite" values="{values}"/>'
    )


def unwrapped(poses: Sequence[TurtlePose]) -> Iterable[float]:
    """The headings, without the jump from pi to -pi (rad)."""

    def turn(so_far: float, theta: float) -> float:
        return so_far + shortest_turn(so_far, theta)

    return accumulate((pose.theta for pose in poses), turn)


def px(x: float) -> float:
    """Pixels from the left."""
    return x * PIXELS


def py(y: float) -> float:
    """Pixels from the top."""
    return SIZE - y * PIXELS


def short(value: float, digits: int = 1) -> str:
    """The shortest text of a number, rounded to some digits."""
    return f"{round(value, digits) + 0.0:g}"


if __name__ == "__main__":
    print(draw(asyncio.run(record())))
