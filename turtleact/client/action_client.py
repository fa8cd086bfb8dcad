"""An action's client: sends goals, attaches to those of others, cancels them.

What a client holds of one goal is in `turtleact.client.goal_handle`. The client uses a server in
the same process directly, and one elsewhere by messages; both are a
`turtleact.goal_server.GoalServer`.

Source: rclpy ``action/client.py`` for names and meaning.
"""

from __future__ import annotations

import sys
import uuid
import warnings
from collections.abc import Callable, Coroutine, Generator
from inspect import CO_COROUTINE
from types import CodeType, TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import anyio.lowlevel
import msgspec

from turtleact.body import ActionType
from turtleact.client.client_endpoints import ClientEndpoints
from turtleact.client.goal_handle import ClientGoalHandle, GoalReader
from turtleact.client.remote_server import RemoteActionServer
from turtleact.errors import InvalidOption, ServerUnavailable, TurtleactError, UnknownGoal
from turtleact.goal import Goal, GoalStatus, OnFeedback, failure
from turtleact.goal_id import goal_id_bytes
from turtleact.goal_server import GoalOrder, GoalServer, OffersGoals
from turtleact.interfaces import Message, nanoseconds
from turtleact.interfaces.standard import CancelGoal, Time
from turtleact.observers import GoalObserver, Observers
from turtleact.tasks import Home, Tasks
from turtleact.transports.base import Closeable, find_server, wait_until_served

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
        observers: Told of each change and feedback of the goals that it has sent.
    """

    def __init__(
        self, endpoints: ClientEndpoints, tasks: Tasks, home: Home, cancel_timeout: float
    ) -> None:
        self.name = endpoints.name
        self.action_type: ActionType[G, R, F] = endpoints.action_type
        self.membership: Closeable | None = None
        self.is_open = True
        self.observers = _ClientObservers(self)
        self._endpoints = endpoints
        self._cancel_timeout = cancel_timeout
        self._home = home.of(f"the client of action '{self.name}'")
        self._remote = RemoteActionServer(endpoints, tasks, self.observers)
        self._server: GoalServer | None = None

    def send_goal(
        self,
        goal: G,
        *,
        goal_id: bytes | uuid.UUID | None = None,
        feedback_callback: Callable[[F], object] | None = None,
    ) -> SendGoal[G, R, F]:
        """Send a goal: ``await`` it for the result, or enter it for a handle.

        A server in another process is waited for if the session was opened a moment ago; see
        `turtleact.transports.open_zenoh`.

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
            TurtleactError: if the client is closed, or used in another event loop, or if what this
                gives is awaited or entered twice.
        """
        if feedback_callback is not None and _is_coroutine_function(feedback_callback):
            problem = "must be a plain function: it is called in the server's turn, not awaited"
            raise InvalidOption("feedback_callback", problem)
        named = None if goal_id is None else goal_id_bytes(goal_id)
        on_feedback = cast("OnFeedback | None", feedback_callback)  # gets the action's own class
        order = GoalOrder(goal, self, self._cancel_timeout, named, on_feedback)
        caller = sys._getframe(1)
        return SendGoal(self, order, caller.f_code, caller.f_lasti)

    def attach(self, goal_id: bytes | uuid.UUID) -> Attach[R, F]:
        """Attach to a goal that somebody else has sent: ``await`` or enter it for a handle.

        The goal goes on when the block is left, whatever happens there.

        Args:
            goal_id: 16 bytes or a UUID.

        Raises:
            ServerUnavailable: (when awaited or entered) if nobody serves the action.
            TurtleactError: likewise, if the client is closed, or used in another event loop.
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
        self._home.check()
        return await wait_until_served(self._endpoints.transport, self._find, timeout)

    async def cancel_all(self) -> CancelGoal.Response:
        """Ask the server to cancel every goal of the action."""
        return await (await self._find_server()).cancel(None, 0)

    async def cancel_before(self, stamp: Time) -> CancelGoal.Response:
        """Ask the server to cancel every goal accepted at or before ``stamp``."""
        return await (await self._find_server()).cancel(None, nanoseconds(stamp))

    async def aclose(self) -> None:
        """Leave the graph; the goals it has sent go on, unless their server cancels them."""
        self._home.check()
        self.is_open = False
        if self._server is not None and self._server is not self._remote:
            self._server.client_lost(self)
        self._use(None)
        await self._remote.aclose()
        if self.membership is not None:
            self.membership.close()

    # the server

    async def _find_server(self) -> GoalServer:
        """The server of the action; waited for on a graph that is still being discovered.

        Raises:
            ServerUnavailable: if nobody serves it.
            TurtleactError: if the client is closed, or used in another event loop.
        """
        self._home.check()
        server = self._server
        if server is not None and server.is_open:
            return server
        if self.is_open:
            server = await find_server(self._endpoints.transport, self._find)
        if not self.is_open:  # before this, or meanwhile
            raise TurtleactError(f"the client of action '{self.name}' is closed: open another")
        if server is None:
            problem = self._endpoints.send_goal.why_not_served("_SendGoal")
            raise ServerUnavailable(self.name, problem)
        self._use(server)
        return server

    def _find(self) -> GoalServer | None:
        found = self._endpoints.find_local()
        if isinstance(found, OffersGoals):
            return found.goal_server
        return self._remote if self._remote.is_open else None

    def _use(self, server: GoalServer | None) -> None:
        if server is not self._server:
            self.observers.watch(None if server is self._remote else server)
            self._server = server

    # goals

    async def _run(self, order: GoalOrder) -> R:
        """Send a goal and wait for its result."""
        server = await self._find_server()
        goal = await server.run_goal(order)
        if goal.status is GoalStatus.SUCCEEDED:
            return cast("R", goal.result)
        raise failure(goal)

    async def _enter(self, order: GoalOrder) -> GoalReader:
        """Send a goal and wait for its acceptance."""
        server = await self._find_server()
        return GoalReader(server, await server.send_goal(order), self._home, is_sender=True)

    async def _attach(self, goal_id: bytes) -> GoalReader:
        """Attach to a goal of others."""
        server = await self._find_server()
        goal = await server.attach(goal_id)
        if goal is None:
            raise UnknownGoal(f"'{self.name}' holds no goal {goal_id.hex()}")
        return GoalReader(server, goal, self._home, is_sender=False)


if TYPE_CHECKING:

    class _Calling(Coroutine[Any, Any, R], Generic[R]):
        """What a type checker takes a `SendGoal` for."""

        def __init__(self, *parts: object) -> None: ...

else:

    class _Calling(msgspec.Struct, Generic[R], eq=False):
        """What a `SendGoal` is; no struct can inherit from an abstract base class."""


class SendGoal(_Calling[R], Generic[G, R, F]):
    """A goal about to be sent, once.

    ``await`` sends it and gives the result; cancelling the waiting task cancels the goal, waits for
    its end and goes on. ``async with`` sends it and gives the handle; leaving the block with the
    goal still active cancels it and waits for its end, unless it was detached. As it is also a
    coroutine, ``create_task`` takes it as it is, and ``start_soon`` takes `ActionClient.send_goal`.

    One that is neither awaited nor entered warns of that, as a forgotten coroutine does.
    """

    _client: ActionClient[G, R, F]
    _order: GoalOrder | None
    _code: CodeType
    _offset: int
    _reader: GoalReader | None = None
    _calling: Coroutine[object, object, R] | None = None

    def __await__(self) -> Generator[object, object, R]:
        return self._client._run(self._take_order()).__await__()

    def send(self, value: object) -> object:
        """Go on to the next wait; what an event loop calls."""
        if self._calling is None:
            self._calling = self._client._run(self._take_order())
        return self._calling.send(value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Raise something at the current wait; what an event loop calls."""
        if self._calling is None:
            self.close()
            raise error
        return self._calling.throw(error)

    def close(self) -> None:
        """End it; what an event loop calls."""
        self._order = None
        if self._calling is not None:
            self._calling.close()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        self._reader = await self._client._enter(self._take_order())
        return ClientGoalHandle(self._reader)

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        reader = self._reader
        if reader is None or reader.goal.ended:
            return
        await reader.leave(self._client._cancel_timeout)
        # A cancellation that came in that shielded wait is not lost. An exception that leaves the
        # block goes first.
        if error is None:
            await anyio.lowlevel.checkpoint_if_cancelled()

    def _take_order(self) -> GoalOrder:
        order, self._order = self._order, None
        if order is None:
            raise TurtleactError(
                f"this goal for '{self._client.name}' was sent already: call send_goal again to "
                "send another"
            )
        return order

    def __del__(self) -> None:
        if self._order is not None:
            # The line is worked out here, from the place in the code: most goals are sent.
            lines = (lines for *ends, lines in self._code.co_lines() if self._offset < ends[1])
            warnings.warn_explicit(
                f"the goal for '{self._client.name}' was never sent: await what send_goal gives, "
                "or enter it by async with",
                RuntimeWarning,
                self._code.co_filename,
                next(lines, None) or self._code.co_firstlineno,
            )


Coroutine.register(SendGoal)


class Attach(msgspec.Struct, Generic[R, F], eq=False):
    """A goal about to be attached to: ``await`` or enter it for the handle."""

    _client: ActionClient[Any, R, F]
    _goal_id: bytes

    def __await__(self) -> Generator[object, object, ClientGoalHandle[R, F]]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        return ClientGoalHandle(await self._client._attach(self._goal_id))

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """The goal goes on."""


class _ClientObservers(Observers):
    """The observers of one client.

    Goals in other processes are followed here, and told of from here. Those of a server in this
    process are the server's: its own observers hear of them, one of whom passes on what concerns
    the goals of this client, as long as the client is observed.
    """

    __slots__ = ("_relay", "_theirs")

    def __init__(self, client: ActionClient[Any, Any, Any]) -> None:
        super().__init__(client.name)
        self._relay = _Relay(client, self)
        self._theirs: Observers | None = None

    def add(self, observer: GoalObserver) -> None:
        """Tell ``observer`` of every change from now on."""
        if not self.are_any and self._theirs is not None:
            self._theirs.add(self._relay)
        super().add(observer)

    def remove(self, observer: GoalObserver) -> None:
        """Tell it nothing any more; an unknown observer is ignored."""
        super().remove(observer)
        if not self.are_any and self._theirs is not None:
            self._theirs.remove(self._relay)

    def watch(self, server: object | None) -> None:
        """Pass on what happens to the client's goals at this server in place of another."""
        if self.are_any and self._theirs is not None:
            self._theirs.remove(self._relay)
        theirs = getattr(server, "observers", None)
        self._theirs = theirs if isinstance(theirs, Observers) else None
        if self.are_any and self._theirs is not None:
            self._theirs.add(self._relay)


class _Relay(GoalObserver):
    """Passes on what a server in this process tells of the goals of one client."""

    def __init__(self, client: ActionClient[Any, Any, Any], observers: Observers) -> None:
        self._client = client
        self._observers = observers

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state."""
        if goal.sender is self._client:
            self._observers.goal_changed(goal, before, after)

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Called with each feedback message."""
        if goal.sender is self._client:
            self._observers.feedback_published(goal, feedback)


def _is_coroutine_function(callback: object) -> bool:
    """What `inspect.iscoroutinefunction` says of functions and methods, and faster."""
    code = getattr(callback, "__code__", None)
    return code is not None and bool(code.co_flags & CO_COROUTINE)
