"""An action's client: sends goals, reads their feedback, waits for their results, cancels them.

It knows what a caller may ask of a goal; what the answers mean stands in `turtleact.goal`. A server
in the same process is used directly (`LocalServer`), and the goal's handle then reads the very
`Goal` that the server holds.

Source: rclpy ``action/client.py`` for names and meaning.
"""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from types import TracebackType
from typing import Generic, Protocol, Self, TypeAlias, TypeVar, cast, runtime_checkable

import anyio
import msgspec

from turtleact.body import ActionType
from turtleact.errors import ServerUnavailable
from turtleact.goal import FeedbackLog, Goal, GoalStatus, failure
from turtleact.goal_id import goal_id_bytes
from turtleact.interfaces import Message
from turtleact.interfaces.standard import CancelGoal, Time
from turtleact.names import ActionNames
from turtleact.tasks import Signal
from turtleact.transports.base import Closeable, Transport

__all__ = ["ActionClient", "ClientGoalHandle", "Outcome", "SendGoal"]

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)

OnFeedback: TypeAlias = Callable[[object], object]


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


@runtime_checkable
class LocalServer(Protocol):
    """What a client asks of a server in its own process; see `turtleact.server.ActionServer`."""

    is_open: bool
    asks_first: bool

    async def ask(self, request: object) -> None: ...

    def begin(
        self, request: object, goal_id: bytes | None, on_feedback: OnFeedback | None
    ) -> Goal: ...

    def call(
        self, request: object, goal_id: bytes | None, on_feedback: OnFeedback | None
    ) -> Generator[object, object, object]: ...

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response: ...

    async def cancel_and_wait(self, goal: Goal) -> None: ...

    async def wait_for_end(self, goal: Goal) -> None: ...

    def name_goal(self, goal: Goal) -> bytes: ...

    def signal(self, goal: Goal) -> Signal: ...


class ActionClient(Generic[G, R, F]):
    """Sends goals to one action; made by `turtleact.Node.action_client`.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action.
    """

    def __init__(
        self,
        transport: Transport,
        action_type: ActionType[G, R, F],
        names: ActionNames,
    ) -> None:
        self.name = names.name
        self.action_type = action_type
        self._transport = transport
        self._service = (names.send_goal, f"{action_type.type_name}_SendGoal")
        self.membership: Closeable | None = None
        self._server: LocalServer | None = None

    def send_goal(
        self,
        goal: G,
        *,
        goal_id: bytes | uuid.UUID | None = None,
        feedback_callback: Callable[[F], object] | None = None,
    ) -> SendGoal[G, R, F]:
        """Send a goal: ``await`` it for the result, or enter it for a handle.

        Args:
            goal: The goal message.
            goal_id: 16 bytes or a UUID; a fresh one if left out.
            feedback_callback: Called with each feedback message, in the server's turn; what it
                raises is logged and does no harm.

        Raises:
            InvalidGoal: (when awaited or entered) if a value does not fit its type; nothing sent.
            ServerUnavailable: if nobody serves the action.
            GoalRejected: if the server does not take the goal.
            GoalAborted, GoalCanceled: (when awaited) if the goal ends so.
        """
        return SendGoal(
            self,
            goal,
            None if goal_id is None else goal_id_bytes(goal_id),
            feedback_callback,  # type: ignore[arg-type]  # it is called with this class alone
        )

    async def wait_for_server(self, timeout: float | None = None) -> bool:
        """Wait until somebody serves the action; False if nobody does after ``timeout`` seconds."""
        with anyio.move_on_after(timeout):
            while self._find() is None:
                await self._transport.wait_for_change()
        return self._find() is not None

    async def cancel_all(self) -> CancelGoal.Response:
        """Ask the server to cancel every goal of the action."""
        return await self.server().cancel(None, 0)

    async def cancel_before(self, stamp: Time) -> CancelGoal.Response:
        """Ask the server to cancel every goal accepted at or before ``stamp``."""
        return await self.server().cancel(None, stamp.sec * 1_000_000_000 + stamp.nanosec)

    async def aclose(self) -> None:
        """Leave the graph; the goals it has sent go on."""
        if self.membership is not None:
            self.membership.close()

    def server(self) -> LocalServer:
        """The server of the action.

        Raises:
            ServerUnavailable: if nobody serves it.
        """
        server = self._server
        if server is None or not server.is_open:
            server = self._server = self._find()
            if server is None:
                raise ServerUnavailable(self.name)
        return server

    def _find(self) -> LocalServer | None:
        found = self._transport.local(*self._service)
        return found if isinstance(found, LocalServer) else None


class SendGoal(msgspec.Struct, Generic[G, R, F], eq=False):
    """A goal about to be sent.

    ``await`` sends it and gives the result; canceling the waiting task cancels the goal, waits for
    its end and goes on. ``async with`` sends it and gives the handle; leaving the block with the
    goal still active cancels it and waits for its end, unless it was detached.
    """

    _client: ActionClient[G, R, F]
    _request: G
    _goal_id: bytes | None
    _on_feedback: OnFeedback | None
    _handle: ClientGoalHandle[R, F] | None = None

    def __await__(self) -> Generator[object, object, R]:
        calling = self._client.server().call(self._request, self._goal_id, self._on_feedback)
        return calling  # type: ignore[return-value]  # the result's class is R

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        server = self._client.server()
        if server.asks_first:
            await server.ask(self._request)
        goal = server.begin(self._request, self._goal_id, self._on_feedback)
        handle: ClientGoalHandle[R, F] = ClientGoalHandle(server, goal)
        self._handle = handle
        return handle

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._handle is not None and not self._handle.done:
            await self._handle.leave()


class ClientGoalHandle(msgspec.Struct, Generic[R, F], eq=False):
    """What a client holds of its goal.

    ``async for feedback in handle`` gives each feedback message once, in order, those too that were
    published before the iteration began, and ends when the goal does. Nothing is lost to a reader
    while it iterates, and a body that runs far ahead of it waits; before and after that the newest
    1,024 are kept, and `missed` counts the others.
    """

    _server: LocalServer
    _goal: Goal
    _next: int = 0
    _detached: bool = False
    missed: int = 0

    @property
    def goal_id(self) -> bytes:
        """The goal's 16 bytes."""
        return self._server.name_goal(self._goal)

    @property
    def stamp(self) -> Time:
        """When the goal was accepted."""
        sec, nanosec = divmod(self._goal.stamp, 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

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
        log = self._goal.feedback
        if log is None:
            log = self._goal.feedback = FeedbackLog()
        log.read = self._next
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
                    if log.read is not None:
                        log.read = self._next
                    if log.drained is not None and not log.is_full:
                        log.drained.fire()
                    return log.items[at]  # type: ignore[return-value]  # the server checked it
            if goal.ended:
                raise StopAsyncIteration
            await self._server.signal(goal).wait()

    async def result(self) -> R:
        """Wait for the result. Cancelling: safe, the goal goes on.

        Raises:
            GoalAborted: if the goal was aborted.
            GoalCanceled: if the goal was canceled.
        """
        goal = self._goal
        if not goal.ended:
            await self._server.wait_for_end(goal)
        if goal.status is GoalStatus.SUCCEEDED:
            return goal.result  # type: ignore[return-value]  # the server checked it
        raise failure(goal)

    async def outcome(self) -> Outcome[R]:
        """Wait for the end; never raises for a goal that did not succeed. Cancelling: safe."""
        goal = self._goal
        if not goal.ended:
            await self._server.wait_for_end(goal)
        return Outcome(goal.status, cast("R", goal.result), goal.reason)

    async def cancel(self) -> CancelGoal.Response:
        """Ask the server to cancel the goal; the answer says whether it will."""
        return await self._server.cancel(self.goal_id, 0)

    def detach(self) -> None:
        """Let the goal go on when the block is left."""
        self._detached = True

    async def leave(self) -> None:
        """Stop reading; cancel the goal and wait for its end, unless it is detached."""
        self.stop_reading()
        if not self._detached:
            await self._server.cancel_and_wait(self._goal)

    def stop_reading(self) -> None:
        """Let the body run ahead: nobody iterates any more."""
        log = self._goal.feedback
        if log is not None:
            log.read = None
            if log.drained is not None:
                log.drained.fire()


class _Reading(Generic[F]):
    """One ``async for``: when it is left, by ``break`` too, the body need not wait for it."""

    __slots__ = ("_handle",)

    def __init__(self, handle: ClientGoalHandle[R, F]) -> None:
        self._handle = handle

    def __aiter__(self) -> Self:
        return self

    def __anext__(self) -> Coroutine[object, object, F]:
        return self._handle.__anext__()

    def __del__(self) -> None:
        self._handle.stop_reading()
