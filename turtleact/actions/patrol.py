"""``/patrol`` and ``/command_turtle``: a turtle visits a list of places.

``/command_turtle`` has exactly the interface and the messages of the lecture on ROS actions (see
``docs/tutorial.md``). ``/patrol`` has more options, and its feedback and result have more fields.

Source: nav2's waypoint follower for ``stop_on_failure`` and ``missed``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Unpack

from turtleact.errors import Reject
from turtleact.geometry import distance
from turtleact.goals.body import ServerOptions
from turtleact.goals.state import GoalResponse
from turtleact.interfaces import Action, Message, bool_, float64, int32, string
from turtleact.interfaces.standard import PatrolCommandInterface, Point, TurtlePose

if TYPE_CHECKING:
    from turtleact.actions.driving import Drive, Turtles
    from turtleact.node import Node, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict

__all__ = ["Patrol", "serve"]

PERIOD = 1.0
"""Seconds between two feedback messages on the way to a target."""


class Patrol(Action, type_name="turtleact_interfaces/action/Patrol"):
    """Visit places, one after the other."""

    class Goal(Message):
        """Where to go, which turtle goes, and how it drives.

        Attributes:
            targets: The places (m), in order; z is ignored.
            loops: How many more rounds follow the first round, 0 or more.
            turtle: The name of the turtle, which has the topics ``<turtle>/pose`` and
                ``<turtle>/cmd_vel``.
            stop_on_failure: Whether the patrol ends if a target is not reached in time. Otherwise,
                the turtle goes on to the next target.
            tolerance: How close to a target the turtle must come (m), above zero.
            max_linear: Highest speed (m/s), above zero.
            max_angular: Highest turn rate (rad/s), above zero.
            style: ``natural`` or ``rotate_then_drive``.
        """

        STYLE_NATURAL: ClassVar[string] = "natural"
        STYLE_ROTATE_THEN_DRIVE: ClassVar[string] = "rotate_then_drive"
        targets: list[Point] = []
        loops: int32 = 0
        turtle: string = "turtle1"
        stop_on_failure: bool_ = False
        tolerance: float64 = 0.1
        max_linear: float64 = 2.0
        max_angular: float64 = 2.0
        style: string = "natural"

    class Result(Message):
        """How many targets the turtle reached, how far it went, and how long it took.

        Attributes:
            reached: How many targets were reached, over all rounds.
            missed: The indices of the targets that were not reached in time, counted from 0. A
                target that was missed in several rounds appears several times.
            distance: How far the turtle went (m).
            duration: How long the patrol took (s), by the clock of the graph. Pauses do not count.
        """

        reached: int32 = 0
        missed: list[int32] = []
        distance: float64 = 0.0
        duration: float64 = 0.0

    class Feedback(Message):
        """The progress of a patrol, sent at each target and once a second between targets.

        Attributes:
            index: The index of the target that the turtle is heading for or has reached, counted
                from 0.
            target: The place of the target at ``index`` (m).
            is_reached: True if the turtle has just reached the target, false if the turtle is on
                its way.
            reached: How many targets have been reached so far, over all rounds.
            pose: Where the turtle is.
            distance_remaining: The length (m) of the straight lines from the turtle to its target
                and then through all later targets.
        """

        index: int32 = 0
        target: Point = Point()
        is_reached: bool_ = False
        reached: int32 = 0
        pose: TurtlePose = TurtlePose()
        distance_remaining: float64 = 0.0


def serve(
    node: Node,
    turtles: Turtles,
    *,
    on_conflict: OnConflict = "refuse",
    **options: Unpack[ServerOptions],
) -> None:
    """Serve ``/patrol`` and ``/command_turtle``.

    After a restart, a goal from a journal continues from the turtle's current place. The goal
    continues with the first target that has not been reached according to the feedback in the
    journal. While a goal is paused, its turtle stands still, and the pause does not count towards
    the time limit for the current target.

    Args:
        node: The node that serves the actions.
        turtles: The turtles that the actions may drive.
        on_conflict: See `Node.action_server`.
        **options: See `Node.action_server`.
    """
    server = _Patrol(turtles)
    options = {"on_pause": turtles.hold, "on_resume": turtles.release, **options}
    checks: ServerOptions = {"goal_callback": server.check, **options}
    node.action_server(Patrol, "/patrol", server.execute, on_conflict=on_conflict, **checks)
    checks = {"goal_callback": server.check_command, **options}
    node.action_server(
        PatrolCommandInterface,
        "/command_turtle",
        server.execute_command,
        on_conflict=on_conflict,
        **checks,
    )


class _Patrol:
    """Checks and runs the goals of ``/patrol`` and ``/command_turtle``."""

    def __init__(self, turtles: Turtles) -> None:
        self._turtles = turtles

    def check(self, goal: Patrol.Goal) -> GoalResponse:
        """Accept a goal of ``/patrol``, or raise Reject."""
        self._turtles.steering(goal)
        if goal.loops < 0:
            raise Reject(f"loops is {goal.loops}: it is a number of extra rounds, 0 or more")
        self._turtles.check_turtle(goal.turtle)
        if not goal.targets:
            raise Reject("targets is empty: give at least one place")
        for index, target in enumerate(goal.targets):
            self._turtles.check_target(target, path=f"targets[{index}].")
        return GoalResponse.ACCEPT

    def check_command(self, command: PatrolCommandInterface.Goal) -> GoalResponse:
        return self.check(Patrol.Goal(targets=command.targets))

    async def execute(
        self,
        goal: Patrol.Goal,
        handle: ServerGoalHandle[Patrol.Goal, Patrol.Result, Patrol.Feedback],
    ) -> Patrol.Result:
        left = handle.resumed
        result = (left and left.partial_result) or Patrol.Result()
        # Only published feedback counts. A target that is in the partial result but in no feedback
        # is visited again.
        result.reached = left.feedback.reached if left and left.feedback else 0
        return await self._patrol(
            goal, handle, result, handle.publish_feedback, handle.set_partial_result
        )

    async def execute_command(
        self,
        command: PatrolCommandInterface.Goal,
        handle: ServerGoalHandle[
            PatrolCommandInterface.Goal,
            PatrolCommandInterface.Result,
            PatrolCommandInterface.Feedback,
        ],
    ) -> PatrolCommandInterface.Result:
        """Run a goal of ``/command_turtle`` as a patrol with ``stop_on_failure``."""

        def tell(feedback: Patrol.Feedback) -> None:
            if feedback.is_reached:
                message = f"Target {feedback.index + 1} reached"
                handle.publish_feedback(PatrolCommandInterface.Feedback(feedback_msg=message))

        goal = Patrol.Goal(targets=command.targets, stop_on_failure=True)
        left = handle.resumed
        reached = int(left.feedback.feedback_msg.split()[1]) if left and left.feedback else 0
        result = Patrol.Result(reached=reached)
        await self._patrol(goal, handle, result, tell, _nothing)
        return PatrolCommandInterface.Result(result_msg="Patrolling complete!")

    async def _patrol(
        self,
        goal: Patrol.Goal,
        handle: ServerGoalHandle[Any, Any, Any],
        result: Patrol.Result,
        tell: Callable[[Patrol.Feedback], None],
        note: Callable[[Patrol.Result], None],
    ) -> Patrol.Result:
        """Visit all stops and publish feedback. Record the result even if the patrol fails.

        For a goal from a journal, ``result`` is the partial result from before the restart.
        """
        started, before = handle.node.clock.time() - result.duration, result.distance
        first = result.reached + len(result.missed)
        steering = self._turtles.steering(goal)
        async with self._turtles.drive(goal.turtle, steering, handle) as drive:
            tour = _Tour(goal, drive, result, tell)

            def record() -> None:
                result.distance = before + drive.travelled
                result.duration = drive.time() - started
                note(result)

            try:
                for stop in range(first, tour.stops):
                    if await tour.reach(stop):
                        result.reached += 1
                        record()
                        tour.tell(stop, is_reached=True)
                        continue
                    result.missed.append(tour.index(stop))
                    record()
                    if goal.stop_on_failure:
                        raise drive.too_late(f"targets[{tour.index(stop)}]")
                await drive.rest()
            finally:
                record()  # a canceled or aborted patrol has a result, too
        return result


class _Tour:
    """Drives the turtle to the stops of a patrol: all targets in order, repeated for each round."""

    def __init__(
        self,
        goal: Patrol.Goal,
        drive: Drive,
        result: Patrol.Result,
        tell: Callable[[Patrol.Feedback], None],
    ) -> None:
        targets = self._targets = goal.targets
        self.stops = len(targets) * (1 + goal.loops)
        self._legs = [
            distance(here.x, here.y, there.x, there.y)
            for here, there in zip(targets, [*targets[1:], targets[0]], strict=True)
        ]
        self._drive = drive
        self._result = result
        self._tell = tell

    def index(self, stop: int) -> int:
        """Return the index of the target at a stop."""
        return stop % len(self._targets)

    async def reach(self, stop: int) -> bool:
        """Drive to a stop. Return False if the turtle does not arrive in time."""
        drive, target = self._drive, self._targets[self.index(stop)]
        after = self._targets[self.index(stop + 1)] if stop + 1 < self.stops else None
        deadline = drive.deadline(target)
        due = drive.time() + PERIOD
        # A turtle that stands on all of its targets reaches one with each pose, so that endless
        # rounds do not block the event loop.
        if drive.has_reached(target):
            await drive.stay()
            return True
        while not drive.has_reached(target):
            if drive.time() > deadline:
                return False
            if drive.time() >= due:
                due += PERIOD
                self.tell(stop, is_reached=False)
            await drive.towards(target, after, until=min(due, deadline))
        return True

    def tell(self, stop: int, *, is_reached: bool) -> None:
        """Publish feedback about the stop that the turtle is heading for or has reached."""
        target, remaining = self._targets[self.index(stop)], self._length_from(stop)
        if not is_reached:
            remaining += self._drive.distance_to(target)
        self._tell(
            Patrol.Feedback(
                index=self.index(stop),
                target=target,
                is_reached=is_reached,
                reached=self._result.reached,
                pose=self._drive.pose,
                distance_remaining=remaining,
            )
        )

    def _length_from(self, stop: int) -> float:
        """Return the distance from a stop through all later stops (m)."""
        rounds, left = divmod(self.stops - 1 - stop, len(self._legs))
        rest = sum(self._legs[self.index(stop + leg)] for leg in range(left))
        return rounds * sum(self._legs) + rest


def _nothing(_: Patrol.Result) -> None:
    """Ignore a partial result, because the result of ``/command_turtle`` is a single string."""
