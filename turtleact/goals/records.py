"""The interface of a journal, which keeps an action server's goals on disk.

A journal is not an observer: the server waits for the journal before the server accepts a goal, and
before the server announces a goal's end. When the server starts, it loads the goals that an earlier
process left.

`turtleact.journal` implements the journal with SQLite. The server uses only this interface.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, Literal, Protocol, TypeAlias, TypeVar

import msgspec

from turtleact.goals.state import GoalStatus

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = ["GoalChange", "GoalJournal", "GoalRecord", "OnRestart", "Resumed"]

R = TypeVar("R", bound="Message")
F = TypeVar("F", bound="Message")

OnRestart: TypeAlias = Literal["abort", "resume"]
"""What to do with goals that an earlier process has left unfinished."""


class Resumed(msgspec.Struct, Generic[R, F], frozen=True):
    """The progress that a goal made in an earlier process, as stored in the journal.

    Attributes:
        feedback: The newest feedback in the journal; None if there was none.
        partial_result: The newest partial result in the journal; None if there was none.
    """

    feedback: F | None = None
    partial_result: R | None = None


class GoalRecord(msgspec.Struct, kw_only=True):
    """A goal as a journal stores it. Messages are stored as CDR bytes.

    Attributes:
        id: The 16 bytes of the goal's id.
        action: The fully qualified name of the goal's action.
        type_name: The action's type, ``pkg/action/Name``.
        type_hash: The hash of the action's type.
        request: The goal message.
        stamp: When the server accepted the goal (ns since the epoch, by the graph's clock).
        accepted: When the server accepted the goal (ns since the epoch, by the wall clock). The
            graph's clock may be virtual, so ``stamp`` may be a different time.
        status: The goal's state.
        is_built_in: Whether a built-in action has accepted the goal.
        is_nested: Whether the body of another goal has sent the goal.
        sender: The gid of the client that sent the goal, if that client is in another process.
        number: The goal's number in the order of acceptance. The journal assigns the number.
        crashes: How often the server has crashed since the goal's newest feedback.
        is_stopped: Whether the server has shut down properly since the goal's latest start.
        is_paused: Whether the goal is paused.
        feedback: The newest feedback; empty if there is none.
        feedback_count: How many feedback messages the goal has published.
        partial_result: The partial result; empty if there is none.
        result: The result; empty until the goal's end.
        reason: Why the goal was aborted; empty if it was not.
        ended: When the goal ended (ns since the epoch, by the wall clock); 0 before.
        expires: When the result expires (ns since the epoch, by the wall clock); 0 for never.
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
    """What has changed in a goal; see `GoalRecord` for units. None means that a value is unchanged.

    Attributes:
        status: The goal's new state.
        feedback: The goal's newest feedback.
        partial_result: The goal's newest partial result.
        is_stopped: Whether the server has shut down properly since the goal's latest start.
        is_paused: Whether the goal is paused.
        crashes: How often the server has crashed since the goal's newest feedback.
        result: The goal's result, at its end.
        reason: Why the goal was aborted.
        ended: When the goal ended.
        expires: When the goal's result expires.
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
        """Return the changed values in a dict. The keys are names of fields of `GoalRecord`."""
        values = ((name, getattr(self, name)) for name in self.__struct_fields__)
        return {name: value for name, value in values if value is not None}


class GoalJournal(Protocol):
    """Stores goals on disk. Changes reach the disk in the order in which they were made.

    Attributes:
        max_starts: A goal is not started again after this many server crashes without new feedback.
            None means that there is no limit.
        aborts_at_close: Whether closing a server aborts its goals, even if they would be started
            again after a crash.
    """

    max_starts: int | None
    aborts_at_close: bool

    def load(self, action: str) -> list[GoalRecord]:
        """Return an action's goals that have not ended, or whose results are still kept."""

    async def accept(self, record: GoalRecord) -> GoalRecord | None:
        """Store a new goal. If its id is stored already, return the record of the stored goal.

        Raises:
            TurtleactError: if the goal cannot be written. The error's text says why.
        """

    async def withdraw(self, goal_id: bytes) -> None:
        """Remove a goal that was not accepted after all."""

    def progress(
        self, goal_id: bytes, change: GoalChange, then: Callable[[], object] | None = None
    ) -> None:
        """Store a change, and call ``then`` once the change would survive if the process is killed.

        If the disk is full, ``then`` is called before the change is on disk, so that the goal can
        continue.
        """

    def end(self, goal_id: bytes, change: GoalChange, then: Callable[[], object]) -> None:
        """Store a goal's end. Call ``then`` when the end is on disk, however long this takes."""

    async def written(self) -> None:
        """Wait until each change so far is on disk, or the attempt to write it has failed."""
