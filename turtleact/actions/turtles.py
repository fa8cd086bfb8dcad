"""The turtles that actions can drive: which there are, where they may go, and who drives which.

Each is driven by one goal at a time. Topics are all that is known of them.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, cast

import anyio

from turtleact.actions.driving import Drive
from turtleact.actions.robots import Robot
from turtleact.actions.steering import Area, Limits, Steering
from turtleact.errors import Abort, InvalidMessage, InvalidName, Reject
from turtleact.names import resolve_name, validate_name

if TYPE_CHECKING:
    from turtleact.actions.steering import Style
    from turtleact.interfaces.standard import Point
    from turtleact.node import Node

__all__ = ["Turtles"]


class Turtles:
    """The turtles of a graph, and which of them are being driven.

    Args:
        node: Where the topics are opened.
        area: What targets must be in.
        robot: How they are heard and told; as those of turtlesim are, if left out.
    """

    def __init__(self, node: Node, area: Area, robot: Robot | None = None) -> None:
        self._node = node
        self._area = area
        self._robot = robot or Robot()
        self._driven: set[str] = set()
        self._proving = anyio.Lock()

    def steering(
        self,
        *,
        style: str,
        max_linear: float,
        max_angular: float,
        tolerance: float,
        heading_tolerance: float = Limits().heading_tolerance,
    ) -> Steering:
        """The law of steering with a goal's options, for these robots.

        Raises:
            Reject: if there is no such style, or a number is out of its range.
        """
        robot = self._robot
        if max_angular > robot.fastest:
            most = f"{robot.fastest:.4g} rad/s at most"
            raise Reject(f"max_angular: must be {most}, not {max_angular}")
        try:
            limits = Limits(
                max_linear=max_linear,
                max_angular=max_angular,
                max_acceleration=robot.max_acceleration,
                max_angular_acceleration=robot.max_angular_acceleration,
                tolerance=tolerance,
                heading_tolerance=heading_tolerance,
                dt=robot.dt,
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
        poses, _ = self._robot.topics(turtle)
        try:
            if turtle:
                validate_name(turtle)
            publishers = self._node.count_publishers(poses)
        except InvalidName as error:
            raise Reject(f"'{turtle}' is no name of a turtle: {error.problem}") from None
        if not publishers:
            raise Reject(f"there is no turtle '{turtle}': nobody publishes {poses}")
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
            Abort: if nothing is heard of its pose, or another goal has come first.
        """
        topic = self._topic(turtle)
        if topic in self._driven:  # two goals may have been accepted before either has begun
            raise Abort(_taken(turtle))
        drive = Drive(self._node, self._robot, turtle, steering, self._proving)
        self._driven.add(topic)
        try:
            await drive.wait_for_pose()
            drive.travelled = 0.0
            yield drive
        finally:
            self._driven.discard(topic)
            await drive.aclose()

    def _topic(self, turtle: str) -> str:
        """The full name of its pose: a turtle may be called by several names."""
        poses, _ = self._robot.topics(turtle)
        return resolve_name(poses, self._node.namespace, self._node.name)


def _taken(turtle: str) -> str:
    return f"turtle '{turtle}' is being driven by another goal"
