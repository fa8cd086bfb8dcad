"""Represents an action server in another process.

`RemoteActionServer` implements `turtleact.goals.goal_server.GoalServer` by exchanging messages with
the server. `turtleact.goals.remote_goals` sends goals and follows them. Feedback and status arrive
on topics.

- The client subscribes to feedback before it sends the first request, so no early feedback is lost.
- If a result arrives before all of the goal's feedback, the client waits for the missing feedback.
  The server says how many feedback messages there are (`GoalMetadata`).
- If a server goes away, the client stops following the server's goals, and every caller that waits
  for one of these goals gets `ServerUnavailable`.

Source: rcl_action ``action_client.c``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextvars import copy_context
from functools import partial
from typing import Final, cast

import anyio

from turtleact.errors import GoalRejected, TurtleactError, UnknownGoal
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.feedback import FeedbackLog
from turtleact.goals.ids import new_goal_id
from turtleact.goals.observers import Observers
from turtleact.goals.remote_goals import RemoteGoals
from turtleact.goals.state import CURRENT_GOAL, Goal, GoalRequest, OnFeedback, status_of
from turtleact.goals.wire import State
from turtleact.interfaces import Message, snapshotter
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Tasks

__all__ = ["RemoteActionServer"]

logger = logging.getLogger("turtleact.client")

STATUS_WITHIN: Final = 5.0
"""How long to wait for a server's first status, and for the result of an ended goal (s)."""


class RemoteActionServer:
    """An action server in another process, as its clients see it.

    Args:
        endpoints: The client's endpoints.
        tasks: The functions that start tasks in the client's event loop.
        observers: The objects that are told about each change of the client's goals.
    """

    def __init__(self, endpoints: ClientEndpoints, tasks: Tasks, observers: Observers) -> None:
        goal_type = cast("type[Message]", endpoints.action_type.Goal)
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self._endpoints = endpoints
        self._goals = RemoteGoals(endpoints, tasks, endpoints.transport.clock.now, observers)
        self.pauses = RemotePauses(self, endpoints, self._goals)
        self.resumed: Mapping[bytes, object] = {}
        self._tasks = tasks
        self._status = tasks.signal()
        self._last_told: dict[bytes, State] = {}
        self._held: dict[bytes, State] | None = None  # None until the first status arrives

    @property
    def is_open(self) -> bool:
        """Whether a server in another process serves the action."""
        return self._endpoints.send_goal.is_served

    # sending

    async def send(self, request: GoalRequest) -> Goal:
        """Send a goal, and return it. The server may not have accepted it yet.

        Raises:
            InvalidGoal: if the request does not fit the action. In this case, nothing is sent.
            GoalRejected: if this client still follows a goal with that id.
        """
        message = self._check_goal(request.message)
        goal_id = request.goal_id or new_goal_id()
        if goal_id in self._goals.by_id:
            raise GoalRejected(f"the server still holds a goal with the id {goal_id.hex()}")
        on_feedback = request.on_feedback
        if on_feedback is not None:  # runs in the sender's context, not the topic's
            on_feedback = partial(copy_context().run, on_feedback)  # type: ignore[call-arg]
        if request.is_streamed:
            self._endpoints.watch_status(self._take_states)
        goal = self._new_goal(goal_id, message, on_feedback)
        goal.parent, goal.sender = CURRENT_GOAL.get(), request.sender
        self._goals.send(goal, request.reattach)
        return goal

    def _new_goal(
        self, goal_id: bytes, message: Message | None, on_feedback: OnFeedback | None = None
    ) -> Goal:
        log = FeedbackLog(on_feedback, is_kept=True)
        return Goal(goal_id, message, self._tasks.signal(), log=log)

    async def wait_for_acceptance(self, goal: Goal) -> None:
        """Wait until the server has accepted a goal. Cancelling: safe.

        Raises:
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or the server goes away.
        """
        remote = self._goals.by_id.get(goal.id)
        while remote is not None and not (remote.is_accepted or goal.ended):
            await goal.changed.wait()
        if goal.error is not None and not (remote is not None and remote.is_accepted):
            raise goal.error
        if self._endpoints.is_ours:
            self.pauses.watch()

    async def abandon(self, goal: Goal, timeout: float) -> None:
        """Cancel a goal and wait at most ``timeout`` s for its end, shielded from cancellation.

        Errors are only logged, because the sender's task must end cancelled even if the server dies
        or never answers. If the server has not accepted the goal yet, the task that follows the
        goal cancels the goal upon acceptance. That task continues after the ``timeout``, until the
        client is closed.
        """
        remote = self._goals.by_id.get(goal.id)
        if remote is None:  # it has ended
            return
        remote.is_abandoned = not remote.is_accepted
        with anyio.move_on_after(timeout, shield=True):
            try:
                if remote.is_accepted:
                    await self.cancel(goal.id, 0)
                await goal.wait_for_end()
            except TurtleactError as error:
                remote.is_abandoned = True  # if the server returns
                logger.info("goal %s could not be canceled: %s", goal.hex, error)
            except Exception:
                logger.exception("goal %s could not be canceled", goal.hex)

    # goals that already exist

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Follow the goal with this id, and return it. Return None if no server holds the goal."""
        remote = self._goals.by_id.get(goal_id)
        if remote is not None:
            return remote.goal
        self._goals.open()
        self._endpoints.watch_status(self._take_states)
        self.pauses.watch()
        with anyio.move_on_after(STATUS_WITHIN):
            while self._held is None:
                await self._status.wait()
        remote = self._goals.by_id.get(goal_id)  # another task may have sent or attached to it
        if remote is not None:
            return remote.goal
        if self._held is None or goal_id not in self._held:
            return None
        state = self._held[goal_id]
        goal = self._new_goal(goal_id, None)
        self._goals.attach(goal, state)
        if status_of(state[2]).is_terminal:  # the server may have forgotten it without any notice
            with anyio.move_on_after(STATUS_WITHIN):
                await goal.wait_for_end()
        return None if isinstance(goal.error, UnknownGoal) else goal

    def _take_states(self, told: dict[bytes, State]) -> None:
        # Two servers may share the name and report on their goals in turn.
        self._held, self._last_told = {**self._last_told, **told}, told
        for goal_id, remote in tuple(self._goals.by_id.items()):
            if goal_id in self._held:
                self._goals.take_state(remote, self._held[goal_id])
        self._status.fire()

    # canceling

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel goals, and return its response.

        As in ROS 2, ``goal_id`` and ``stamp`` (ns since the epoch) select the goals.

        Raises:
            ServerUnavailable: if no server answers, or the client is closed.
        """
        return await self._goals.cancel(goal_id, stamp)

    # closing

    def client_lost(self, sender: object) -> None:  # noqa: ARG002  # always the same client
        """Stop following goals, and close the client's endpoints."""
        self._goals.close()
        self._endpoints.close()

    async def aclose(self) -> None:
        """Stop following goals, wait for the tasks to end, and close the client's endpoints."""
        await self._goals.aclose()
        self._endpoints.close()


class RemotePauses:
    """Pauses and resumes goals in another process.

    Args:
        server: The server in the other process.
        endpoints: The client's endpoints.
        goals: The goals that the client follows.
    """

    def __init__(
        self, server: RemoteActionServer, endpoints: ClientEndpoints, goals: RemoteGoals
    ) -> None:
        self._server = server
        self._endpoints = endpoints
        self._goals = goals
        self._paused: frozenset[bytes] = frozenset()

    def watch(self) -> None:
        """Learn from the server which goals are paused. A second call does nothing."""
        self._endpoints.watch_paused(self._take)

    def is_paused(self, goal: Goal) -> bool:
        """Whether a goal is paused, as far as the client knows."""
        return goal.id in self._paused and not goal.ended

    def hold(self, goal: Goal) -> None:
        """Do nothing, because the goal's body may have started in the other process already."""

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Ask the server to pause a goal, and wait until the goal's body stands still.

        Raises:
            PauseRefused: if the server refuses, or cannot pause goals.
            ServerUnavailable: if the server goes away.
        """
        with anyio.move_on_after(timeout):
            await self._server.wait_for_acceptance(goal)
        await self._endpoints.set_paused(goal, is_paused=True, timeout=timeout)
        self._take(self._paused | {goal.id})

    async def resume(self, goal: Goal) -> None:
        """Ask the server to let a paused goal go on. The errors are those of `pause`."""
        await self._endpoints.set_paused(goal, is_paused=False)
        self._take(self._paused - {goal.id})

    def _take(self, paused: frozenset[bytes]) -> None:
        changed, self._paused = self._paused ^ paused, paused
        for goal_id in changed & self._goals.by_id.keys():
            goal = self._goals.by_id[goal_id].goal
            self._goals.tell_of_pause(goal, is_paused=goal_id in paused)
