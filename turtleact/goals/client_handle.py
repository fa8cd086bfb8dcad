"""Provides a client's handle of a goal, which gives feedback and result, and can cancel the goal.

The handle reads a `Goal` object. If the server is in the same process, the handle reads the
server's own object. Otherwise the client has a `Goal` object of its own, and messages from the
server keep the object up to date (`turtleact.goals.remote`).

Source: rclpy ``action/client.py`` for names and behaviour.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from threading import get_ident
from typing import Any, ClassVar, Generic, Literal, Self, TypeAlias, TypeVar, cast

import msgspec

from turtleact.goals.server import GoalServer
from turtleact.goals.state import Goal, GoalStatus, failure
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.standard import CancelGoal, Time
from turtleact.tasks import LoopGuard, Tasks

__all__ = [
    "Accepted",
    "ClientGoalHandle",
    "Event",
    "FeedbackReceived",
    "HandleServices",
    "Outcome",
    "ResultReceived",
    "StatusChanged",
    "leave_goal",
]

R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class Outcome(msgspec.Struct, Generic[R], frozen=True):
    """How a goal ended.

    Attributes:
        status: SUCCEEDED, CANCELED or ABORTED.
        result: The result. If the goal did not succeed, the result may be partial, or have default
            values.
        reason: Why the goal was aborted; empty if it was not aborted.
    """

    status: GoalStatus
    result: R
    reason: str = ""


class Accepted(msgspec.Struct, frozen=True):
    """The first event of a goal: the server has accepted it.

    Attributes:
        goal_id: The goal's id, 16 bytes.
        stamp: When the server accepted the goal.
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
    """The goal's body has published a feedback message.

    Attributes:
        feedback: The feedback message.
    """

    kind: ClassVar[Literal["feedback"]] = "feedback"

    feedback: F


class ResultReceived(msgspec.Struct, Generic[R], frozen=True):
    """The last event of a goal: the goal has ended.

    Attributes:
        outcome: How the goal ended: status, result and reason.
    """

    kind: ClassVar[Literal["result"]] = "result"

    outcome: Outcome[R]


Event: TypeAlias = Accepted | StatusChanged | FeedbackReceived[F] | ResultReceived[R]


class ClientGoalHandle(Generic[R, F]):
    """A client's handle of a goal.

    ``async for feedback in handle`` gives each feedback message once, in order, and ends when the
    goal ends. The loop also gives messages from before the loop began, if those messages are still
    kept. While the sender of the goal iterates over its handle, unread messages are kept. If the
    server is in the same process and the sender is far behind, the goal's body waits for the
    sender. If the server is in another process, at most 65,536 unread messages are kept. If the
    sender does not iterate, or if the client has attached to the goal, at least the newest 1,024
    messages are kept. `missed` counts the messages that were dropped unread.

    Callers that cannot await use `done`, `status`, `last_feedback` and `cancel_nowait`.
    """

    __slots__ = (
        "_goal",
        "_guard",
        "_is_detached",
        "_is_sender",
        "_iterations",
        "_missed",
        "_next",
        "_server",
        "_services",
    )

    def __init__(
        self, server: GoalServer, goal: Goal, services: HandleServices, *, is_sender: bool
    ) -> None:
        goal.log.is_kept = True
        self._server = server
        self._goal = goal
        self._guard = services.guard
        self._services = services
        self._is_sender = is_sender
        self._is_detached = False
        self._missed = 0
        self._next = 0 if is_sender else goal.log.dropped  # the index of the next unread message
        self._iterations = 0

    @property
    def goal_id(self) -> bytes:
        """The goal's id, 16 bytes."""
        return self._goal.id

    @property
    def stamp(self) -> Time:
        """When the server accepted the goal."""
        return stamp_of(self._goal.stamp)

    @property
    def request(self) -> Message | None:
        """The goal message; None if another client sent it to a server in another process."""
        return cast("Message | None", self._goal.request)

    @property
    def status(self) -> GoalStatus:
        """The goal's state, as far as the client knows."""
        return self._goal.status

    @property
    def accepted(self) -> bool:
        """Whether the server accepted the goal.

        This is always True, because only accepted goals have handles.
        """
        return True

    @property
    def done(self) -> bool:
        """Whether the goal has ended."""
        return self._goal.ended != 0

    @property
    def last_feedback(self) -> F | None:
        """The newest feedback message, whether or not it was read; None before the first."""
        return cast("F | None", self._goal.log.last)

    @property
    def missed(self) -> int:
        """How many feedback messages were dropped before this handle read them."""
        return self._missed

    @property
    def is_paused(self) -> bool:
        """Whether the goal is paused.

        ROS 2 has no state for pauses, so `status` stays EXECUTING.
        """
        return self._server.pauses.is_paused(self._goal)

    @property
    def is_resumed(self) -> bool:
        """Whether the goal began in an earlier process, and this process resumed it.

        This is always False if the server is in another process.
        """
        return self._goal.id in self._server.resumed

    # feedback

    def __aiter__(self) -> AsyncIterator[F]:
        self._start_iteration()
        return _Feedback(self)

    async def __anext__(self) -> F:
        self._guard.check()
        return await self._read()

    async def _read(self) -> F:
        """Return the next feedback message.

        If the goal has ended and no message is left, raise StopAsyncIteration.
        """
        # Messages in the log come first, even if the goal has ended. Checking the log and starting
        # to wait happen in one step of the task, so no signal can fire in between and be lost.
        goal = self._goal
        log = goal.log
        while True:
            items = log.items
            at = self._next - log.count + len(items)
            if at < 0:
                self._missed -= at
                self._next -= at
                at = 0
            if at < len(items):
                self._next += 1
                if self._is_sender and log.read is not None:
                    log.read = self._next
                    log.relieve()
                return cast("F", items[at])
            if goal.ended:
                if goal.error is not None:
                    raise goal.error
                raise StopAsyncIteration
            await goal.changed.wait()

    def events(self) -> AsyncIterator[Event[F, R]]:
        """Iterate over the goal's events, from its acceptance to its result.

        Each event has an attribute ``kind``, such as ``"feedback"``.

        This loop shares the feedback with ``async for feedback in handle``: each message appears in
        only one of the two loops.
        """
        self._start_iteration()
        return _Events(self)

    def _start_iteration(self) -> None:
        """Begin an iteration. If this client sent the goal, unread feedback is kept from now on."""
        self._guard.check()
        self._iterations += 1
        if self._is_sender:
            self._goal.log.read = self._next

    def _end_iteration(self, thread: int) -> None:
        """Record that an iterator, which was made in ``thread``, is gone. Any thread may call this.

        Reading stops only when the last iterator is gone. The late end of an abandoned loop
        therefore does not stop a newer loop.
        """
        if get_ident() != thread:
            self._services.tasks.from_anywhere(lambda: self._end_iteration(thread))
            return
        self._iterations -= 1
        if not self._iterations:
            self._stop_reading()

    def _stop_reading(self) -> None:
        """From now on, the goal's body does not wait for the sender to read the feedback."""
        if self._is_sender:
            self._goal.log.read = None
            self._goal.log.relieve()

    # the end

    async def result(self) -> R:
        """Wait for the result, and return it. Cancelling the call is safe: the goal continues.

        Raises:
            GoalAborted: if the goal was aborted.
            GoalCanceled: if the goal was canceled.
            ServerUnavailable: if the server goes away before the goal has ended.
        """
        goal = await self._wait_for_end()
        if goal.status is GoalStatus.SUCCEEDED:
            return goal.result  # type: ignore[return-value]  # the server checked it
        raise failure(goal)

    async def outcome(self) -> Outcome[R]:
        """Wait for the goal's end, and return the outcome, even of a failed goal. Cancelling: safe.

        Raises:
            ServerUnavailable: if the server goes away before the goal has ended.
        """
        goal = await self._wait_for_end()
        if goal.error is not None:
            raise goal.error
        return Outcome(goal.status, cast("R", goal.result), goal.reason)

    async def _wait_for_end(self) -> Goal:
        """Wait for the goal's end.

        Until then, the goal's body does not wait for the goal's sender to read the feedback.
        """
        self._guard.check()
        self._hurry(1)
        try:
            await self._goal.wait_for_end()
        finally:
            self._hurry(-1)
        return self._goal

    def _hurry(self, change: int) -> None:
        """Add ``change`` to the number of callers that wait for the goal's end.

        If any caller waits, the goal's body does not wait for the sender to read the feedback.
        """
        if self._is_sender:
            self._goal.log.hurried += change
            self._goal.log.relieve()

    # requests

    async def cancel(self) -> CancelGoal.Response:
        """Ask the server to cancel the goal, and return the server's answer."""
        self._guard.check()
        return await self._server.cancel(self._goal.id, 0)

    def cancel_nowait(self) -> None:
        """Ask the server to cancel the goal, without waiting for the server's answer.

        If the server agrees, `status` becomes CANCELING.
        """
        self._guard.check()
        if not self._goal.ended:
            self._services.cancel_soon(self._server, self._goal)

    async def pause(self, timeout: float = 5.0) -> None:
        """Pause the goal, and return once its body has paused.

        Pausing a paused goal does nothing. Cancelling the call withdraws the request.

        Args:
            timeout: How long to wait for the body to pause (s, event loop time). After this time,
                the request is withdrawn, and the goal continues.

        Raises:
            PauseRefused: if the goal cannot be paused, or its body takes too long. The error gives
                the reason.
            ServerUnavailable: if the server goes away.
        """
        self._guard.check()
        await self._server.pauses.pause(self._goal, timeout)

    async def resume(self) -> None:
        """Let a paused goal continue. Resuming a goal that is not paused does nothing.

        Raises:
            PauseRefused: if the server's ``on_resume`` fails, so that the goal stays paused.
            ServerUnavailable: if the server goes away.
        """
        self._guard.check()
        await self._server.pauses.resume(self._goal)

    def detach(self) -> None:
        """Let the goal continue after the ``async with`` block of this handle."""
        self._is_detached = True


class HandleServices(msgspec.Struct):
    """What a client lends to the handles of its goals.

    Attributes:
        guard: The client's event loop.
        tasks: The functions for tasks in the client's event loop.
        cancel_soon: Starts a task that cancels a goal.
    """

    guard: LoopGuard
    tasks: Tasks
    cancel_soon: Callable[[GoalServer, Goal], None]


async def leave_goal(handle: ClientGoalHandle[R, F], timeout: float) -> Goal | None:
    """Stop reading a goal's feedback; unless the goal is detached, cancel it and wait for its end.

    Args:
        handle: The handle.
        timeout: How long to wait at most for the goal's end (s, event loop time).

    Returns:
        The goal, if it goes on without its client.
    """
    goal = handle._goal
    if goal.ended:
        return None
    handle._stop_reading()
    if handle._is_detached:
        return goal
    await handle._server.abandon(goal, timeout)
    return None


class _Iteration:
    """The iterator of one ``async for`` loop.

    The body of the goal may be waiting for this iterator to read feedback. That wait must end with
    the ``async for`` loop. If a loop ends with ``break``, Python does not notify the iterator, but
    only drops it. The finalizer of the iterator therefore reports the end of the loop. If the
    iterator is part of a reference cycle, the finalizer may run in any thread.

    If this iterator were an async generator, the event loop would close it. The iterator is
    nevertheless not an async generator, because an async generator cannot continue after a
    cancelled ``anext``. In addition, trio warns about every async generator that is left before its
    end.
    """

    __slots__ = ("_handle", "_thread")

    def __init__(self, handle: ClientGoalHandle[Any, Any]) -> None:
        self._handle = handle
        self._thread = get_ident()

    def __del__(self) -> None:
        self._handle._end_iteration(self._thread)


class _Feedback(_Iteration, Generic[F]):
    """The iterator of one ``async for`` loop over a goal's feedback."""

    __slots__ = ()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> F:
        return cast("F", await self._handle._read())


class _Events(_Iteration, Generic[F, R]):
    """The iterator of one ``async for`` loop over a goal's events."""

    __slots__ = ("_step", "_told")

    def __init__(self, handle: ClientGoalHandle[Any, Any]) -> None:
        super().__init__(handle)
        self._step: Literal["accepted", "under way", "ended", "over"] = "accepted"
        self._told = 0  # how many states of the goal's history were given

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event[F, R]:
        handle = self._handle
        goal = handle._goal
        if self._step == "accepted":
            self._step = "under way"
            return Accepted(goal.id, stamp_of(goal.stamp))
        while self._step == "under way":
            status = self._next_status()
            if status is not None:
                return StatusChanged(status)
            if self._next_unread is not None:
                return FeedbackReceived(await handle._read())
            if goal.error is not None:
                raise goal.error
            if goal.ended:
                self._step = "ended"
                return StatusChanged(goal.status)
            await goal.changed.wait()
        if self._step == "ended":
            self._step = "over"
            return ResultReceived(Outcome(goal.status, cast("R", goal.result), goal.reason))
        raise StopAsyncIteration

    @property
    def _next_unread(self) -> int | None:
        """The index (from 0) of the next unread feedback message; None if no message is unread."""
        handle, log = self._handle, self._handle._goal.log
        if handle._next >= log.count or not log.items:
            return None
        return max(handle._next, log.dropped)

    def _next_status(self) -> GoalStatus | None:
        """Return the next state in the goal's history, or None.

        None means that no state is left, or that earlier feedback must be read first.
        """
        history = self._handle._goal.log.history
        if self._told == len(history):
            return None
        status: GoalStatus
        status, count = history[self._told]
        unread = self._next_unread
        if unread is not None and unread < count:
            return None
        self._told += 1
        return status
