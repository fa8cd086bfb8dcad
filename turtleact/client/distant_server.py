"""A server in another process, as its clients see it: goals that messages keep up to date.

For each goal that it sends or follows it holds a `Goal` of its own; what becomes of it is seen to
in `turtleact.client.following`. Feedback and status come by topic.

- The topics are open before the first request is sent, so no feedback can come too early.
- A result that overtakes feedback waits for it: the server says how much there is (`GoalNote`).
- A server that goes away ends its goals here, with a `ServerUnavailable` for all who wait.

Source: rcl_action ``action_client.c``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from contextvars import copy_context
from functools import partial
from typing import Any, cast

import anyio

from turtleact.client.followed import Followed, move
from turtleact.client.following import Following
from turtleact.client.links import Links
from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)
from turtleact.goal import Goal, GoalStatus, OnFeedback, failure, status_of
from turtleact.goal_id import new_goal_id
from turtleact.goal_states import State
from turtleact.interfaces import SECOND, Message, snapshotter, stamp_of
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    GoalInfo,
    GoalStatusArray,
)
from turtleact.tasks import GRACE, Tasks

__all__ = ["DistantServer"]

logger = logging.getLogger("turtleact.client")


class DistantServer:
    """Stands for a server that is reached by messages alone.

    Args:
        links: The endpoints.
        goal_type: The class of the goal messages.
        tasks: Runs what waits for replies.
        now: The time (ns since the epoch).
    """

    def __init__(
        self,
        links: Links,
        goal_type: type[Message],
        tasks: Tasks,
        now: Callable[[], int],
    ) -> None:
        self.from_anywhere = tasks.from_anywhere
        self._links = links
        self._following = Following(links, tasks, now, self.cancel_goal)
        self._followed = self._following.goals
        self.signal = self._following.signal
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self._tasks = tasks
        self._status = tasks.signal()
        self._last_told: dict[bytes, State] = {}
        self._held: dict[bytes, State] | None = None  # the last status, if one has come

    @property
    def is_open(self) -> bool:
        """Whether somebody serves the action out there."""
        return self._links.is_served

    def why_not_served(self) -> str:
        """Why nobody does."""
        return self._links.why_not_served()

    # sending

    def begin(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> None:
        """No goal can be taken up without waiting: see `take`."""

    async def take(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Goal:
        """Send a goal and wait for its acceptance.

        Cancelling: the goal is canceled, be it accepted late; its end is awaited (bounded).

        Raises:
            InvalidGoal: if the request does not fit the action; nothing was sent.
            GoalRejected: if it is not taken.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """
        self._links.watch_status(self._on_status)
        followed = self._send(request, goal_id, on_feedback, sender)
        goal = followed.goal
        try:
            while not (followed.is_accepted or goal.ended):
                await self.signal(goal).wait()
        except self._tasks.cancelled:
            await self._give_up(followed)
            raise
        if goal.error is not None and not followed.is_accepted:
            raise goal.error
        return goal

    def call(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Generator[object, object, object]:
        """Send a goal and wait for its result; raises as `take` does, and for its failure.

        Cancelling: the goal is canceled, and its end awaited (bounded).
        """
        return self._call(request, goal_id, on_feedback, sender).__await__()

    async def _call(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> object:
        followed = self._send(request, goal_id, on_feedback, sender)
        goal = followed.goal
        try:
            await self.wait_for_end(goal)
        except self._tasks.cancelled:
            await self._give_up(followed)
            raise
        if goal.status is GoalStatus.SUCCEEDED:
            return goal.result
        raise failure(goal)

    def _send(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Followed:
        message = self._check_goal(request)
        if goal_id is None:
            goal_id = new_goal_id()
        if goal_id in self._followed:
            raise GoalRejected(f"the server still holds a goal of the id {goal_id.hex()}")
        self._links.open(self._on_feedback, self._followed)
        if on_feedback is not None:  # in the sender's context, not in that of the topic
            on_feedback = partial(copy_context().run, on_feedback)  # type: ignore[call-arg]
        goal = Goal(message, 0, id=goal_id, on_feedback=on_feedback, sender=sender)
        return self._following.send(goal)

    async def _give_up(self, followed: Followed) -> None:
        """Have a goal canceled whose sender has gone, and wait for its end, `GRACE` s at most."""
        followed.is_given_up = True
        with anyio.move_on_after(GRACE, shield=True):
            if followed.is_accepted:
                await self.cancel_goal(followed.goal)
            await self.wait_for_end(followed.goal)

    # topics

    def _on_feedback(self, message: Any) -> None:  # noqa: ANN401  # see `Links.open`
        if message is None:
            return
        if type(message) is tuple:
            followed, feedback = message
        else:  # it came as an object
            followed = self._followed.get(bytes(message.goal_id.uuid))
            feedback = message.feedback
        if followed is not None:
            followed.take(feedback)
            if followed.goal.listener is not None:
                followed.goal.listener.fire()

    def _on_status(self, told: GoalStatusArray | dict[bytes, State]) -> None:
        if isinstance(told, GoalStatusArray):
            told = _states(told)
        self._held, self._last_told = {**self._last_told, **told}, told  # two may share the name
        for goal_id, followed in self._followed.items():
            if goal_id in self._held:
                _update(followed.goal, self._held[goal_id])
        self._status.fire()

    # goals that are there

    async def attach(self, goal_id: bytes) -> Goal | None:
        """A goal that somebody else has sent, by what the status says; None if it is not held."""
        followed = self._followed.get(goal_id)
        if followed is not None:
            return followed.goal
        self._links.open(self._on_feedback, self._followed)
        self._links.watch_status(self._on_status)
        with anyio.move_on_after(GRACE):
            while self._held is None:
                await self._status.wait()
        if self._held is None or goal_id not in self._held:
            return None
        told = self._held[goal_id]
        goal = Goal(None, 0, id=goal_id)
        _update(goal, told)
        self._following.attach(goal)
        if status_of(told[2]).is_terminal:  # it may be forgotten since, of which nobody tells
            with anyio.move_on_after(GRACE):
                await self.wait_for_end(goal)
        return None if isinstance(goal.error, UnknownGoal) else goal

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: safe, the goal goes on."""
        signal = self.signal(goal)
        while not goal.ended:
            await signal.wait()

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it has had one from the start."""
        return cast("bytes", goal.id)

    # canceling

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Ask the server to cancel one goal."""
        return await self.cancel(goal.id, 0)

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel by id, by stamp (ns), by both, or every goal.

        Raises:
            ServerUnavailable: if nobody answers, or the client was closed.
        """
        self._links.open(self._on_feedback, self._followed)
        named = UUID() if goal_id is None else UUID(goal_id)
        request = CancelGoal.Request(GoalInfo(named, stamp_of(stamp)))
        try:
            reply = await self._links.cancel(request)
        except TurtleactError as error:
            raise self._following.failure(error) from None
        response = cast("CancelGoal.Response", reply.message)
        for info in response.goals_canceling:
            followed = self._followed.get(bytes(info.goal_id.uuid))
            if followed is not None:
                move(followed.goal, GoalStatus.CANCELING)
        return response

    def cancel_nowait(self, goal: Goal) -> None:
        """Ask the server to cancel a goal, without waiting."""

        async def ask() -> None:
            try:
                await self.cancel_goal(goal)
            except TurtleactError as error:
                logger.warning("goal %s could not be canceled: %s", goal.hex, error)

        self._tasks.spawn(ask(), f"a cancel of {self._links.name}")

    async def cancel_and_wait(self, goal: Goal) -> None:
        """Ask the server to cancel a goal and wait for its end, shielded, `GRACE` s at most."""
        with anyio.move_on_after(GRACE, shield=True):
            try:
                await self.cancel_goal(goal)
            except ServerUnavailable:
                return
            await self.wait_for_end(goal)

    def client_lost(self, sender: object) -> None:  # noqa: ARG002  # it has this one alone
        """Follow no goal any more, and leave the graph."""
        self._following.close()
        self._links.close()


def _states(array: GoalStatusArray) -> dict[bytes, State]:
    return {
        bytes(each.goal_info.goal_id.uuid): (
            each.goal_info.stamp.sec,
            each.goal_info.stamp.nanosec,
            each.status,
        )
        for each in array.status_list
    }


def _update(goal: Goal, told: State) -> None:
    """Take over what the status says of a goal; its end comes with the result."""
    seconds, rest, number = told
    goal.stamp = seconds * SECOND + rest
    status = status_of(number)
    if not status.is_terminal:
        move(goal, status)
