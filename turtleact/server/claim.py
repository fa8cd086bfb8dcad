"""A goal's claim to a slot, as the server makes it.

Source: `turtleact.slot` for the rules.
"""

from __future__ import annotations

from contextvars import copy_context
from typing import Protocol

from turtleact.goal import Goal
from turtleact.server.execution import Execution

__all__ = ["Claim", "Claimant"]


class Claimant(Protocol):
    """What a claim asks of the server that made it; see `turtleact.server.ActionServer`."""

    name: str
    execution: Execution

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it gets one if it has none."""

    def start_waiting(self, goal: Goal, claim: Claim) -> None:
        """Start a goal whose turn has come, unless it has ended."""

    def evict(self, goal: Goal, reason: str) -> None:
        """Cancel a goal by the server's own decision."""


class Claim:
    """A goal that shares a slot with others; what is canceled while it waits.

    Attributes:
        goal: The goal.
        action: The fully qualified name of its action.
        context: What its sender runs in, and its body will.
    """

    __slots__ = ("_server", "action", "context", "goal")

    def __init__(self, server: Claimant, goal: Goal) -> None:
        self._server = server
        self.goal = goal
        self.action = server.name
        self.context = copy_context()

    @property
    def label(self) -> str:
        """What to call the goal in a message; gives it an id."""
        return f"goal {self._server.name_goal(self.goal).hex()} of {self.action}"

    def start(self) -> None:
        """Start the goal: its turn has come."""
        self._server.start_waiting(self.goal, self)

    def cancel(self) -> None:
        """End the goal while it waits."""
        self._server.execution.drop(self.goal)

    def evict(self, reason: str) -> None:
        """End the goal, or have its body canceled, by the server's own decision."""
        self._server.evict(self.goal, reason)
