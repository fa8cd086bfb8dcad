"""Represents an action server in another process.

`RemoteActionServer` implements `turtleact.goals.server.GoalServer` by exchanging messages with
the server. The client has a `Goal` object of its own for each goal, which messages keep up to date.
One task follows a goal: it sends the goal request, asks for the result once the server has
accepted the goal, and then waits for feedback that arrives late.

- The client subscribes to feedback before it sends the first request, so no early feedback is lost.
- If a result arrives before all of the goal's feedback, the client waits for the missing feedback.
  The server says how many feedback messages there are (`GoalMetadata`).
- The status topic, a reply to a cancel request and the result may arrive in any order, and some
  states may never be reported. Missing states are filled in, and old news is ignored.
- If a server goes away, the client stops following the server's goals, and every caller that waits
  for one of these goals gets `ServerUnavailable`.

Source: rcl_action ``action_client.c``, ``goal_state_machine.c``, and
``rcl_action_process_result_request``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, cast

import anyio
import msgspec

from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    ServiceTimeout,
    TurtleactError,
    UnknownGoal,
    summary,
)
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.observers import FeedbackLost, Observers
from turtleact.goals.server import new_goal_id
from turtleact.goals.state import (
    CURRENT_GOAL,
    FeedbackLog,
    Goal,
    GoalEvent,
    GoalRequest,
    GoalStatus,
    OnFeedback,
    status_of,
)
from turtleact.goals.wire import GoalMetadata, State
from turtleact.interfaces import SECOND, Message, nanoseconds, snapshotter, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.tasks import Task, Tasks, wait_while
from turtleact.transports.base import REQUEST_NOTE, Reply

__all__ = ["RemoteActionServer"]

logger = logging.getLogger("turtleact.client")

STATUS_WITHIN: Final = 5.0
"""How long to wait for a server's first status, and for the result of an ended goal (s)."""

MOST_UNREAD: Final = 1 << 16
"""How many feedback messages may be unread before the oldest are dropped."""

LATE_FEEDBACK: Final = 1.0
"""How long to wait for feedback that arrives after the goal's result (s, event loop time)."""

BACK_WITHIN: Final = 0.5
"""How long a client without ``reattach`` waits for a server's return (s, event loop time).

A server that returns within this time was only unreachable for a moment.
"""

SETTLED: Final = 1.0
"""A server counts as returned if a request stays pending for longer than this (s, loop time)."""

PAUSE: Final = 0.1
"""The pause between two requests to a visible server that does not answer (s)."""

CLOSING: Final = 5.0
"""How long a client that is being closed waits for its tasks, which it has cancelled (s)."""

_EXECUTING: Final = GoalStatus.EXECUTING

_EVENTS: Final = {
    GoalStatus.EXECUTING: GoalEvent.EXECUTE,
    GoalStatus.CANCELING: GoalEvent.CANCEL_GOAL,
    GoalStatus.SUCCEEDED: GoalEvent.SUCCEED,
    GoalStatus.CANCELED: GoalEvent.CANCELED,
    GoalStatus.ABORTED: GoalEvent.ABORT,
}
"""The event that leads to each state."""


class RemoteGoal(msgspec.Struct, eq=False):
    """What the client knows about a goal at a server in another process.

    Attributes:
        goal: The goal's object in this process.
        is_sender: Whether this client sent the goal.
        is_accepted: Whether the server has accepted the goal.
        is_abandoned: Whether the goal must be canceled as soon as it is accepted.
        is_observed: Whether the observers were told about the goal.
        received: How many feedback messages of the goal have arrived.
        gaps: How many feedback messages, of any goal, did not arrive while the goal was active.
        reattach: How long to wait for the return of a server that has gone (s, event loop time).
        task: The task that follows the goal.
    """

    goal: Goal
    is_sender: bool = True
    is_accepted: bool = False
    is_abandoned: bool = False
    is_observed: bool = False
    received: int = 0
    gaps: int = 0
    reattach: float = 0.0
    task: Task | None = None


class RemoteActionServer:
    """An action server in another process, as its clients see it.

    Args:
        endpoints: The client's endpoints.
        tasks: The functions that start tasks in the client's event loop.
        observers: The objects that are told about each change of the client's goals.
    """

    def __init__(self, endpoints: ClientEndpoints, tasks: Tasks, observers: Observers) -> None:
        goal_type = cast("type[Message]", endpoints.action_type.Goal)
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self._endpoints = endpoints
        self._tasks = tasks
        self._observers = observers
        self._now = endpoints.transport.clock.now
        self._by_id: dict[bytes, RemoteGoal] = {}  # the goals that have not ended
        self._ended = tasks.signal()
        self._is_closed = False
        self.pauses = RemotePauses(self, endpoints)
        self.resumed: Mapping[bytes, object] = {}
        self._status = tasks.signal()
        self._last_told: dict[bytes, State] = {}
        self._held: dict[bytes, State] | None = None  # None until the first status arrives

    @property
    def is_open(self) -> bool:
        """Whether a server in another process serves the action."""
        return self._endpoints.send_goal.is_served

    # sending

    async def send(self, request: GoalRequest) -> Goal:
        """Send a goal, and return it. The server may not have accepted it yet.

        Raises:
            InvalidGoal: if the request does not fit the action. In this case, nothing is sent.
            GoalRejected: if this client still follows a goal with that id.
        """
        message = self._check_goal(request.message)
        goal_id = request.goal_id or new_goal_id()
        if goal_id in self._by_id:
            raise GoalRejected(f"the server still holds a goal with the id {goal_id.hex()}")
        self._open()
        goal = self._new_goal(goal_id, message, request.on_feedback)
        goal.parent, goal.sender = CURRENT_GOAL.get(), request.sender
        self._follow_in_task(RemoteGoal(goal, reattach=request.reattach))
        return goal

    def _new_goal(
        self, goal_id: bytes, message: Message | None, on_feedback: OnFeedback | None = None
    ) -> Goal:
        log = FeedbackLog(on_feedback, is_kept=True)
        return Goal(goal_id, message, self._tasks.signal(), log=log)

    async def wait_for_acceptance(self, goal: Goal) -> None:
        """Wait until the server has accepted a goal. Cancelling: safe.

        Raises:
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or the server goes away.
        """
        self._endpoints.watch_status(self._take_states)
        remote = self._by_id.get(goal.id)
        while remote is not None and not (remote.is_accepted or goal.ended):
            await goal.changed.wait()
        if goal.error is not None and not (remote is not None and remote.is_accepted):
            raise goal.error
        if self._endpoints.is_ours:
            self.pauses.watch()

    async def abandon(self, goal: Goal, timeout: float) -> None:
        """Cancel a goal and wait at most ``timeout`` s for its end, shielded from cancellation.

        Errors are only logged, because the sender's task must end cancelled even if the server dies
        or never answers. If the server has not accepted the goal yet, the task that follows the
        goal cancels the goal upon acceptance. That task continues after the ``timeout``, until the
        client is closed.
        """
        remote = self._by_id.get(goal.id)
        if remote is None:  # it has ended
            return
        remote.is_abandoned = not remote.is_accepted
        with anyio.move_on_after(timeout, shield=True):
            try:
                if remote.is_accepted:
                    await self.cancel(goal.id, 0)
                await goal.wait_for_end()
            except TurtleactError as error:
                remote.is_abandoned = True  # if the server returns
                logger.info("goal %s could not be canceled: %s", goal.hex, error)

    # goals that already exist

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Follow the goal with this id, and return it. Return None if no server holds the goal."""
        self._open()
        self._endpoints.watch_status(self._take_states)
        self.pauses.watch()
        with anyio.move_on_after(STATUS_WITHIN):
            while self._held is None and goal_id not in self._by_id:
                await self._status.wait()
        remote = self._by_id.get(goal_id)
        if remote is not None:
            return remote.goal
        if self._held is None or goal_id not in self._held:
            return None
        state, goal = self._held[goal_id], self._new_goal(goal_id, None)
        remote = RemoteGoal(goal, is_sender=False, is_accepted=True)
        self._take_state(remote, state)
        self._follow_in_task(remote)
        if status_of(state[2]).is_terminal:  # the server may have forgotten it without any notice
            with anyio.move_on_after(STATUS_WITHIN):
                await goal.wait_for_end()
        return None if isinstance(goal.error, UnknownGoal) else goal

    # canceling

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel goals, and return its response.

        As in ROS 2, ``goal_id`` and ``stamp`` (ns since the epoch) select the goals.

        Raises:
            ServerUnavailable: if no server answers, or the client is closed.
        """
        self._open()
        named = UUID() if goal_id is None else UUID(goal_id)
        request = CancelGoal.Request(GoalInfo(named, stamp_of(stamp)))
        try:
            reply = await self._endpoints.ask_to_cancel(request)
        except TurtleactError as error:
            raise self._failure(error) from None
        response = cast("CancelGoal.Response", reply.message)
        for info in response.goals_canceling:
            remote = self._by_id.get(bytes(info.goal_id.uuid))
            if remote is not None:
                self._move(remote, GoalStatus.CANCELING)
        return response

    # closing

    def client_lost(self, sender: object) -> None:  # noqa: ARG002  # always the same client
        """Stop following goals, and close the client's endpoints.

        Every caller that waits for a goal gets `ServerUnavailable`.
        """
        self._is_closed = True
        for remote in self._by_id.values():
            if remote.task is not None:
                remote.task.cancel()
        self._endpoints.close()

    async def aclose(self) -> None:
        """Stop following goals, wait for the tasks to end, and close the client's endpoints."""
        self.client_lost(None)
        await wait_while(lambda: self._by_id, self._ended, CLOSING)

    # following a goal

    def _open(self) -> None:
        """Open the client's endpoints before the first request, or feedback may be lost."""
        self._endpoints.open(self._by_id, self._take_feedback, self._count_gap)

    def _follow_in_task(self, remote: RemoteGoal) -> None:
        self._by_id[remote.goal.id] = remote
        remote.task = self._tasks.spawn(self._follow(remote), f"a goal of {self._endpoints.name}")

    async def _follow(self, remote: RemoteGoal) -> None:
        """Send a goal unless it was sent already, and follow it to its end."""
        goal, patience = remote.goal, _Patience(self._endpoints, remote)
        try:
            if remote.is_sender:
                await self._send(remote, patience)
            if remote.is_abandoned:
                await self.cancel(goal.id, 0)
            reply = await self._wait_for_result(remote, patience)
            note = GoalMetadata.read(reply.note)
            if remote.is_sender:
                await self._wait_for_feedback(remote, note.feedback)
                if remote.gaps and not reply.note:  # the server does not say how many there were
                    what = f"{self._endpoints.name} were lost while goal {goal.hex} was active"
                    self._report_lost(remote, remote.gaps, what)
            self._conclude(remote, reply, note)
        except TurtleactError as error:
            self._lose(remote, self._failure(error, is_accepted=remote.is_accepted))
        except self._tasks.cancelled:  # the client was closed
            self._lose(remote, self._failure(ServerUnavailable(self._endpoints.name)))
            raise
        except Exception as error:
            logger.exception("goal %s of %s cannot be followed", goal.hex, self._endpoints.name)
            self._lose(remote, TurtleactError(f"the goal cannot be followed: {summary(error)}"))
        finally:
            goal.parent = None
            del self._by_id[goal.id]
            self._ended.fire()

    async def _send(self, remote: RemoteGoal, patience: _Patience) -> None:
        """Send a goal, and wait until it is accepted.

        Raises:
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or the server goes away.
        """
        goal, note = cast("Any", remote.goal.request), REQUEST_NOTE.get()
        request = self._endpoints.implied.send_goal.Request(UUID(remote.goal.id), goal)
        while True:
            try:
                self._accept(remote, await self._endpoints.ask_for_goal(request, note))
            except ServerUnavailable as error:
                if not remote.reattach:  # the goal may have been accepted: it must not run twice
                    raise
                await patience.wait_for_return(error)
            else:
                return

    async def _wait_for_result(self, remote: RemoteGoal, patience: _Patience) -> Reply:
        """Wait for the server to report the end of a goal.

        Raises:
            UnknownGoal: if the server does not hold the goal.
            ServerUnavailable: if the server goes away and does not return in time.
        """
        name, goal = self._endpoints.name, remote.goal
        question = self._endpoints.implied.get_result.Request(UUID(goal.id))
        has_gone = False
        while True:
            try:
                reply = await self._endpoints.get_result.call(question)
            except ServiceTimeout:  # the goal takes longer than the transport's timeout
                continue
            except ServerUnavailable as error:
                has_gone = True
                await patience.wait_for_return(error)
                if remote.is_abandoned:
                    await self.cancel(goal.id, 0)
                continue
            response: Any = reply.message
            if status_of(response.status).is_terminal:
                return reply
            if has_gone:
                what = f"its server went away, and the new server of '{name}' does not have it"
                raise UnknownGoal(f"{goal.hex}: {what}")
            raise UnknownGoal(f"'{name}' holds no goal {goal.hex}, or no longer holds it")

    async def _wait_for_feedback(self, remote: RemoteGoal, count: int) -> None:
        """Wait for feedback that was published before the result but has not arrived yet."""
        if remote.received >= count:
            return
        signal = remote.goal.changed
        with anyio.move_on_after(LATE_FEEDBACK):
            while remote.received < count:
                await signal.wait()
        if remote.received < count:
            self._report_lost(remote, count - remote.received, f"goal {remote.goal.hex} were lost")

    def _report_lost(self, remote: RemoteGoal, count: int, what: str) -> None:
        logger.warning("%d feedback messages of %s", count, what)
        self._endpoints.report_lost(count)
        if remote.is_observed:
            self._observers.noted(remote.goal, FeedbackLost(count))

    # messages from the server

    def _take_states(self, told: dict[bytes, State]) -> None:
        # Two servers may share the name and report on their goals in turn.
        self._held, self._last_told = {**self._last_told, **told}, told
        for goal_id, remote in tuple(self._by_id.items()):
            if goal_id in self._held:
                self._take_state(remote, self._held[goal_id])
        self._status.fire()

    def _take_state(self, remote: RemoteGoal, state: State) -> None:
        """Record a goal's state, unless it is a final state: the result comes with that."""
        seconds, rest, number = state
        remote.goal.stamp = seconds * SECOND + rest
        status = status_of(number)
        if not status.is_terminal:
            self._move(remote, status)

    def take_paused(self, changed: frozenset[bytes], paused: frozenset[bytes]) -> None:
        """Tell handles and observers which goals were paused or resumed."""
        for goal_id in changed & self._by_id.keys():
            remote = self._by_id[goal_id]
            if remote.is_observed:
                self._observers.pause_changed(remote.goal, goal_id in paused)
            remote.goal.changed.fire()

    def _count_gap(self, count: int) -> None:
        for remote in self._by_id.values():
            remote.gaps += count

    def _accept(self, remote: RemoteGoal, reply: Reply) -> None:
        """Handle the server's reply to the request that sent a goal.

        Raises:
            GoalRejected: if the server rejected the goal.
            ServerUnavailable: if the server rejected the goal because the server is being closed,
                and ``remote.reattach`` is not 0.
        """
        response: Any = reply.message
        if not response.accepted:
            note = GoalMetadata.read(reply.note)
            if note.is_closing and remote.reattach:
                raise ServerUnavailable(self._endpoints.name, note.reason)
            raise GoalRejected(note.reason)
        goal = remote.goal
        goal.stamp = nanoseconds(response.stamp)
        remote.is_accepted = True
        if self._observers.are_any:
            self._show(remote)
        goal.changed.fire()

    def _take_feedback(self, remote: RemoteGoal, feedback: Message) -> None:
        """Record a feedback message, and call the sender's callback if there is one."""
        goal = remote.goal
        log = goal.log
        if goal.status < _EXECUTING:
            self._move(remote, _EXECUTING)
        remote.received += 1
        log.append(feedback)
        if log.read is not None and log.count - log.read > MOST_UNREAD:
            log.read = log.count - MOST_UNREAD
        if remote.is_observed:
            self._observers.feedback_published(goal, feedback)
        if log.on_feedback is not None:
            log.on_feedback(feedback)
        goal.changed.fire()

    # states

    def _move(self, remote: RemoteGoal, status: GoalStatus) -> None:
        """Move a goal forward to a state, through all states in between.

        If the goal is already past that state, do nothing.
        """
        goal = remote.goal
        for after in _steps(goal.status, status):
            before = goal.status
            goal.apply(_EVENTS[after])
            if self._observers.are_any:
                self._show(remote)
                if remote.is_observed:
                    self._observers.goal_changed(goal, before, after)

    def _show(self, remote: RemoteGoal) -> None:
        """Report a new goal of this client to the observers, unless the goal was reported before.

        Observers must hear that a goal was accepted before they hear anything else about the goal.
        The acceptance and the first feedback may arrive in either order, so both call this method.
        """
        if remote.is_sender and not remote.is_observed:
            remote.is_observed = True
            self._observers.goal_changed(remote.goal, GoalStatus.UNKNOWN, GoalStatus.ACCEPTED)

    def _conclude(self, remote: RemoteGoal, reply: Reply, note: GoalMetadata) -> None:
        """Record the end of a goal as its server reported it."""
        response: Any = reply.message
        goal = remote.goal
        goal.result, goal.reason = response.result, note.reason
        goal.ended = self._now()
        self._move(remote, status_of(response.status))

    def _lose(self, remote: RemoteGoal, error: TurtleactError) -> None:
        """Mark a goal as lost, because ``error`` prevents the client from following it."""
        goal, before = remote.goal, remote.goal.status
        goal.error, goal.status, goal.ended = error, GoalStatus.UNKNOWN, self._now()
        if remote.is_observed:
            self._observers.goal_changed(goal, before, GoalStatus.UNKNOWN)
        goal.changed.fire()

    def _failure(self, error: TurtleactError, *, is_accepted: bool = False) -> TurtleactError:
        """Turn the error of a failed request into an error that names the action.

        An error for an accepted goal never says that the server may have dropped the request.
        """
        name = self._endpoints.name
        if self._is_closed:
            return ServerUnavailable(name, "the client was closed")
        if not isinstance(error, ServerUnavailable):
            return error
        if not is_accepted:
            return ServerUnavailable(name, error.problem, otherwise=error.otherwise)
        problem = error.problem.removesuffix(error.when).rstrip()
        if problem == "no server answers":
            return ServerUnavailable(name, "the server went away", when="before the goal ended")
        return ServerUnavailable(name, problem, when=error.when and "before the goal ended")


class RemotePauses:
    """Pauses and resumes goals in another process.

    Args:
        server: The server in the other process.
        endpoints: The client's endpoints.
    """

    def __init__(self, server: RemoteActionServer, endpoints: ClientEndpoints) -> None:
        self._server = server
        self._endpoints = endpoints
        self._paused: frozenset[bytes] = frozenset()

    def watch(self) -> None:
        """Learn from the server which goals are paused. A second call does nothing."""
        self._endpoints.watch_paused(self._take)

    def is_paused(self, goal: Goal) -> bool:
        """Whether a goal is paused, as far as the client knows."""
        return goal.id in self._paused and not goal.ended

    def hold(self, goal: Goal) -> None:
        """Do nothing, because the goal's body may have started in the other process already."""

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Ask the server to pause a goal, and wait until the goal's body stands still.

        Raises:
            PauseRefused: if the server refuses, or cannot pause goals.
            ServerUnavailable: if the server goes away.
        """
        with anyio.move_on_after(timeout):
            await self._server.wait_for_acceptance(goal)
        await self._endpoints.set_paused(goal, is_paused=True, timeout=timeout)
        self._take(self._paused | {goal.id})

    async def resume(self, goal: Goal) -> None:
        """Ask the server to let a paused goal go on. The errors are those of `pause`."""
        await self._endpoints.set_paused(goal, is_paused=False)
        self._take(self._paused - {goal.id})

    def _take(self, paused: frozenset[bytes]) -> None:
        changed, self._paused = self._paused ^ paused, paused
        self._server.take_paused(changed, paused)


class _Patience:
    """Decides whether to send a request again after a goal's server has gone away.

    The client waits at most ``reattach`` seconds for the server's return, or `BACK_WITHIN` without
    ``reattach``. The server counts as returned when feedback arrives, or when a request has been
    pending for `SETTLED` seconds without an error; from then on, the whole time is available again.

    Args:
        endpoints: The client's endpoints.
        remote: The goal.
    """

    def __init__(self, endpoints: ClientEndpoints, remote: RemoteGoal) -> None:
        self._endpoints = endpoints
        self._remote = remote
        self._received = 0
        self._first: ServerUnavailable | None = None
        self._asked = 0.0
        self._until = 0.0

    async def wait_for_return(self, error: ServerUnavailable) -> None:
        """Wait until the client can send the request again.

        Raises:
            ServerUnavailable: if the server does not return in time. The method raises the error of
                the first request that failed after the server went away.
        """
        now = anyio.current_time()
        if self._first is None or self._was_back(now):
            self._first = error
            self._until = now + (self._remote.reattach or BACK_WITHIN)
            pause = 0.0
        else:
            pause = PAUSE
        self._received = self._remote.received
        with anyio.move_on_after(self._until - now):
            await anyio.sleep(pause)
            await self._endpoints.wait_until_served()
        if now >= self._until or not self._endpoints.send_goal.is_served:
            raise self._first from None
        self._asked = anyio.current_time()

    def _was_back(self, now: float) -> bool:
        """Return whether the server had returned before the request failed at ``now``."""
        return now - self._asked > SETTLED or self._remote.received > self._received


def _steps(before: GoalStatus, after: GoalStatus) -> Iterator[GoalStatus]:
    """Yield the states that a goal enters on its way from one state to a later one."""
    if after <= before or before.is_terminal:
        return
    if before < _EXECUTING < after:
        yield _EXECUTING
    if before < GoalStatus.CANCELING and after is GoalStatus.CANCELED:
        yield GoalStatus.CANCELING
    yield after
