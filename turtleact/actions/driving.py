"""Turtles as an action drives them: a pose comes in on one topic, a twist goes out on another.

`Turtles` knows which turtles there are and which of them a goal drives already; a `Drive` takes one
of them from target to target. Both know topics only, so any robot that has ``<turtle>/pose`` and
``<turtle>/cmd_vel`` will do.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Final, cast

from turtleact.actions.steering import Area, Limits, Steering, time_bound
from turtleact.errors import Abort, InvalidMessage, InvalidName, Reject
from turtleact.geometry import distance
from turtleact.interfaces.standard import Point, TurtlePose, Twist, Vector3
from turtleact.names import resolve_name, validate_name
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.actions.steering import Style
    from turtleact.node import Node
    from turtleact.topics import Publisher, Subscription

__all__ = ["Drive", "Turtles"]

LOOK: Final = 0.5
"""How often (s) it is checked whether a pose has come; one that nobody publishes is given up."""

LOOKS: Final = 4
"""After so many in a row without a pose a turtle is given up, whoever publishes."""

PATIENCE: Final = 2.0
"""A target is given up after so many times the longest time that the law of steering needs."""

FASTEST: Final = math.pi / 2 / Limits().dt
"""The highest turn rate (rad/s) that the law of steering knows what to do with."""


class Turtles:
    """The turtles of a graph, and which of them are being driven.

    Args:
        node: Where the topics are opened.
        area: What targets must be in.
    """

    def __init__(self, node: Node, area: Area) -> None:
        self._node = node
        self._area = area
        self._driven: set[str] = set()

    def steering(
        self, *, style: str, max_linear: float, max_angular: float, tolerance: float
    ) -> Steering:
        """The law of steering with a goal's options.

        Raises:
            Reject: if there is no such style, or a number is out of its range.
        """
        if max_angular > FASTEST:
            raise Reject(f"max_angular: must be {FASTEST:.4g} rad/s at most, not {max_angular}")
        try:
            limits = Limits(
                max_linear=max_linear,
                max_angular=max_angular,
                tolerance=tolerance,
                area=self._area,
            )
            return Steering(cast("Style", style), limits)
        except InvalidMessage as error:
            raise Reject(str(error)) from None

    def check_turtle(self, turtle: str) -> None:
        """See to it that a turtle can be driven.

        Raises:
            Reject: if nobody publishes its pose, or another goal drives it.
        """
        try:
            if turtle:
                validate_name(turtle)
            publishers = self._node.count_publishers(f"{turtle}/pose")
        except InvalidName as error:
            raise Reject(f"'{turtle}' is no name of a turtle: {error.problem}") from None
        if not publishers:
            raise Reject(f"there is no turtle '{turtle}': nobody publishes {turtle}/pose")
        if self._topic(turtle) in self._driven:
            raise Reject(_taken(turtle))

    def check_target(self, target: Point, *, path: str = "") -> None:
        """See to it that a target is inside the area.

        Args:
            target: The target.
            path: What to put before the name of a coordinate: ``targets[2].``.

        Raises:
            Reject: otherwise, with the name of the first coordinate that is not.
        """
        area = self._area
        ranges = {"x": (area.left, area.right), "y": (area.bottom, area.top)}
        for name, (low, high) in ranges.items():
            value = getattr(target, name)
            if not low <= value <= high:
                problem = f"is {value}, outside the world: from {low:.9g} to {high:.9g}"
                raise Reject(f"{path}{name} {problem}")

    @asynccontextmanager
    async def drive(self, turtle: str, steering: Steering) -> AsyncIterator[Drive]:
        """Hold a turtle for the length of a block; it stands still at the end, whatever ended it.

        Raises:
            Abort: if nothing is heard of its pose, it is gone, or another goal has come first.
        """
        topic = self._topic(turtle)
        if topic in self._driven:  # two goals may have been accepted before either has begun
            raise Abort(_taken(turtle))
        poses = self._node.subscription(TurtlePose, f"{turtle}/pose")
        twists = self._node.publisher(Twist, f"{turtle}/cmd_vel")
        self._driven.add(topic)
        watch = Background(_close_when_silent(poses, self._node), f"the watch over {topic}")
        try:
            drive = Drive(self._node, turtle, steering, poses, twists)
            await drive.wait_for_pose()
            drive.travelled = 0.0
            yield drive
        finally:
            self._driven.discard(topic)
            twists.publish(Twist())
            await twists.aclose()
            await poses.aclose()
            await watch.aclose()

    def _topic(self, turtle: str) -> str:
        """The full name of its pose: a turtle may be called by several names."""
        return resolve_name(f"{turtle}/pose", self._node.namespace, self._node.name)


class Drive:
    """One turtle on its way.

    Attributes:
        pose: Where it was last seen.
        travelled: How far it has gone (m).
    """

    def __init__(
        self,
        node: Node,
        turtle: str,
        steering: Steering,
        poses: Subscription[TurtlePose],
        twists: Publisher[Twist],
    ) -> None:
        self.pose = TurtlePose()
        self.travelled = 0.0
        self._node = node
        self._turtle = turtle
        self._steering = steering
        self._poses = poses
        self._twists = twists
        self._speeds = (0.0, 0.0)

    def has_reached(self, target: Point) -> bool:
        """Whether the turtle is within the tolerance of a target."""
        return self._steering.is_reached(self._place, (target.x, target.y))

    def distance_to(self, targets: Sequence[Point]) -> float:
        """How far it is in straight lines from here through the targets (m)."""
        stops = [(self.pose.x, self.pose.y), *((target.x, target.y) for target in targets)]
        return sum(distance(*a, *b) for a, b in pairwise(stops))

    def deadline(self, target: Point) -> float:
        """When to give a target up, by the node's clock (s)."""
        bound = time_bound(self._place, [(target.x, target.y)], self._steering)
        return self._node.clock.time() + PATIENCE * bound

    async def towards(self, target: Point, next_target: Point | None = None) -> None:
        """Drive for one tick.

        Raises:
            Abort: if nothing is heard of the turtle's pose, or it is gone.
        """
        after = None if next_target is None else (next_target.x, next_target.y)
        linear, angular = self._speeds = self._steering.command(
            self._place, (target.x, target.y), after, self._speeds
        )
        self._twists.publish(Twist(linear=Vector3(x=linear), angular=Vector3(z=angular)))
        await self.wait_for_pose()

    async def wait_for_pose(self) -> None:
        """Wait for the next pose, or take the newest of those that have come.

        Raises:
            Abort: if nothing is heard of the turtle's pose, or it is gone.
        """
        try:
            pose = await anext(self._poses)
        except StopAsyncIteration:
            raise Abort(self._why_silent()) from None
        for pose in self._poses.drain():  # noqa: B007  # the newest counts
            pass
        self.travelled += distance(self.pose.x, self.pose.y, pose.x, pose.y)
        self.pose = pose

    def _why_silent(self) -> str:
        topic = f"{self._turtle}/pose"
        if self._node.count_publishers(topic):
            return f"nothing was heard of {topic} for {LOOK * LOOKS:g} s"
        return f"turtle '{self._turtle}' is gone: nobody publishes {topic} any more"

    @property
    def _place(self) -> tuple[float, float, float]:
        return self.pose.x, self.pose.y, self.pose.theta


async def _close_when_silent(poses: Subscription[TurtlePose], node: Node) -> None:
    """End whoever waits for a pose once none will come, or none has come for a while."""
    last: TurtlePose | None = None
    silent = 0
    while silent < LOOKS:
        await node.clock.sleep(LOOK)
        silent = silent + 1 if poses.latest is last else 0
        last = poses.latest
        if silent and not node.count_publishers(poses.topic):
            break
    await poses.aclose()


def _taken(turtle: str) -> str:
    return f"turtle '{turtle}' is being driven by another goal"
