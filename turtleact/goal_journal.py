"""The interface of a journal, which keeps an action server's goals on disk.

A journal is not an observer. The server waits for it twice: before it accepts a goal, and before it
announces the end of one. When the server starts, it loads the goals that an earlier process left.

`turtleact.journal` implements the journal with SQLite. The server knows only this interface.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, Literal, Protocol, TypeAlias, TypeVar

import msgspec

from turtleact.goal import GoalStatus

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = ["GoalChange", "GoalJournal", "GoalRecord", "OnRestart", "Resumed"]

R = TypeVar("R", bound="Message")
F = TypeVar("F", bound="Message")

OnRestart: TypeAlias = Literal["abort", "resume"]
"""What to do with goals that an earlier process has left unfinished."""


class Resumed(msgspec.Struct, Generic[R, F], frozen=True):
    """What is left of a goal that an earlier process began.

    Attributes:
        feedback: The newest feedback in the journal; None if there was none.
        partial_result: The partial result that the body had set before; None if there was none.
    """

    feedback: F | None = None
    partial_result: R | None = None


class GoalRecord(msgspec.Struct, kw_only=True):
    """A goal as a journal keeps it. Messages are kept as CDR bytes.

    Attributes:
        id: The 16 bytes of its id.
        action: The fully qualified name of its action.
        type_name: The action's type, ``pkg/action/Name``.
        type_hash: The hash of that type.
        request: The goal message.
        stamp: When the server accepted it (ns since the epoch, by the graph's clock).
        accepted: When the server accepted it, by the wall clock (ns): the graph's clock may be
            virtual.
        status: Its state.
        is_built_in: Whether a built-in action has accepted it.
        is_nested: Whether the body of another goal has sent it.
        sender: The gid of the client that sent it, if that client is in another process.
        number: Its place in the order of acceptance. The journal assigns it.
        crashes: How often its server has crashed since its newest feedback.
        is_stopped: Whether its server has shut down properly since the goal last started.
        is_paused: Whether it is paused.
        feedback: The newest feedback; empty if there is none.
        feedback_count: How many feedback messages there have been.
        partial_result: The partial result; empty if there is none.
        result: The result; empty until the end.
        reason: Why it was aborted.
        ended: When it ended (ns, wall clock); 0 before.
        expires: When its result expires (ns, wall clock); 0 for never.
    """

    id: bytes
    action: str
    type_name: str
    type_hash: str
    request: bytes
    stamp: int
    accepted: int
    status: GoalStatus = GoalStatus.ACCEPTED
    is_built_in: bool = False
    is_nested: bool = False
    sender: bytes = b""
    number: int = 0
    crashes: int = 0
    is_stopped: bool = False
    is_paused: bool = False
    feedback: bytes = b""
    feedback_count: int = 0
    partial_result: bytes = b""
    result: bytes = b""
    reason: str = ""
    ended: int = 0
    expires: int = 0


class GoalChange(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What has changed in a goal. A field that has not changed is None; see `GoalRecord` for units.

    Attributes:
        status: Its new state.
        feedback: Its newest feedback.
        partial_result: Its partial result.
        is_stopped: Whether its server shuts down properly.
        is_paused: Whether it is paused.
        crashes: How often its server has crashed since its newest feedback.
        result: Its result, when it ends.
        reason: Why it was aborted, when it ends.
        ended: When it ended.
        expires: When its result expires.
    """

    status: GoalStatus | None = None
    feedback: bytes | None = None
    partial_result: bytes | None = None
    is_stopped: bool | None = None
    is_paused: bool | None = None
    crashes: int | None = None
    result: bytes | None = None
    reason: str | None = None
    ended: int | None = None
    expires: int | None = None

    def columns(self) -> dict[str, object]:
        """Return what has changed, by the names of `GoalRecord`."""
        values = ((name, getattr(self, name)) for name in self.__struct_fields__)
        return {name: value for name, value in values if value is not None}


class GoalJournal(Protocol):
    """Keeps goals on disk. Changes reach the disk in the order in which they were made.

    Attributes:
        max_starts: A goal is not started again after this many crashes of its server without
            feedback in between; None for no limit.
        aborts_at_close: Whether closing a server ends its goals, even if they would go on after a
            crash.
    """

    max_starts: int | None
    aborts_at_close: bool

    def load(self, action: str) -> list[GoalRecord]:
        """Return an action's goals that have not ended, or whose results are still kept."""

    async def accept(self, record: GoalRecord) -> GoalRecord | None:
        """Put a new goal on disk. If its id is known, return the record of the known goal instead.

        Raises:
            TurtleactError: if the goal cannot be written. The error's text says why.
        """

    async def withdraw(self, goal_id: bytes) -> None:
        """Remove a goal that was not accepted after all."""

    def progress(
        self, goal_id: bytes, change: GoalChange, then: Callable[[], object] | None = None
    ) -> None:
        """Write a change soon, and call ``then`` once the change would survive a killed process.

        If the disk is full, ``then`` is called all the same, because the goal goes on.
        """

    def end(self, goal_id: bytes, change: GoalChange, then: Callable[[], object]) -> None:
        """Put a goal's end on disk, and call ``then`` when it is there, however long this takes."""

    async def written(self) -> None:
        """Wait until each change so far has been written or has failed."""
