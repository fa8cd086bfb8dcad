"""A goal as its client sees it: its feedback, its events, its end, and how to cancel it.

It reads a `Goal`: the very one that a server in the same process holds, or one that is kept up to
date by messages (`GoalServer`). The one who has sent the goal reads without loss, and is waited
for; others, who have attached themselves, get what is kept.

Source: rclpy ``action/client.py`` for names and meaning.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Coroutine
from threading import get_ident
from typing import (
    ClassVar,
    Generic,
    Literal,
    Self,
    TypeAlias,
    TypeVar,
    cast,
)

import msgspec

from turtleact.client.goal_server import GoalServer
from turtleact.feedback import FeedbackLog
from turtleact.goal import Goal, GoalStatus, failure
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.standard import CancelGoal, Time

__all__ = [
    "Accepted",
    "ClientGoalHandle",
    "Event",
    "FeedbackReceived",
    "Outcome",
    "ResultReceived",
    "StatusChanged",
]

R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class Outcome(msgspec.Struct, Generic[R], frozen=True):
    """How a goal ended.

    Attributes:
        status: SUCCEEDED, CANCELED or ABORTED.
        result: The result; for a goal that did not succeed the partial or default one.
        reason: Why it was aborted; empty otherwise.
    """

    status: GoalStatus
    result: R
    reason: str = ""


class Accepted(msgspec.Struct, frozen=True):
    """The first event of a goal: the server has taken it.

    Attributes:
        goal_id: Its 16 bytes.
        stamp: When that was.
    """

    kind: ClassVar[Literal["accepted"]] = "accepted"

    goal_id: bytes
    stamp: Time


class StatusChanged(msgspec.Struct, frozen=True):
    """A goal has entered another state.

    Attributes:
        status: The new state.
    """

    kind: ClassVar[Literal["status"]] = "status"

    status: GoalStatus


class FeedbackReceived(msgspec.Struct, Generic[F], frozen=True):
    """The body has published feedback.

    Attributes:
        feedback: The message.
    """

    kind: ClassVar[Literal["feedback"]] = "feedback"

    feedback: F


class ResultReceived(msgspec.Struct, Generic[R], frozen=True):
    """The last event of a goal: how it ended.

    Attributes:
        outcome: Status, result and reason.
    """

    kind: ClassVar[Literal["result"]] = "result"

    outcome: Outcome[R]


Event: TypeAlias = Accepted | StatusChanged | FeedbackReceived[F] | ResultReceived[R]


class ClientGoalHandle(msgspec.Struct, Generic[R, F], eq=False):
    """What a client holds of its goal.

    ``async for feedback in handle`` gives each feedback message once, in order, those too that were
    published before the iteration began, and ends when the goal does. Nothing is lost to the sender
    while it iterates, and a generator that runs far ahead of it waits; before and after that, and
    for those who have attached themselves, the newest 1,024 are kept, and `missed` counts the
    others.

    `done`, `status`, `last_feedback` and `cancel_nowait` are for callers that cannot wait.

    Attributes:
        missed: How many feedback messages this reader has lost.
    """

    _server: GoalServer
    _goal: Goal
    _is_sender: bool = True
    _next: int = 0
    _detached: bool = False
    _readers: int = 0
    missed: int = 0

    @property
    def goal_id(self) -> bytes:
        """The goal's 16 bytes."""
        return self._server.name_goal(self._goal)

    @property
    def stamp(self) -> Time:
        """When the goal was accepted."""
        return stamp_of(self._goal.stamp)

    @property
    def status(self) -> GoalStatus:
        """The goal's state, as known now."""
        return self._goal.status

    @property
    def accepted(self) -> bool:
        """Whether the server took the goal; a handle exists only if it did."""
        return True

    @property
    def done(self) -> bool:
        """Whether the goal has ended."""
        return self._goal.ended != 0

    @property
    def last_feedback(self) -> F | None:
        """The newest feedback, read or not."""
        return cast("F | None", self._goal.last_feedback)

    def __aiter__(self) -> AsyncIterator[F]:
        self.start_reading()
        return _Reading(self)

    async def __anext__(self) -> F:
        goal = self._goal
        while True:
            log = goal.feedback
            if log is not None:
                if self._next < log.dropped:
                    self.missed += log.dropped - self._next
                    self._next = log.dropped
                at = self._next - log.dropped
                if at < len(log.items):
                    self._next += 1
                    if log.read is not None and self._is_sender:
                        log.read = self._next
                        if log.drained is not None:
                            log.relieve()
                    return log.items[at]  # type: ignore[return-value]  # the server checked it
            if goal.ended:
                if goal.error is not None:
                    raise goal.error
                raise StopAsyncIteration
            await self._server.signal(goal).wait()

    def events(self) -> AsyncIterator[Event[F, R]]:
        """All that happens to the goal, from its acceptance to its result, each with a ``kind``.

        The feedback among it is that of ``async for feedback in handle``: what one of the two has
        given, the other does not give again.
        """
        self.start_reading()
        return _Events(self)

    async def result(self) -> R:
        """Wait for the result. Cancelling: safe, the goal goes on.

        Raises:
            GoalAborted: if the goal was aborted.
            GoalCanceled: if the goal was canceled.
            ServerUnavailable: if its server has gone.
        """
        goal = self._goal
        if not goal.ended:
            await self._wait()
        if goal.status is GoalStatus.SUCCEEDED:
            return goal.result  # type: ignore[return-value]  # the server checked it
        raise failure(goal)

    async def outcome(self) -> Outcome[R]:
        """Wait for the end; never raises for a goal that did not succeed. Cancelling: safe.

        Raises:
            ServerUnavailable: if its server has gone.
        """
        goal = self._goal
        if not goal.ended:
            await self._wait()
        if goal.error is not None:
            raise goal.error
        return Outcome(goal.status, cast("R", goal.result), goal.reason)

    @property
    def next_unread(self) -> int | None:
        """The number of the feedback that can be read without waiting; None if there is none."""
        log = self._goal.feedback
        return None if log is None or self._next >= log.count else max(self._next, log.dropped)

    async def cancel(self) -> CancelGoal.Response:
        """Ask the server to cancel the goal; the answer says whether it will."""
        return await self._server.cancel_goal(self._goal)

    def cancel_nowait(self) -> None:
        """Ask the server to cancel the goal; `status` tells in time whether it has agreed."""
        if not self.done:
            self._server.cancel_nowait(self._goal)

    def detach(self) -> None:
        """Let the goal go on when the block is left."""
        self._detached = True

    async def leave(self) -> None:
        """Stop reading; cancel the goal and wait for its end, unless it is detached."""
        self.stop_reading()
        if not self._detached:
            await self._server.cancel_and_wait(self._goal)

    def start_reading(self) -> None:
        """Have all feedback kept from here on, if it is the sender that reads."""
        log = self._goal.feedback
        if log is None:
            log = self._goal.feedback = FeedbackLog()
        self._readers += 1
        if self._is_sender:
            log.read = self._next

    def end_reading(self) -> None:
        """Note that an iteration has been left; a late one does not disturb those begun since."""
        self._readers -= 1
        if not self._readers:
            self.stop_reading()

    def forget_reader(self, thread: int) -> None:
        """Note that an iterator is gone; one in a cycle is collected in whatever thread."""
        if get_ident() == thread:
            self.end_reading()
        else:
            self._server.from_anywhere(self.end_reading)

    def stop_reading(self) -> None:
        """Let the body run ahead: nobody iterates any more."""
        log = self._goal.feedback
        if log is not None and self._is_sender:
            log.read = None
            log.relieve()

    async def _wait(self) -> None:
        """Wait for the end. A sender that does so does not hold the body up, whatever it reads."""
        if not self._is_sender:
            await self._server.wait_for_end(self._goal)
            return
        log = self._goal.feedback
        if log is None:
            log = self._goal.feedback = FeedbackLog()
        log.hurried += 1
        log.relieve()
        try:
            await self._server.wait_for_end(self._goal)
        finally:
            log.hurried -= 1


class _Reading(Generic[F]):
    """One ``async for``: when it is left, by ``break`` too, the body need not wait for it."""

    __slots__ = ("_handle", "_thread")

    def __init__(self, handle: ClientGoalHandle[R, F]) -> None:
        self._handle = handle
        self._thread = get_ident()

    def __aiter__(self) -> Self:
        return self

    def __anext__(self) -> Coroutine[object, object, F]:
        return self._handle.__anext__()

    def __del__(self) -> None:
        self._handle.forget_reader(self._thread)


class _Events(Generic[F, R]):
    """One ``async for`` over all that happens to a goal."""

    __slots__ = ("_handle", "_step", "_thread", "_told")

    def __init__(self, handle: ClientGoalHandle[R, F]) -> None:
        self._handle = handle
        self._thread = get_ident()
        self._step: Literal["accepted", "under way", "ended", "over"] = "accepted"
        self._told = 0  # how many states of the goal's history

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event[F, R]:
        handle = self._handle
        goal = handle._goal  # one of the handle's own readers
        if self._step == "accepted":
            self._step = "under way"
            return Accepted(handle.goal_id, handle.stamp)
        while self._step == "under way":
            status = self._next_status(goal)
            if status is not None:
                return StatusChanged(status)
            if handle.next_unread is not None:
                return FeedbackReceived(await handle.__anext__())
            if goal.error is not None:
                raise goal.error
            if goal.ended:
                self._step = "ended"
                return StatusChanged(goal.status)
            await handle._server.signal(goal).wait()
        if self._step == "ended":
            self._step = "over"
            return ResultReceived(await handle.outcome())
        raise StopAsyncIteration

    def __del__(self) -> None:
        self._handle.forget_reader(self._thread)

    def _next_status(self, goal: Goal) -> GoalStatus | None:
        """The next state of the history, if no unread feedback went before it."""
        if self._told == len(goal.history):
            return None
        status, count = goal.history[self._told]
        unread = self._handle.next_unread
        if unread is not None and unread < count:
            return None
        self._told += 1
        return status
