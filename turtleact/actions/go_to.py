"""``/go_to``: a turtle goes to one place."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Unpack

from turtleact.errors import Reject
from turtleact.goals.body import ServerOptions
from turtleact.goals.state import GoalResponse
from turtleact.interfaces import Action, Message, float64, string
from turtleact.interfaces.standard import Point, TurtlePose

if TYPE_CHECKING:
    from turtleact.actions.driving import Turtles
    from turtleact.node import Node, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict

__all__ = ["GoTo", "serve"]

PERIOD = 1.0
"""Seconds between two feedback messages."""


class GoTo(Action, type_name="turtleact_interfaces/action/GoTo"):
    """Go to a place."""

    class Goal(Message):
        """Where to go, which turtle goes, and how it drives.

        Attributes:
            x: The x coordinate of the place (m).
            y: The y coordinate of the place (m).
            turtle: The name of the turtle, which has the topics ``<turtle>/pose`` and
                ``<turtle>/cmd_vel``.
            tolerance: How far from the place the turtle may stop (m), above zero.
            max_linear: Highest speed (m/s), above zero.
            max_angular: Highest turn rate (rad/s), above zero.
            style: ``natural`` or ``rotate_then_drive``.
            theta: The wanted heading at the place (rad): 0 is to the right, 1.5708 is up. If
                ``heading_tolerance`` is 0, any heading will do.
            heading_tolerance: How far the final heading may be from ``theta`` (rad); 0 for any
                heading.
        """

        STYLE_NATURAL: ClassVar[string] = "natural"
        STYLE_ROTATE_THEN_DRIVE: ClassVar[string] = "rotate_then_drive"
        x: float64 = 0.0
        y: float64 = 0.0
        turtle: string = "turtle1"
        tolerance: float64 = 0.1
        max_linear: float64 = 2.0
        max_angular: float64 = 2.0
        style: string = "natural"
        theta: float64 = 0.0
        heading_tolerance: float64 = 0.0

    class Result(Message):
        """How far the turtle went, and how long it took.

        Attributes:
            distance: How far the turtle went (m).
            duration: How long the turtle took (s), by the clock of the graph. Pauses do not count.
        """

        distance: float64 = 0.0
        duration: float64 = 0.0

    class Feedback(Message):
        """Where the turtle is and how far it still has to go, sent once a second and at the end.

        Attributes:
            pose: Where the turtle is.
            distance_remaining: The straight-line distance from the turtle to the place (m).
        """

        pose: TurtlePose = TurtlePose()
        distance_remaining: float64 = 0.0


def serve(
    node: Node,
    turtles: Turtles,
    *,
    on_conflict: OnConflict = "refuse",
    **options: Unpack[ServerOptions],
) -> None:
    """Serve ``/go_to``.

    After a restart, a goal from a journal continues from the turtle's current place. While a goal
    is paused, its turtle stands still, and the pause does not count towards its time limit.

    Args:
        node: The node that serves the action.
        turtles: The turtles that the action may drive.
        on_conflict: See `Node.action_server`.
        **options: See `Node.action_server`.
    """
    server = _GoTo(turtles)
    options = {
        "goal_callback": server.check,
        "on_pause": turtles.hold,
        "on_resume": turtles.release,
        **options,
    }
    node.action_server(GoTo, "/go_to", server.execute, on_conflict=on_conflict, **options)


class _GoTo:
    def __init__(self, turtles: Turtles) -> None:
        self._turtles = turtles

    def check(self, goal: GoTo.Goal) -> GoalResponse:
        self._turtles.steering(goal, goal.heading_tolerance)
        if not math.isfinite(goal.theta):
            raise Reject(f"theta is {goal.theta}: it is an angle in rad")
        self._turtles.check_turtle(goal.turtle)
        self._turtles.check_target(Point(x=goal.x, y=goal.y))
        return GoalResponse.ACCEPT

    async def execute(
        self, goal: GoTo.Goal, handle: ServerGoalHandle[GoTo.Goal, GoTo.Result, GoTo.Feedback]
    ) -> GoTo.Result:
        left = handle.resumed
        before = (left and left.partial_result) or GoTo.Result()
        started = handle.node.clock.time() - before.duration
        target = Point(x=goal.x, y=goal.y)
        theta = goal.theta if goal.heading_tolerance else None
        steering = self._turtles.steering(goal, goal.heading_tolerance)
        async with self._turtles.drive(goal.turtle, steering, handle) as drive:
            deadline, due = drive.deadline(target, theta=theta), drive.time()
            result, has_told = GoTo.Result(), False

            def note() -> None:
                result.distance = before.distance + drive.travelled
                result.duration = drive.time() - started
                handle.set_partial_result(result)

            def tell() -> None:
                note()
                handle.publish_feedback(GoTo.Feedback(drive.pose, drive.distance_to(target)))

            try:
                while not drive.has_reached(target, theta=theta):
                    if drive.time() > deadline:
                        raise drive.too_late(_missed(goal, is_there=drive.has_reached(target)))
                    if drive.time() >= due:
                        due = drive.time() + PERIOD
                        tell()
                        has_told = True
                    await drive.towards(target, theta=theta, until=min(due, deadline))
                await drive.rest()
                if has_told:  # the last feedback must not contradict the result
                    tell()
            finally:
                note()  # a canceled or aborted goal has a result, too
        return result


def _missed(goal: GoTo.Goal, *, is_there: bool) -> str:
    """Return a description of what the turtle missed: the place, or only the heading."""
    if is_there:
        return f"theta: {goal.theta:g}, heading_tolerance: {goal.heading_tolerance:g}"
    return f"x: {goal.x:g}, y: {goal.y:g}"
