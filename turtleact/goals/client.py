"""Action clients: send goals, attach to other clients' goals, and cancel goals.

`turtleact.goals.client_handle` defines the client's handle of a goal. A client calls a server in
the same process directly, and sends messages to a server in another process. The client uses both
kinds of server through the interface `turtleact.goals.server.GoalServer`.

Source: rclpy ``action/client.py`` for names and behaviour.
"""

from __future__ import annotations

import logging
import sys
import uuid
import warnings
from collections.abc import Awaitable, Callable, Coroutine, Generator
from contextvars import copy_context
from functools import partial
from inspect import iscoroutinefunction
from types import FrameType, TracebackType
from typing import Any, Final, Generic, NoReturn, TypeAlias, TypeVar

import anyio
import anyio.lowlevel
import msgspec

from turtleact.errors import STOPS, InvalidOption, ServerUnavailable, TurtleactError, UnknownGoal
from turtleact.goals.body import ActionType
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.client_handle import (
    Accepted,
    ClientGoalHandle,
    Event,
    FeedbackReceived,
    HandleServices,
    Outcome,
    ResultReceived,
    StatusChanged,
    leave_goal,
)
from turtleact.goals.observers import Detached, GoalObserver, News, Observers
from turtleact.goals.remote import RemoteActionServer
from turtleact.goals.running import BodyTask
from turtleact.goals.server import GoalServer, goal_id_bytes, new_goal_id
from turtleact.goals.state import CURRENT_GOAL, Goal, GoalRequest, GoalStatus, OnFeedback, failure
from turtleact.interfaces import Message, nanoseconds
from turtleact.interfaces.definition import nearest
from turtleact.interfaces.standard import CancelGoal, Time
from turtleact.tasks import GRACE, Background, LoopGuard, Tasks
from turtleact.tasks.clock import check_timeout
from turtleact.transports import MemoryTransport
from turtleact.transports.base import Owner, find_server, wait_until_served
from turtleact.transports.graph import graph_of

__all__ = [
    "Accepted",
    "ActionClient",
    "Attach",
    "ClientGoalHandle",
    "Event",
    "FeedbackReceived",
    "Outcome",
    "ResultReceived",
    "SendGoal",
    "StatusChanged",
]

logger = logging.getLogger("turtleact.client")

SILENCE: Final = 5.0
"""How long a client waits for a server before it logs one warning (s, event loop time)."""

TOGETHER: Final = 0.2
"""How long a client that knows only servers with other definitions waits for others (s)."""

NO_SERVER: Final = "no server answers"

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)
T = TypeVar("T")

_Sending: TypeAlias = Coroutine[object, object, T]


class ActionClient(Generic[G, R, F]):
    """Sends goals to one action. Create a client with `turtleact.Node.action_client`.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action, a subclass of `turtleact.Action`.
        is_open: Whether the client can send goals.
        observers: The observers of this client's goals, which get each change of state and each
            feedback message.
        find_difference: Names the first field that the servers define differently; empty if they do
            not.
    """

    find_difference: Callable[[], Awaitable[str]]

    def __init__(
        self,
        endpoints: ClientEndpoints,
        tasks: Tasks,
        home: LoopGuard,
        owner: Owner,
        cancel_timeout: float,
    ) -> None:
        self.name = endpoints.name
        self.action_type: ActionType[G, R, F] = endpoints.action_type
        self.is_open = True
        self.observers = _ClientObservers(self)
        self._endpoints = endpoints
        self._membership = owner.add(self, endpoints.close)
        self._cancel_timeout = cancel_timeout
        self._home = home.of(f"the client of action '{self.name}'")
        self._tasks = tasks
        self._services = HandleServices(self._home, tasks, self._cancel_soon)
        self._remote = RemoteActionServer(endpoints, tasks, self.observers)
        self._server: GoalServer | None = None
        self._canceling: dict[bytes, Background] = {}

    def send_goal(
        self,
        goal: G,
        *,
        goal_id: bytes | uuid.UUID | None = None,
        feedback_callback: Callable[[F], object] | None = None,
        reattach: float = 0.0,
    ) -> SendGoal[G, R, F]:
        """Send a goal: ``await`` it for the result, or use ``async with`` for a handle.

        If the Zenoh session has only just been opened, the client waits for the discovery of
        servers in other processes before it sends the goal; see `turtleact.transports.open_zenoh`.

        Args:
            goal: The goal message.
            goal_id: The id of the goal, 16 bytes or a UUID. By default, the goal gets a new id.
            feedback_callback: A plain function that is called with each feedback message. A server
                in this process calls the function while it publishes the message. If the function
                raises an exception, the exception is logged, and the goal goes on.
            reattach: How long to wait for a server (s, event loop time). If the server goes away,
                the client waits this long for the server to return, and attaches to the goal again.
                If nobody serves the action yet, the client waits this long for a server. Use this
                with servers that have a journal, because they still have the goal after a restart.
                If the server is in this process, ``await`` attaches to the goal again, but a handle
                from ``async with`` raises ServerUnavailable.

        Raises:
            InvalidOption: if the ``feedback_callback`` is a coroutine function, or ``reattach`` is
                not a number.
            InvalidGoal: (when awaited or entered) if a value of the goal does not fit its type. The
                goal is not sent.
            ServerUnavailable: (when awaited or entered) if nobody serves the action.
            GoalRejected: (when awaited or entered) if the server rejects the goal.
            GoalAborted, GoalCanceled: (when awaited) if the goal ends as ABORTED or CANCELED.
            TurtleactError: (when awaited or entered) if the client is closed or belongs to another
                event loop, or if the returned object was awaited or entered before.
        """
        if feedback_callback is not None and iscoroutinefunction(feedback_callback):
            problem = "must be a plain function: it is called, not awaited, for each message"
            raise InvalidOption("feedback_callback", problem)
        named = None if goal_id is None else goal_id_bytes(goal_id)
        on_feedback: Any = feedback_callback  # called with the action's class
        if reattach != 0.0:  # a goal in this process is so quick that a check would be noticed
            check_timeout(reattach, "reattach", may_be_none=False)
            if named is None:  # reattaching finds the goal by its id
                named = new_goal_id()
        request = GoalRequest(goal, self, named, on_feedback, reattach)
        return SendGoal(self, request, sys._getframe(1))

    def attach(self, goal_id: bytes | uuid.UUID) -> Attach[R, F]:
        """Attach to a goal that somebody else sent: ``await`` this or use ``async with``.

        Both ``await`` and ``async with`` give you a handle. Leaving the block of ``async with``
        never cancels the goal.

        Args:
            goal_id: The id of the goal, 16 bytes or a UUID.

        Raises:
            ServerUnavailable: (when awaited or entered) if nobody serves the action.
            TurtleactError: (when awaited or entered) if the client is closed or belongs to another
                event loop.
            UnknownGoal: (when awaited or entered) if the server does not know a goal with this id,
                or no longer knows it.
        """
        return Attach(self, goal_id_bytes(goal_id))

    async def wait_for_server(self, timeout: float | None = None) -> bool:
        """Wait until a server exists for the action. Cancelling: safe.

        Args:
            timeout: How long to wait (s, by the graph's clock); None for no limit.

        Returns:
            Whether the action has a server.

        Raises:
            InvalidOption: if ``timeout`` is not a number.
        """
        self._home.check()
        if timeout is None:
            if await self._wait_to_find(SILENCE):
                return True
            logger.warning("still waiting for a server of action '%s'; %s", self.name, self._hint())
        return await wait_until_served(self._endpoints.transport, self._find, timeout)

    async def cancel_all(self) -> CancelGoal.Response:
        """Ask the server to cancel every goal of the action."""
        return await (await self._find_server()).cancel(None, 0)

    async def cancel_before(self, stamp: Time) -> CancelGoal.Response:
        """Ask the server to cancel every goal accepted at or before ``stamp``."""
        return await (await self._find_server()).cancel(None, nanoseconds(stamp))

    async def aclose(self) -> None:
        """Remove the client from the graph.

        The client's goals go on, unless the server has the option ``on_client_lost="cancel"``.
        """
        self._home.check()
        self.is_open = False
        self.observers.closed()
        if self._server is not None and self._server is not self._remote:
            self._server.client_lost(self)
        self._use(None)
        for each in list(self._canceling.values()):
            await each.aclose(GRACE)
        await self._remote.aclose()
        self._membership.close()

    # the server

    def _known_server(self) -> GoalServer | None:
        """Return the server that the client used last.

        Return None if the client has used no server yet, or if that server is closed.

        Raises:
            TurtleactError: if the client is used in another event loop.
        """
        self._home.check()
        server = self._server
        return server if server is not None and server.is_open else None

    async def _find_server(self, patience: float = 0.0) -> GoalServer:
        """Return the action's server. If the graph is new, wait for discovery first.

        If discovery finds no server, wait up to ``patience`` more seconds (event loop time).

        Raises:
            ServerUnavailable: if nobody serves the action.
            TurtleactError: if the client is closed, or is used in another event loop.
        """
        server = self._known_server()
        if server is not None:
            return server
        if self.is_open:
            await find_server(self._endpoints.transport, lambda: self._find() or self._misfit())
            if self._misfit():  # a fitting server may be discovered a moment later
                await self._wait_to_find(TOGETHER)
            elif not self._find():
                await self._endpoints.send_goal.wait_for_route()
            server = self._find()
        if server is None and patience:
            server = await self._wait_to_find(patience)
        if not self.is_open:  # before this, or meanwhile
            raise TurtleactError(f"the client of action '{self.name}' is closed: open another")
        if server is None:
            problem = self._misfit()
            hint = await self.find_difference() if problem else self._hint()
            raise ServerUnavailable(self.name, problem or NO_SERVER, hint=hint)
        self._use(server)
        return server

    async def _wait_to_find(self, patience: float) -> GoalServer | None:
        """Return the action's server as soon as there is one; None after ``patience`` seconds."""
        with anyio.move_on_after(patience):
            await wait_until_served(self._endpoints.transport, self._find, None)
        return self._find()

    def _misfit(self) -> str | None:
        """Return what is wrong with the servers of this name, if all have other definitions."""
        problem = self._endpoints.send_goal.why_not_served("_SendGoal")
        return None if problem == NO_SERVER or self._find() else problem

    def _hint(self) -> str:
        """Return a hint for the user: which actions the graph has, or why this node sees none."""
        transport = self._endpoints.transport
        actions = [action for action in graph_of(transport).actions if action != self.name]
        if near := nearest(self.name, actions):
            return f"did you mean '{near}'?"
        if isinstance(transport, MemoryTransport):
            return (
                "this node sees only its own process, where nobody serves it; to reach others, open"
                " the node with transport= and open_zenoh()"
            )
        if not actions:
            return "this node sees no actions at all: are the server and the router running?"
        return f"the graph has {', '.join(actions[:5])}"

    def _find(self) -> GoalServer | None:
        local = self._endpoints.find_local()
        if local is not None:
            return local
        return self._remote if self._remote.is_open else None

    def _use(self, server: GoalServer | None) -> None:
        if server is not self._server:
            self.observers.watch(None if server is self._remote else server)
            self._server = server

    # goals

    def _send(
        self, request: GoalRequest, send: Callable[[GoalRequest], _Sending[T]]
    ) -> _Sending[T]:
        """Send a goal with ``send``, which is `_run` or `_enter`, and tell observers of calls."""
        is_observed = "enter_call" in self.observers.wanted
        return self._send_observed(request, send) if is_observed else send(request)

    async def _send_observed(
        self, request: GoalRequest, send: Callable[[GoalRequest], _Sending[T]]
    ) -> T:
        observers = self.observers
        observers.enter_call(request)
        try:
            answer = await send(request)
        except BaseException as error:
            observers.leave_call(request, error)
            raise
        observers.leave_call(request, None)
        return answer

    async def _run(self, request: GoalRequest) -> R:
        """Send a goal and wait for its result."""
        server, goal = await self._send_to_server(request)
        await self._wait(server, goal, goal.wait_for_end)
        while request.reattach and isinstance(goal.error, ServerUnavailable):
            server, goal = await self._reattach(request, goal.error)
            await self._wait(server, goal, goal.wait_for_end)
        if goal.status is GoalStatus.SUCCEEDED:
            return goal.result  # type: ignore[return-value]  # the server checked it
        raise failure(goal)

    async def _send_to_server(self, request: GoalRequest) -> tuple[GoalServer, Goal]:
        """Send a goal, and return it with its server. The goal may not be accepted yet."""
        server = self._known_server() or await self._find_server(request.reattach)
        if request.on_feedback is not None:
            request.goal_id = request.goal_id or new_goal_id()
            request.on_feedback = self._guard(request.on_feedback, request.goal_id)
        goal = await server.send(request)
        parent = CURRENT_GOAL.get()
        if parent is not None and isinstance(parent.body, BodyTask):
            parent.body.add_child(goal, server)
        return server, goal

    def _guard(self, on_feedback: OnFeedback, goal_id: bytes) -> OnFeedback:
        """Let a user's callback run in its sender's context, and log what it raises.

        Otherwise it would run in the context of the body that publishes the feedback, or in that of
        the topic's reader, and would raise there.
        """
        context = copy_context()

        def call(feedback: object) -> None:
            try:
                context.run(on_feedback, feedback)
            except STOPS:
                raise
            except BaseException as error:  # also a stray cancellation: this body was not cancelled
                problem = "the feedback_callback of a goal of %s failed (goal %s)"
                logger.error(problem, self.name, goal_id.hex(), exc_info=error)

        return call

    async def _wait(
        self, server: GoalServer, goal: Goal, wait: Callable[[], Awaitable[None]]
    ) -> None:
        """Wait for a goal with ``wait``. If the wait is cancelled, cancel the goal."""
        try:
            await wait()
        except self._tasks.cancelled:
            await server.abandon(goal, self._cancel_timeout)
            raise

    async def _reattach(
        self, request: GoalRequest, error: ServerUnavailable
    ) -> tuple[GoalServer, Goal]:
        """Wait until a server in this process is back, and attach to the goal again.

        If the server was in another process, raise ``error``, because `RemoteActionServer` has
        already waited.
        """
        if self._server is self._remote:
            raise error
        server = await self._find_server(request.reattach)
        goal = await server.attach(goal_id_bytes(request.goal_id or b""))
        if goal is None:
            raise UnknownGoal(f"the server of '{self.name}' is back, but does not hold the goal")
        goal.sender = goal.sender or request.sender  # so that the client's observers hear of it
        if goal.log.on_feedback is None:
            goal.log.on_feedback = request.on_feedback
        return server, goal

    async def _enter(self, request: GoalRequest) -> ClientGoalHandle[R, F]:
        """Send a goal and wait until it is accepted."""
        server, goal = await self._send_to_server(request)
        handle: ClientGoalHandle[R, F] = ClientGoalHandle(
            server, goal, self._services, is_sender=True
        )  # before the wait, as a body that begins in it may publish
        await self._wait(server, goal, partial(server.wait_for_acceptance, goal))
        return handle

    async def _attach(self, goal_id: bytes) -> ClientGoalHandle[R, F]:
        """Attach to a goal that somebody else sent."""
        server = self._known_server() or await self._find_server()
        goal = await server.attach(goal_id)
        if goal is None:
            raise UnknownGoal(f"'{self.name}' holds no goal {goal_id.hex()}")
        return ClientGoalHandle(server, goal, self._services, is_sender=False)

    def _cancel_soon(self, server: GoalServer, goal: Goal) -> None:
        """Cancel a goal in a task, unless such a task runs already. A failure is logged."""
        if goal.id not in self._canceling:
            name = f"a cancel of goal {goal.hex}"
            answer = server.cancel(goal.id, 0)
            asking = Background(self._take_answer(goal, answer), name, self._tasks)
            self._canceling[goal.id] = asking

    async def _take_answer(self, goal: Goal, answer: Awaitable[object]) -> None:
        try:
            await answer
        except TurtleactError as error:
            logger.warning("goal %s could not be canceled: %s", goal.hex, error)
        finally:
            del self._canceling[goal.id]


class SendGoal(Coroutine[Any, Any, R], Generic[G, R, F]):
    """A goal that is about to be sent. You can send it only once.

    ``await`` sends the goal and returns its result. If the waiting task is cancelled, the client
    cancels the goal. The task ends as cancelled only after the goal has ended, or after the
    client's ``cancel_timeout``.

    ``async with`` sends the goal and gives you a handle. If you leave the block while the goal is
    active, the goal is canceled, and leaving waits for the goal's end. A goal that you have
    detached is not canceled.

    The object is also a coroutine: you can pass it to ``create_task``, or pass
    `ActionClient.send_goal` to ``start_soon``. If you neither await nor enter the object, Python
    warns as it does for a forgotten coroutine.
    """

    def __init__(
        self, client: ActionClient[G, R, F], request: GoalRequest, caller: FrameType
    ) -> None:
        self._client = client
        self._request: GoalRequest | None = request
        self._place = caller.f_code.co_filename, caller.f_lineno
        self._handle: ClientGoalHandle[R, F] | None = None
        self._calling: Coroutine[object, object, R] | None = None

    def __repr__(self) -> str:
        state = "already sent" if self._request is None else "not yet sent"
        return f"<goal for '{self._client.name}', {state}>"

    def __aiter__(self) -> NoReturn:
        self._request = None  # the error below says enough: no warning that it was never sent
        raise TypeError(
            "a goal is sent before its feedback is read: write 'async with client.send_goal(...) "
            "as goal', and in that block 'async for feedback in goal'"
        )

    def __await__(self) -> Generator[object, object, R]:
        return self._start().__await__()

    def send(self, value: object) -> object:
        """Continue the coroutine until its next suspension. Only event loops need this method."""
        if self._calling is None:
            self._calling = self._start()
        return self._calling.send(value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Raise an exception in the suspended coroutine. Only event loops need this method."""
        if self._calling is None:
            self.close()
            raise error
        return self._calling.throw(error)

    def close(self) -> None:
        """Close the coroutine. Only event loops need this method."""
        self._request = None
        if self._calling is not None:
            self._calling.close()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        client = self._client
        self._handle = await client._send(self._take_request(), client._enter)
        return self._handle

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._handle is None or self._handle.done:
            return
        detached = await leave_goal(self._handle, self._client._cancel_timeout)
        if detached is not None:
            self._client.observers.noted(detached, Detached())
        # The wait above is shielded, so a cancellation may have arrived meanwhile. Deliver it now,
        # unless the block already ends with an exception.
        if error is None:
            await anyio.lowlevel.checkpoint_if_cancelled()

    def _start(self) -> Coroutine[object, object, R]:
        client = self._client
        return client._send(self._take_request(), client._run)

    def _take_request(self) -> GoalRequest:
        request, self._request = self._request, None
        if request is None:
            raise TurtleactError(
                f"this goal for '{self._client.name}' was already sent: call send_goal again to "
                "send another"
            )
        return request

    def __del__(self) -> None:
        if self._request is not None:
            warnings.warn_explicit(
                f"the goal for '{self._client.name}' was never sent: await the object that "
                "send_goal returns, or use it with 'async with'",
                RuntimeWarning,
                *self._place,
            )


class Attach(msgspec.Struct, Generic[R, F], eq=False):
    """An attempt to attach to a goal. ``await`` it or use ``async with`` to get a handle."""

    _client: ActionClient[Any, R, F]
    _goal_id: bytes

    def __await__(self) -> Generator[object, object, ClientGoalHandle[R, F]]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> ClientGoalHandle[R, F]:
        return await self._client._attach(self._goal_id)

    async def __aexit__(self, *_: object) -> None:
        """Leave the block. The goal continues."""


_OF_GOALS: Final = frozenset(("goal_changed", "feedback_published", "pause_changed"))


class _ClientObservers(Observers):
    """The observers of one client.

    If the server is in another process, the client reports the changes of its goals to these
    observers. If the server is in the same process, the server reports the changes only to its own
    observers. The client then adds a relay to the server's observers, if any observer of the client
    wants reports about goals. The relay passes on the reports about this client's goals.
    """

    __slots__ = ("_relay", "_relayed", "_theirs")

    def __init__(self, client: ActionClient[Any, Any, Any]) -> None:
        super().__init__(client.name)
        self._relay = _Relay(client, self)
        self._theirs: Observers | None = None
        self._relayed: Observers | None = None

    def add(self, observer: GoalObserver) -> None:
        super().add(observer)
        self._set_relay()

    def remove(self, observer: GoalObserver) -> None:
        super().remove(observer)
        self._set_relay()

    def watch(self, server: object | None) -> None:
        """Relay the reports of ``server`` from now on. If ``server`` is None, relay no reports."""
        theirs = getattr(server, "observers", None)
        self._theirs = theirs if isinstance(theirs, Observers) else None
        self._set_relay()

    def _set_relay(self) -> None:
        """Add the relay to the server's observers if it is needed; otherwise remove the relay."""
        wanted = self._theirs if self.wanted & _OF_GOALS else None
        if wanted is not self._relayed:
            if self._relayed is not None:
                self._relayed.remove(self._relay)
            if wanted is not None:
                wanted.add(self._relay)
            self._relayed = wanted


class _Relay(GoalObserver):
    """Passes on the reports of a server in this process about one client's goals."""

    def __init__(self, client: ActionClient[Any, Any, Any], observers: Observers) -> None:
        self._client = client
        self._observers = observers

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        if goal.sender is self._client:
            self._observers.goal_changed(goal, before, after)

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        if goal.sender is self._client:
            self._observers.feedback_published(goal, feedback)

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        if goal.sender is self._client:
            self._observers.pause_changed(goal, is_paused)

    def noted(self, goal: Goal, news: News) -> None:
        if goal.sender is self._client:
            self._observers.noted(goal, news)
