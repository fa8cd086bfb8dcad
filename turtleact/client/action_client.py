"""An action's client: sends goals, takes hold of those of others, cancels them.

It knows what a caller may ask of an action; what it holds of a goal stands in
`turtleact.client.goal_handle`. A server in the same process is used directly, one elsewhere by way
of messages (`GoalServer`).

Source: rclpy ``action/client.py`` for names and meaning.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Coroutine, Generator
from inspect import CO_COROUTINE
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import msgspec

from turtleact.body import ActionType
from turtleact.client.distant_server import DistantServer
from turtleact.client.goal_handle import ClientGoalHandle
from turtleact.client.goal_server import GoalServer
from turtleact.errors import InvalidOption, ServerUnavailable, TurtleactError, UnknownGoal
from turtleact.goal import OnFeedback
from turtleact.goal_id import goal_id_bytes
from turtleact.interfaces import Message, nanoseconds
from turtleact.interfaces.standard import CancelGoal, Time
from turtleact.names import ActionNames
from turtleact.transports.base import (
    Closeable,
    Transport,
    find_server,
    wait_until_served,
)

__all__ = ["ActionClient", "Attach", "SendGoal"]

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class ActionClient(Generic[G, R, F]):
    """Sends goals to one action; made by `turtleact.Node.action_client`.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action.
        is_open: Whether it sends goals.
    """

    def __init__(
        self,
        transport: Transport,
        action_type: ActionType[G, R, F],
        names: ActionNames,
        distant: DistantServer,
    ) -> None:
        self.name = names.name
        self.action_type = action_type
        self._transport = transport
        self._service = (names.send_goal, f"{action_type.type_name}_SendGoal")
        self.membership: Closeable | None = None
        self._distant = distant
        self._server: GoalServer | None = None
        self.is_open = True

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
            InvalidOption: if the ``feedback_callback`` is a coroutine function.
            InvalidGoal: (when awaited or entered) if a value does not fit its type; nothing sent.
            ServerUnavailable: if nobody serves the action.
            GoalRejected: if the server does not take the goal.
            GoalAborted, GoalCanceled: (when awaited) if the goal ends so.
        """
        if feedback_callback is not None and _is_coroutine_function(feedback_callback):
            problem = "must be a plain function: it is called in the server's turn, not awaited"
            raise InvalidOption("feedback_callback", problem)
        return SendGoal(
            self,
            goal,
            None if goal_id is None else goal_id_bytes(goal_id),
            feedback_callback,
        )

    def attach(self, goal_id: bytes | uuid.UUID) -> Attach[R, F]:
        """Take hold of a goal that somebody else has sent: ``await`` or enter it for a handle.

        The goal goes on when the block is left, whatever happens there.

        Args:
            goal_id: 16 bytes or a UUID.

        Raises:
            ServerUnavailable: (when awaited or entered) if nobody serves the action.
            TurtleactError: likewise, if the client is closed.
            UnknownGoal: likewise, if the server does not hold the goal, or not any more.
        """
        return Attach(self, goal_id_bytes(goal_id))

    async def wait_for_server(self, timeout: float | None = None) -> bool:
        """Wait until somebody serves the action. Cancelling: safe.

        Args:
            timeout: How long to wait (s, by the clock of the graph); for ever if left out.

        Returns:
            Whether it is served.

        Raises:
            InvalidOption: if ``timeout`` is not a number.
        """
        return await wait_until_served(self._transport, self._find, timeout)

    async def cancel_all(self) -> CancelGoal.Response:
        """Ask the server to cancel every goal of the action."""
        return await (await self.server()).cancel(None, 0)

    async def cancel_before(self, stamp: Time) -> CancelGoal.Response:
        """Ask the server to cancel every goal accepted at or before ``stamp``."""
        return await (await self.server()).cancel(None, nanoseconds(stamp))

    async def aclose(self) -> None:
        """Leave the graph; the goals it has sent go on, unless their server cancels them."""
        self.is_open = False
        self._distant.client_lost(self)
        if self._server is not None and self._server is not self._distant:
            self._server.client_lost(self)
        self._server = None
        if self.membership is not None:
            self.membership.close()

    async def server(self) -> GoalServer:
        """The server of the action; on a graph that has just been joined it is waited for.

        Raises:
            ServerUnavailable: if nobody serves it.
        """
        server = self.known_server()
        if server is None:
            server = self._server = await find_server(self._transport, self._find)
            if server is None:
                raise ServerUnavailable(self.name, self._distant.why_not_served())
        return server

    def known_server(self) -> GoalServer | None:
        """The server of the action, if it can be told without waiting."""
        server = self._server
        if server is None or not server.is_open:
            if not self.is_open:
                raise TurtleactError(f"the client of action '{self.name}' is closed: open another")
            server = self._server = self._find()
        return server

    def _find(self) -> GoalServer | None:
        found = self._transport.local(*self._service)
        if isinstance(found, GoalServer):
            return found
        return self._distant if self._distant.is_open else None


if TYPE_CHECKING:

    class _Calling(Coroutine[Any, Any, R], Generic[R]):
        """What a type checker takes a `SendGoal` for."""

        def __init__(self, *parts: object) -> None: ...

else:

    class _Calling(msgspec.Struct, Generic[R], eq=False):
        """What a `SendGoal` is; no struct can inherit from an abstract base class."""


class SendGoal(_Calling[R], Generic[G, R, F]):
    """A goal about to be sent.

    ``await`` sends it and gives the result; canceling the waiting task cancels the goal, waits for
    its end and goes on. ``async with`` sends it and gives the handle; leaving the block with the
    goal still active cancels it and waits for its end, unless it was detached. As it is also a
    coroutine, ``create_task`` takes it as it is, and ``start_soon`` takes `ActionClient.send_goal`.
    """

    _client: ActionClient[G, R, F]
    _request: G
    _goal_id: bytes | None
    _on_feedback: OnFeedback | None
    _handle: ClientGoalHandle[R, F] | None = None
    _calling: Generator[object, object, R] | None = None

    def __await__(self) -> Generator[object, object, R]:
        server = self._client.known_server()
        calling = self._call().__await__() if server is None else self._call_on(server)
        return calling  # type: ignore[return-value]  # the result's class is R

    async def _call(self) -> object:
        server = await self._client.server()
        return await _Awaitable(self._call_on(server))

    def _call_on(self, server: GoalServer) -> Generator[object, object, object]:
        return server.call(self._request, self._goal_id, self._on_feedback, self._client)

    def send(self, value: object) -> object:
        """Go on to the next wait; what an event loop calls."""
        if self._calling is None:
            self._calling = self.__await__()
        return self._calling.send(value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Raise something at the current wait; what an event loop calls."""
        if self._calling is None:
            raise error
        return self._calling.throw(error)

    def close(self) -> None:
        """End it; what an event loop calls."""
        if self._calling is not None:
            self._calling.close()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        server = await self._client.server()
        goal = server.begin(self._request, self._goal_id, self._on_feedback, self._client)
        if goal is None:
            goal = await server.take(self._request, self._goal_id, self._on_feedback, self._client)
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


Coroutine.register(SendGoal)


class _Awaitable(msgspec.Struct):
    """A generator as something to await."""

    _steps: Generator[object, object, object]

    def __await__(self) -> Generator[object, object, object]:
        return self._steps


class Attach(msgspec.Struct, Generic[R, F], eq=False):
    """A goal about to be taken hold of: ``await`` or enter it for the handle."""

    _client: ActionClient[Any, R, F]
    _goal_id: bytes
    _handle: ClientGoalHandle[R, F] | None = None

    def __await__(self) -> Generator[object, object, ClientGoalHandle[R, F]]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        server = await self._client.server()
        goal = await server.attach(self._goal_id)
        if goal is None:
            raise UnknownGoal(f"'{self._client.name}' holds no goal {self._goal_id.hex()}")
        self._handle = ClientGoalHandle(server, goal, _is_sender=False)
        return self._handle

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._handle = None


def _is_coroutine_function(callback: object) -> bool:
    """What `inspect.iscoroutinefunction` says of functions and methods, and faster."""
    code = getattr(callback, "__code__", None)
    return code is not None and bool(code.co_flags & CO_COROUTINE)
