"""What clients ask of a server in their own process: no message travels, objects are shared."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol, runtime_checkable

from turtleact.goal import Goal, OnFeedback
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Signal

__all__ = ["LocalServer"]


@runtime_checkable
class LocalServer(Protocol):
    """What a client asks of a server in its own process; see `turtleact.server.ActionServer`."""

    is_open: bool

    def waits_first(self) -> bool:
        """Whether `prepare` is to be awaited before the next goal is begun."""

    async def prepare(self, request: object, sender: object) -> object:
        """Let others run, and ask the server's user; answer what is to be begun."""

    def begin(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Goal:
        """Take up a goal, start its body, keep its feedback."""

    def call(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
    ) -> Generator[object, object, object]:
        """Take up a goal and run it to its end."""

    def find(self, goal_id: bytes) -> Goal | None:
        """The goal of that id, if it is held."""

    def cancel_nowait(self, goal: Goal) -> None:
        """Ask for a goal to be canceled, without waiting."""

    def client_lost(self, sender: object) -> None:
        """Note that a client has gone."""

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Answer a cancel request: by id, by stamp (ns), by both, or for every goal."""

    async def cancel_and_wait(self, goal: Goal) -> None:
        """Ask for a goal to be canceled and wait for its end."""

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread."""

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it gets one if it has none."""

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
