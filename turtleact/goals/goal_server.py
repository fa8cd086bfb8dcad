"""The interface of an action server as its clients see it, in the same process or another.

In the same process, a client uses the server's own `Goal` objects and sends no messages. For a
server in another process, `turtleact.goals.client` has a proxy, whose goals are updated by
messages. The server and the proxy implement the interface below.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import anyio

from turtleact.errors import TurtleactError
from turtleact.goals.state import Goal, GoalOrder
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Signal

__all__ = ["GoalServer", "OffersGoals", "cancel_and_wait"]


@runtime_checkable
class GoalServer(Protocol):
    """An action's server, as its clients see it."""

    @property
    def is_open(self) -> bool:
        """Whether the server accepts goals."""

    async def send_goal(self, order: GoalOrder) -> Goal:
        """Send a goal and return it once it is accepted.

        Cancelling: if the goal was already sent, the goal is canceled, and this call waits at most
        ``order.cancel_timeout`` seconds for the goal's end.

        Raises:
            InvalidGoal: if the request does not fit the action. In that case, the goal is not sent.
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """

    async def run_goal(self, order: GoalOrder) -> Goal:
        """Send a goal, and return it once it has ended. Otherwise this works like `send_goal`."""

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Return the goal with that id, or None if there is none.

        From now on, the goal's feedback is kept.
        """

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Cancel the goals that an id and a stamp (ns) select, and return the server's answer."""

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Cancel one goal and return the server's answer."""

    def cancel_goal_nowait(self, goal: Goal) -> None:
        """Ask the server to cancel a goal, without waiting for the answer."""

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Pause a goal, and return once the goal's body has paused.

        Raises:
            PauseRefused: if the goal cannot be paused, or not within ``timeout`` (s, event loop
                time).
            ServerUnavailable: if the server has gone.
        """

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal. This raises the same errors as `pause`."""

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling this call is safe: the goal continues."""

    def signal(self, goal: Goal) -> Signal:
        """Return the signal that fires at each change of a goal."""

    def name_goal(self, goal: Goal) -> bytes:
        """Return the id of a goal. A goal without an id gets a new id."""

    def client_lost(self, sender: object) -> None:
        """Tell the server that a client has gone."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a call on the server's event loop, from any thread."""


@runtime_checkable
class OffersGoals(Protocol):
    """Handles ``send_goal`` requests, and gives clients in its process access to the server."""

    goal_server: GoalServer


async def cancel_and_wait(server: GoalServer, goal: Goal, timeout: float) -> None:
    """Cancel a goal and wait at most ``timeout`` seconds for its end, shielded from cancellation.

    Errors of the server are ignored, because the caller no longer needs the goal.
    """
    with anyio.move_on_after(timeout, shield=True):
        try:
            await server.cancel_goal(goal)
            await server.wait_for_end(goal)
        except TurtleactError:
            return  # the server has gone, so the goal's end will never be known
