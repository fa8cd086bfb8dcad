"""What clients ask of an action's server, whether it is in their own process or not.

In the same process they are handed the server itself: no message travels, the `Goal` objects are
the server's own. Elsewhere `turtleact.client.distant_server.DistantServer` stands for it, with
goals that it keeps up to date by messages.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol, runtime_checkable

from turtleact.goal import Goal, OnFeedback
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Signal

__all__ = ["GoalServer"]


@runtime_checkable
class GoalServer(Protocol):
    """An action's server, as its clients see it; see `turtleact.server.ActionServer`."""

    @property
    def is_open(self) -> bool:
        """Whether it takes goals."""

    def begin(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Goal | None:
        """Take up a goal and start its body, if nothing is to be awaited; else None: see `take`."""

    async def take(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Goal:
        """Take up a goal once that can be decided, start its body, keep its feedback."""

    def call(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Generator[object, object, object]:
        """Take up a goal and run it to its end."""

    async def attach(self, goal_id: bytes) -> Goal | None:
        """The goal of that id, if it is held; its feedback is kept from now on."""

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Answer a request to cancel one goal."""

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Answer a cancel request: by id, by stamp (ns), by both, or for every goal."""

    def cancel_nowait(self, goal: Goal) -> None:
        """Ask for a goal to be canceled, without waiting."""

    async def cancel_and_wait(self, goal: Goal) -> None:
        """Ask for a goal to be canceled and wait for its end."""

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended."""

    def client_lost(self, sender: object) -> None:
        """Note that a client has gone."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread."""

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it gets one if it has none."""

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
