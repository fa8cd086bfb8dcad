"""Represents an action server in another process.

`RemoteActionServer` implements `turtleact.goals.goal_server.GoalServer` by exchanging messages with
the server. `turtleact.goals.remote_goals` sends goals and follows them. Feedback and status arrive
on topics.

- The client subscribes to feedback before it sends the first request, so no early feedback is lost.
- If a result arrives before all of the goal's feedback, the client waits for the missing feedback.
  The server says how many feedback messages there are (`GoalNote`).
- If a server goes away, the client stops following the server's goals, and every caller that waits
  for one of these goals gets `ServerUnavailable`.

Source: rcl_action ``action_client.c``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from typing import Final, cast

import anyio

from turtleact.errors import (
    GoalRejected,
    PauseRefused,
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.ids import new_goal_id
from turtleact.goals.observers import Observers
from turtleact.goals.remote_goals import RemoteGoal, RemoteGoals
from turtleact.goals.state import CURRENT_GOAL, Goal, GoalOrder, GoalStatus, status_of
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
        self.from_anywhere = tasks.from_anywhere
        goal_type = cast("type[Message]", endpoints.action_type.Goal)
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self._endpoints = endpoints
        self._goals = RemoteGoals(endpoints, tasks, endpoints.transport.clock.now, observers)
        self.signal = self._goals.signal
        self._tasks = tasks
        self._status = tasks.signal()
        self._last_told: dict[bytes, State] = {}
        self._held: dict[bytes, State] | None = None  # None until the first status arrives
        self._paused: frozenset[bytes] = frozenset()

    @property
    def is_open(self) -> bool:
        """Whether a server in another process serves the action."""
        return self._endpoints.send_goal.is_served

    # sending

    async def send_goal(self, order: GoalOrder) -> Goal:
        """Send a goal, and return the goal once the server has accepted it.

        Cancelling: the goal is canceled, even if the server accepts it only later. The caller waits
        at most ``order.cancel_timeout`` seconds for the goal's end.

        Raises:
            InvalidGoal: if the request does not fit the action. In this case, nothing is sent.
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or the server goes away.
        """
        self._endpoints.watch_status(self._take_states)
        remote = self._send(order)
        remote.is_awaited = True
        goal = remote.goal
        signal = self.signal(goal)
        try:
            while not (remote.is_accepted or goal.ended):
                await signal.wait()
        except self._tasks.cancelled:
            await self._abandon(remote, order.cancel_timeout)
            raise
        if goal.error is not None and not remote.is_accepted:
            raise goal.error
        if self._endpoints.is_ours:
            self._endpoints.watch_paused(self._take_paused)
        return goal

    async def run_goal(self, order: GoalOrder) -> Goal:
        """Send a goal as `send_goal` does, but return the goal only after its end."""
        remote = self._send(order)
        goal = remote.goal
        try:
            await self.wait_for_end(goal)
        except self._tasks.cancelled:
            await self._abandon(remote, order.cancel_timeout)
            raise
        return goal

    def _send(self, order: GoalOrder) -> RemoteGoal:
        message = self._check_goal(order.request)
        goal_id = order.goal_id or new_goal_id()
        if goal_id in self._goals.by_id:
            raise GoalRejected(f"the server still holds a goal with the id {goal_id.hex()}")
        on_feedback = order.on_feedback
        if on_feedback is not None:  # runs in the sender's context, not the topic's
            on_feedback = partial(copy_context().run, on_feedback)  # type: ignore[call-arg]
        parent = CURRENT_GOAL.get()
        goal = Goal(
            message, 0, id=goal_id, on_feedback=on_feedback, parent=parent, sender=order.sender
        )
        remote = self._goals.send(goal, order.reattach)
        if parent is not None:  # so that it is paused with its parent
            goal.enter_parent(parent, _Child(self))
        return remote

    async def _abandon(self, remote: RemoteGoal, timeout: float) -> None:
        """Cancel a goal after the task that sent it was cancelled, and wait for the goal's end.

        Errors are only logged, because the sender's task must end cancelled even if the server dies
        or never answers. If the server has not accepted the goal yet, the task that follows the
        goal cancels the goal upon acceptance. That task continues after the ``timeout``, until the
        client is closed.
        """
        remote.is_abandoned = not remote.is_accepted
        with anyio.move_on_after(timeout, shield=True):
            try:
                if remote.is_accepted:
                    await self.cancel_goal(remote.goal)
                await self.wait_for_end(remote.goal)
            except TurtleactError as error:
                remote.is_abandoned = True  # if the server returns
                logger.info("goal %s could not be canceled: %s", remote.goal.hex, error)
            except Exception:
                logger.exception("goal %s could not be canceled", remote.goal.hex)

    # goals that already exist

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Follow the goal with this id, and return it. Return None if no server holds the goal."""
        remote = self._goals.by_id.get(goal_id)
        if remote is not None:
            return remote.goal
        self._goals.open()
        self._endpoints.watch_status(self._take_states)
        self._endpoints.watch_paused(self._take_paused)
        with anyio.move_on_after(STATUS_WITHIN):
            while self._held is None:
                await self._status.wait()
        remote = self._goals.by_id.get(goal_id)  # another task may have sent or attached to it
        if remote is not None:
            return remote.goal
        if self._held is None or goal_id not in self._held:
            return None
        state = self._held[goal_id]
        goal = Goal(None, 0, id=goal_id, is_paused=goal_id in self._paused)
        self._goals.attach(goal, state)
        if status_of(state[2]).is_terminal:  # the server may have forgotten it without any notice
            with anyio.move_on_after(STATUS_WITHIN):
                await self.wait_for_end(goal)
        return None if isinstance(goal.error, UnknownGoal) else goal

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: safe, the goal continues."""
        signal = self.signal(goal)
        while not goal.ended:
            await signal.wait()

    def name_goal(self, goal: Goal) -> bytes:
        """Return the id of a goal. Goals in other processes always have an id."""
        return cast("bytes", goal.id)

    def _take_states(self, told: dict[bytes, State]) -> None:
        # Two servers may share the name and report on their goals in turn.
        self._held, self._last_told = {**self._last_told, **told}, told
        for goal_id, remote in tuple(self._goals.by_id.items()):
            if goal_id in self._held:
                self._goals.take_state(remote, self._held[goal_id])
        self._status.fire()

    def _take_paused(self, paused: frozenset[bytes]) -> None:
        self._paused = paused
        for goal_id, remote in tuple(self._goals.by_id.items()):
            self._goals.take_paused(remote.goal, is_paused=goal_id in paused)

    # canceling

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel goals, and return its response.

        As in ROS 2, ``goal_id`` and ``stamp`` (ns since the epoch) select the goals.

        Raises:
            ServerUnavailable: if no server answers, or the client is closed.
        """
        return await self._goals.cancel(goal_id, stamp)

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Ask the server to cancel one goal. The errors are those of `cancel`."""
        return await self._goals.cancel(goal.id, 0)

    def cancel_goal_nowait(self, goal: Goal) -> None:
        """Ask the server to cancel a goal, without waiting for its answer. A failure is logged."""
        self._goals.cancel_nowait(goal)

    # pausing

    async def wait_for_acceptance(self, goal: Goal) -> None:
        """Wait until the server has accepted a goal, or the goal has ended. Cancelling: safe."""
        remote = self._goals.by_id.get(cast("bytes", goal.id))
        while remote is not None and not (remote.is_accepted or goal.ended):
            await self.signal(goal).wait()

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Ask the server to pause a goal, and wait until the goal's body stands still.

        Raises:
            PauseRefused: if the server refuses, or cannot pause goals.
            ServerUnavailable: if the server goes away.
        """
        await self._endpoints.set_paused(goal, is_paused=True, timeout=timeout)
        self._goals.take_paused(goal, is_paused=True)

    async def resume(self, goal: Goal) -> None:
        """Ask the server to let a paused goal go on. The errors are those of `pause`."""
        await self._endpoints.set_paused(goal, is_paused=False)
        self._goals.take_paused(goal, is_paused=False)

    # closing

    def client_lost(self, sender: object) -> None:  # noqa: ARG002  # always the same client
        """Stop following goals, and close the client's endpoints."""
        self._goals.close()
        self._endpoints.close()

    async def aclose(self) -> None:
        """Stop following goals, wait for the tasks to end, and close the client's endpoints."""
        await self._goals.aclose()
        self._endpoints.close()


class _Child:
    """Pauses and resumes a child goal together with the parent goal that sent the child.

    Args:
        server: The server in another process that holds the goal.
    """

    def __init__(self, server: RemoteActionServer) -> None:
        self._server = server

    async def pause_unless_ended(self, goal: Goal, timeout: float) -> bool:
        """Pause the goal. Return False if the goal has ended or is being canceled.

        Raises:
            PauseRefused: if the goal's server refuses, or has gone away.
        """
        with anyio.move_on_after(timeout):
            await self._server.wait_for_acceptance(goal)
        try:
            await self._server.pause(goal, timeout)
        except (PauseRefused, ServerUnavailable) as error:
            if goal.ended or goal.status is GoalStatus.CANCELING:
                return False
            raise _refused(error) from None
        return True

    async def resume(self, goal: Goal) -> None:
        """Resume the goal. If the goal is not paused, do nothing.

        Raises:
            PauseRefused: if the goal's server refuses, or has gone away.
        """
        if goal.is_paused:
            try:
                await self._server.resume(goal)
            except ServerUnavailable as error:
                raise _refused(error) from None


def _refused(error: PauseRefused | ServerUnavailable) -> PauseRefused:
    if isinstance(error, PauseRefused):
        return error
    return PauseRefused(f"a goal that its body has sent: {error}")
