"""The interface of an action server as its clients see it, in the same process or another.

In the same process, a client uses the server's own `Goal` objects and sends no messages. For a
server in another process, `turtleact.goals.remote` has a proxy, whose goals are updated by
messages. The server and the proxy implement the interface below.
"""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from typing import Protocol, runtime_checkable

from turtleact.goals.state import Goal, GoalRequest
from turtleact.interfaces.standard import CancelGoal

__all__ = ["GoalPauses", "GoalServer", "LocalPauses", "OffersGoals"]


class GoalPauses(Protocol):
    """Pauses and resumes the goals of a server."""

    def is_paused(self, goal: Goal) -> bool:
        """Whether a goal is paused."""

    def hold(self, goal: Goal) -> None:
        """Pause a goal that was sent just now, so that its body starts only after `resume`.

        A goal in another process cannot be held.
        """

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Pause a goal, and return once the goal's body has paused.

        Raises:
            PauseRefused: if the goal cannot be paused, or not within ``timeout`` (s, event loop
                time).
            ServerUnavailable: if the server has gone.
        """

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal. This raises the same errors as `pause`."""


class LocalPauses(GoalPauses, Protocol):
    """What a server in this process also knows of its pauses."""

    @property
    def paused(self) -> list[Goal]:
        """The paused goals, in the order in which they were paused."""

    def paused_time(self, goal: Goal) -> float:
        """How long a goal has been paused in total (s, by the graph's clock)."""


class GoalServer(Protocol):
    """An action's server, as its clients see it."""

    @property
    def is_open(self) -> bool:
        """Whether the server accepts goals."""

    @property
    def pauses(self) -> GoalPauses:
        """Pauses and resumes the server's goals."""

    @property
    def resumed(self) -> Mapping[bytes, object]:
        """The ids of the goals in this process that began in an earlier process."""

    async def send(self, request: GoalRequest) -> Goal:
        """Send a goal. In the same process, the goal is accepted when this returns.

        Raises:
            InvalidGoal: if the request does not fit the action. In that case, the goal is not sent.
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """

    async def wait_for_acceptance(self, goal: Goal) -> None:
        """Wait until a goal that was sent is accepted, and raise the errors of `send`."""

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Return the goal with that id, or None if there is none.

        From now on, the goal's feedback is kept.
        """

    def cancel(self, goal_id: bytes | None, stamp: int) -> Awaitable[CancelGoal.Response]:
        """Cancel the goals that an id and a stamp (ns) select, and return the server's answer.

        The caller must await the answer. A server in this process may cancel the goals before.
        """

    async def abandon(self, goal: Goal, timeout: float) -> None:
        """Cancel a goal and wait at most ``timeout`` s for its end, shielded from cancellation.

        The caller no longer needs the goal, so errors of the server are not raised.
        """

    def client_lost(self, sender: object) -> None:
        """Tell the server that a client has gone."""


@runtime_checkable
class OffersGoals(Protocol):
    """Handles ``send_goal`` requests, and gives clients in its process access to the server."""

    goal_server: GoalServer
