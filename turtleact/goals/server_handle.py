"""The goal handle of a server, for bodies and callbacks.

Source: rclpy ``action/server.py`` for names and behaviour.
"""

from __future__ import annotations

from typing import Generic, TypeVar, cast

from turtleact.goals.records import Resumed
from turtleact.goals.running import BodyTask
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import Goal, GoalStatus
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.standard import Time

__all__ = ["GoalHandle"]

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class GoalHandle(Generic[G, R, F]):
    """Gives a body access to its goal.

    The subclass `turtleact.ServerGoalHandle` also gives access to the node.
    """

    __slots__ = ("_goal", "_server")

    def __init__(self, server: LocalActionServer, goal: Goal) -> None:
        self._server = server
        self._goal = goal

    @property
    def action_name(self) -> str:
        """The fully qualified name of the action."""
        return self._server.name

    @property
    def goal_id(self) -> bytes:
        """The goal's id, 16 bytes."""
        return self._goal.id

    @property
    def stamp(self) -> Time:
        """When the goal was accepted (ROS time)."""
        return stamp_of(self._goal.stamp)

    @property
    def status(self) -> GoalStatus:
        """The goal's state."""
        return self._goal.status

    @property
    def reason(self) -> str:
        """The reason for aborting the goal, known before or at its end; empty if there is none."""
        return self._goal.reason

    @property
    def request(self) -> G:
        """The goal message."""
        return cast("G", self._goal.request)

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a client has asked to cancel the goal and the server has agreed."""
        return self._goal.status is GoalStatus.CANCELING

    @property
    def resumed(self) -> Resumed[R, F] | None:
        """What an earlier process recorded of this goal; None if the goal began in this process.

        Only a server with a journal resumes goals; see ``on_restart`` of
        `turtleact.Node.action_server`.
        """
        return self._server.resumed.get(self._goal.id)

    @property
    def is_paused(self) -> bool:
        """Whether the goal is paused."""
        return self._server.pauses.is_paused(self._goal)

    @property
    def paused_time(self) -> float:
        """How long the goal has been paused so far (s, by the graph's clock).

        If your body measures time, subtract this value, so that pauses do not count.
        """
        return self._server.pauses.paused_time(self._goal)

    async def pause(self, timeout: float = 5.0) -> None:
        """Pause the goal, and return when the goal is paused.

        The goal's own body must not call this method, because the body would wait for itself.

        Args:
            timeout: How long the body may take to reach a ``yield`` or a checkpoint (s, event loop
                time). If the body takes longer, the goal is not paused and continues.

        Raises:
            PauseRefused: if the goal cannot be paused, or its body takes too long.
        """
        self._server.spec.home.check()
        await self._server.pauses.pause(self._goal, timeout)

    async def resume(self) -> None:
        """Resume a paused goal.

        Raises:
            PauseRefused: if ``on_resume`` fails, and the goal therefore stays paused.
        """
        self._server.spec.home.check()
        await self._server.pauses.resume(self._goal)

    async def checkpoint(self) -> None:
        """Let other tasks run. While the goal is paused, wait here.

        If you declare a coroutine body with ``pausable=True``, it must await this regularly.
        """
        await self._server.tasks.checkpoint()
        if isinstance(self._goal.body, BodyTask):
            await self._goal.body.wait_at_gate()

    def publish_feedback(self, feedback: F) -> None:
        """Send a copy of ``feedback``. You may then change ``feedback`` and send it again.

        Raises:
            InvalidMessage: if ``feedback`` is not this action's Feedback, or a value does not fit
                its type.
            InvalidTransition: if the goal is neither EXECUTING nor CANCELING.
            TurtleactError: if this is called in another thread or event loop.
        """
        self._server.spec.home.check()
        self._server.publish(self._goal, feedback)

    def set_partial_result(self, result: R) -> None:
        """Set the result to report if the goal is canceled or aborted.

        Raises:
            InvalidMessage: if ``result`` is not this action's Result, or a value does not fit its
                type.
            InvalidTransition: if the goal has ended.
            TurtleactError: if this is called in another thread or event loop.
        """
        self._server.spec.home.check()
        self._server.set_partial_result(self._goal, result)
