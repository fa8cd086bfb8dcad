"""What a client asks of an action server, whether the server is in its own process or not.

In the same process a client uses the server's own goals: no message travels, and both sides hold
the same `Goal` objects. For a server in another process, `turtleact.client` has a stand-in with
goals that messages keep up to date. Both offer the interface below.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import anyio
import msgspec

from turtleact.errors import TurtleactError
from turtleact.goal import Goal, OnFeedback
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Signal

__all__ = ["GoalOrder", "GoalServer", "OffersGoals", "cancel_and_wait"]


class GoalOrder(msgspec.Struct, frozen=True):
    """A goal that a client wants to send.

    Attributes:
        request: The goal message.
        sender: The client. It is told nothing; goals are looked up by it when it goes away.
        cancel_timeout: How long a cancelled caller waits for the goal's end (s, wall clock).
        goal_id: The 16 bytes that the user chose; None for an id made by the server or client.
        on_feedback: The user's callback for feedback.
    """

    request: object
    sender: object
    cancel_timeout: float
    goal_id: bytes | None = None
    on_feedback: OnFeedback | None = None


@runtime_checkable
class GoalServer(Protocol):
    """An action's server, as its clients see it."""

    @property
    def is_open(self) -> bool:
        """Whether it takes goals."""

    async def send_goal(self, order: GoalOrder) -> Goal:
        """Send a goal and return it once it is accepted.

        Cancelling: the goal is not taken, or it is canceled and its end awaited, at most
        ``order.cancel_timeout`` seconds.

        Raises:
            InvalidGoal: if the request does not fit the action; nothing was sent.
            GoalRejected: if the server does not take the goal.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """

    async def run_goal(self, order: GoalOrder) -> Goal:
        """Send a goal and return it once it has ended; see `send_goal` for the rest."""

    async def attach(self, goal_id: bytes) -> Goal | None:
        """The goal of that id, if it is held; its feedback is kept from now on."""

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Answer a cancel request: by id, by stamp (ns), by both, or for every goal."""

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Answer a request to cancel one goal."""

    def cancel_goal_nowait(self, goal: Goal) -> None:
        """Ask for a goal to be canceled, without waiting for the answer."""

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: safe, the goal goes on."""

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it gets one if it has none."""

    def client_lost(self, sender: object) -> None:
        """Note that a client has gone."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread."""


@runtime_checkable
class OffersGoals(Protocol):
    """A handler of ``send_goal`` that has the server itself for clients in its process."""

    goal_server: GoalServer


async def cancel_and_wait(server: GoalServer, goal: Goal, timeout: float) -> None:
    """Ask for a goal to be canceled and wait for its end, shielded, at most ``timeout`` seconds.

    Never raises because of the goal or its server: whoever calls this is leaving.
    """
    with anyio.move_on_after(timeout, shield=True):
        try:
            await server.cancel_goal(goal)
            await server.wait_for_end(goal)
        except TurtleactError:
            return  # the server has gone: there is no end to wait for
