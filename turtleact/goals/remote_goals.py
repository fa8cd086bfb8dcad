"""Follows the goals of one client at a server in another process.

The client updates the `Goal` object of each goal when a message from the server arrives. A goal
takes two requests: the goal request sends the goal, and the result request asks for its result. The
client sends these requests in one of two ways:

- The client sends a turtleact server the goal request and the result request at once, which saves a
  round trip. The server answers the result request when the goal ends. If the result request
  arrives before the server knows the goal, the server replies that the goal is unknown. From then
  on, the client sends a result request to that server only after the reply to the goal request.
- The client sends any other ROS 2 server the result request only after the server has accepted the
  goal, because ROS 2 services may handle requests in any order.

One task follows a goal: it waits for both replies, and for feedback that arrives after the result.

Source: rcl_action ``action_client.c``, ``goal_state_machine.c``, and
``rcl_action_process_result_request``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Final, cast

import anyio
import msgspec

from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    ServiceTimeout,
    TurtleactError,
    UnknownGoal,
)
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.goals.observers import FeedbackLost, Observers
from turtleact.goals.state import Cancelable, Goal, GoalEvent, GoalStatus, status_of
from turtleact.goals.wire import GoalMetadata, State
from turtleact.interfaces import SECOND, Message, nanoseconds, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.summaries import STOPS, loggable, summary
from turtleact.tasks import Tasks, wait_while
from turtleact.transports.base import REQUEST_NOTE, PendingCall, Reply

__all__ = ["RemoteGoal", "RemoteGoals", "goal_lost"]

logger = logging.getLogger("turtleact.client")

MOST_UNREAD: Final = 1 << 16
"""How many feedback messages may be unread before the oldest are dropped."""

LATE_FEEDBACK: Final = 1.0
"""How long to wait for feedback that arrives after the goal's result (s, event loop time)."""

BACK_WITHIN: Final = 0.5
"""How long a client without ``reattach`` waits for a server's return (s, event loop time).

A server that returns within this time was only unreachable for a moment.
"""

ATTEMPTS: Final = 3
"""Without ``reattach``, the client gives up a goal after this many failed result requests."""

SETTLED: Final = 1.0
"""A server counts as returned if a request stays pending for longer than this time.

The time is in seconds of event loop time.
"""

PAUSE: Final = 0.1
"""The pause between two attempts to reattach to a visible server that does not answer (s)."""

CLOSING: Final = 5.0
"""How long a client that is being closed waits for its tasks, which it has cancelled (s)."""

_EXECUTING: Final = GoalStatus.EXECUTING

_ENDS: Final = {GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED}

_END_OF_EXECUTING: Final = {
    GoalStatus.CANCELING: (GoalEvent.CANCEL_GOAL,),
    GoalStatus.SUCCEEDED: (GoalEvent.SUCCEED,),
    GoalStatus.CANCELED: (GoalEvent.CANCEL_GOAL, GoalEvent.CANCELED),
    GoalStatus.ABORTED: (GoalEvent.ABORT,),
}

_STEPS: Final[Mapping[GoalStatus, Mapping[GoalStatus, tuple[GoalEvent, ...]]]] = {
    GoalStatus.ACCEPTED: {
        GoalStatus.EXECUTING: (GoalEvent.EXECUTE,),
        **{to: (GoalEvent.EXECUTE, *events) for to, events in _END_OF_EXECUTING.items()},
    },
    GoalStatus.EXECUTING: _END_OF_EXECUTING,
    GoalStatus.CANCELING: {
        GoalStatus.SUCCEEDED: (GoalEvent.SUCCEED,),
        GoalStatus.CANCELED: (GoalEvent.CANCELED,),
        GoalStatus.ABORTED: (GoalEvent.ABORT,),
    },
}
"""Which events lead from one state to a later one."""


class RemoteGoal(msgspec.Struct, eq=False):
    """What the client knows about a goal at a server in another process.

    Attributes:
        goal: The goal's object in this process.
        is_sender: Whether this client sent the goal.
        is_accepted: Whether the server has accepted the goal.
        is_abandoned: Whether the goal must be canceled as soon as it is accepted.
        is_observed: Whether the observers were told about the goal.
        note: A text that is sent with the goal request; see `REQUEST_NOTE`.
        received: How many feedback messages of the goal have arrived.
        gaps: How many feedback messages, of any goal, did not arrive while the goal was active.
        reattach: How long to wait for the return of a server that has gone (s, event loop time).
        sent: The pending request that sends the goal; None if there is none, or if the task waits
            for its reply.
        asked: The pending request for the goal's result; None if there is none, or if the task
            waits for its reply.
        task: The task that follows the goal.
    """

    goal: Goal
    is_sender: bool = True
    is_accepted: bool = False
    is_abandoned: bool = False
    is_observed: bool = False
    note: str = ""
    received: int = 0
    gaps: int = 0
    reattach: float = 0.0
    sent: PendingCall | None = None
    asked: PendingCall | None = None
    task: Cancelable | None = None


class RemoteGoals:
    """Sends the goals of one client and follows them.

    Args:
        endpoints: The client's endpoints.
        tasks: The functions that start tasks in the client's event loop.
        now: A function that returns the current time (ns since the epoch).
        observers: The objects that are told about each change of this client's goals.

    Attributes:
        by_id: All goals that have not ended, by id.
    """

    def __init__(
        self,
        endpoints: ClientEndpoints,
        tasks: Tasks,
        now: Callable[[], int],
        observers: Observers,
    ) -> None:
        self.by_id: dict[bytes, RemoteGoal] = {}
        self._endpoints = endpoints
        self._tasks = tasks
        self._now = now
        self._observers = observers
        self._is_open = True
        self._running: dict[object, Cancelable] = {}
        self._ended = tasks.signal()

    # called by the client

    def send(self, goal: Goal, reattach: float = 0.0) -> RemoteGoal:
        """Send a goal, and follow it to its end.

        Args:
            goal: The goal.
            reattach: How long to wait for the return of a server that has gone (s, event loop
                time).

        Raises:
            InvalidMessage: if a value of the goal message does not fit its type. In this case,
                nothing is sent.
        """
        if not self._endpoints.is_open:
            self.open()
        remote = RemoteGoal(goal, reattach=reattach, note=REQUEST_NOTE.get())
        self._ask_at_once(remote)
        self.by_id[goal.id] = remote
        self._follow_in_task(remote)
        return remote

    def attach(self, goal: Goal, state: State) -> None:
        """Follow a goal that somebody else sent, starting from its current state."""
        remote = RemoteGoal(goal, is_sender=False, is_accepted=True)
        self.take_state(remote, state)
        self.by_id[goal.id] = remote
        self._follow_in_task(remote)

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel goals, and return its response.

        As in ROS 2, ``goal_id`` and ``stamp`` (ns since the epoch) select the goals.

        Raises:
            ServerUnavailable: if no server answers, or the client is closed.
        """
        self.open()
        named = UUID() if goal_id is None else UUID(goal_id)
        request = CancelGoal.Request(GoalInfo(named, stamp_of(stamp)))
        try:
            reply = await self._endpoints.ask_to_cancel(request)
        except TurtleactError as error:
            raise self._failure(error) from None
        response = cast("CancelGoal.Response", reply.message)
        for info in response.goals_canceling:
            remote = self.by_id.get(bytes(info.goal_id.uuid))
            if remote is not None:
                self._move(remote, GoalStatus.CANCELING)
        return response

    def open(self) -> None:
        """Open the client's endpoints.

        Call this before the first request, or feedback may be lost.
        """
        self._endpoints.open(self.by_id, self._take_feedback, self._count_gap)

    def close(self) -> None:
        """Stop following goals. Every caller that waits for a goal gets `ServerUnavailable`."""
        self._is_open = False
        for task in tuple(self._running.values()):
            task.cancel()
        for remote in tuple(self.by_id.values()):
            if remote.task is None:
                self._lose(remote, self._closed())
                self._let_go(remote)

    async def aclose(self) -> None:
        """Stop following goals, and wait for the tasks to end."""
        self.close()
        await wait_while(lambda: self._running, self._ended, CLOSING)

    # following a goal

    def _ask_at_once(self, remote: RemoteGoal) -> None:
        """Send the goal request and the result request now, if the server allows it.

        The goal's task waits for the replies, and sends what could not be sent here.
        """
        endpoints = self._endpoints
        if not (endpoints.knows_ours() and endpoints.takes_both):
            return
        implied, goal_id = endpoints.implied, UUID(remote.goal.id)
        goal: Any = remote.goal.request
        request = implied.send_goal.Request(goal_id, goal)
        remote.sent = endpoints.send_goal.ask(request, note=remote.note)
        if remote.sent is not None:
            remote.asked = endpoints.get_result.ask(implied.get_result.Request(goal_id))

    def _follow_in_task(self, remote: RemoteGoal) -> None:
        name = f"a goal of {self._endpoints.name}"
        remote.task = self._run(self._follow(remote), name)

    async def _follow(self, remote: RemoteGoal) -> None:
        """Send a goal unless it was sent already, and follow it to its end."""
        goal = remote.goal
        try:
            if not remote.is_accepted:
                await self._send(remote)
            if remote.is_abandoned:
                await self.cancel(goal.id, 0)
            reply = await self._wait_for_result(remote)
            note = GoalMetadata.read(reply.note)
            if remote.is_sender:
                await self._wait_for_feedback(remote, note.feedback)
                if remote.gaps and not reply.note:
                    self._report_gaps(remote)
            self._conclude(remote, reply, note)
        except TurtleactError as error:
            self._lose(remote, self._failure(error, is_accepted=remote.is_accepted))
        except self._tasks.cancelled:  # the client was closed
            self._lose(remote, self._closed())
            raise
        except Exception as error:
            logger.exception("goal %s of %s cannot be followed", goal.hex, self._endpoints.name)
            self._lose(remote, TurtleactError(f"the goal cannot be followed: {summary(error)}"))
        finally:
            self._let_go(remote)

    async def _send(self, remote: RemoteGoal) -> None:
        """Send a goal unless it was sent already, and wait until it is accepted.

        Raises:
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or the server goes away.
        """
        patience: _Patience | None = None  # few goals need it
        while True:
            sent, remote.sent = remote.sent, None
            try:
                if sent is None:
                    goal_id, goal = UUID(remote.goal.id), cast("Any", remote.goal.request)
                    request = self._endpoints.implied.send_goal.Request(goal_id, goal)
                    reply = await self._endpoints.ask_for_goal(request, remote.note)
                else:
                    reply = await sent.reply()
                self._accept(remote, reply)
            except ServerUnavailable as error:
                if not remote.reattach:  # the goal may have been accepted: it must not run twice
                    raise
                patience = patience or _Patience(self._endpoints, remote)
                await patience.wait_for_return(error)
            else:
                return

    async def _wait_for_result(self, remote: RemoteGoal) -> Reply:
        """Wait for the server to report the end of a goal.

        Raises:
            UnknownGoal: if the server does not hold the goal.
            ServerUnavailable: if the server goes away and does not return in time.
        """
        patience: _Patience | None = None  # few goals need it
        while True:
            asked, remote.asked = remote.asked, None
            try:
                if asked is not None:
                    reply = await asked.reply()
                else:
                    question = self._endpoints.implied.get_result.Request(UUID(remote.goal.id))
                    reply = await self._endpoints.get_result.call(question)
            except ServiceTimeout:  # the goal takes longer than the transport's timeout
                continue
            except ServerUnavailable as error:
                patience = patience or _Patience(self._endpoints, remote)
                await patience.wait_for_return(error)
                if remote.is_abandoned:
                    await self.cancel(remote.goal.id, 0)
                continue
            if self._has_ended(reply):
                return reply
            if asked is None:
                name, goal = self._endpoints.name, remote.goal
                if patience is not None:
                    what = f"its server went away, and the new server of '{name}' does not have it"
                    raise UnknownGoal(f"{goal.hex}: {what}")
                raise UnknownGoal(f"'{name}' holds no goal {goal.hex}, or no longer holds it")
            self._endpoints.takes_both = False

    async def _wait_for_feedback(self, remote: RemoteGoal, count: int) -> None:
        """Wait for feedback that was published before the result but has not arrived yet."""
        if remote.received >= count:
            return
        signal = remote.goal.changed
        with anyio.move_on_after(LATE_FEEDBACK):
            while remote.received < count:
                await signal.wait()
        if remote.received < count:
            lost = count - remote.received
            logger.warning("%d feedback messages of goal %s were lost", lost, remote.goal.hex)
            self._report_lost(remote, lost)

    def _report_gaps(self, remote: RemoteGoal) -> None:
        """Report feedback of a server that does not say how much it has published."""
        logger.warning(
            "%d feedback messages of %s were lost while goal %s was active",
            remote.gaps,
            self._endpoints.name,
            remote.goal.hex,
        )
        self._report_lost(remote, remote.gaps)

    def _report_lost(self, remote: RemoteGoal, count: int) -> None:
        self._endpoints.report_lost(count)
        if remote.is_observed:
            self._observers.noted(remote.goal, FeedbackLost(count))

    # messages from the server

    def _count_gap(self, count: int) -> None:
        for remote in self.by_id.values():
            remote.gaps += count

    def _accept(self, remote: RemoteGoal, reply: Reply) -> None:
        """Handle the server's reply to the request that sent a goal.

        Raises:
            GoalRejected: if the server rejected the goal.
            ServerUnavailable: if the server rejected the goal because the server is being closed,
                and ``remote.reattach`` is not 0.
        """
        if not (reply.note and self._endpoints.is_ours):
            self._endpoints.learn(reply)
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

    def _has_ended(self, reply: Reply) -> bool:
        """Return whether a reply has the goal's result.

        A reply without a result means that the server does not know the goal.
        """
        if not (reply.note and self._endpoints.is_ours):
            self._endpoints.learn(reply)
        response: Any = reply.message
        return response.status in _ENDS

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
            try:
                log.on_feedback(feedback)
            except STOPS:
                raise
            except BaseException as error:  # also a stray cancellation
                told = loggable(error)
                problem = "the feedback_callback of a goal of %s failed (goal %s)"
                logger.error(problem, self._endpoints.name, goal.hex, exc_info=told)
        goal.changed.fire()

    def take_state(self, remote: RemoteGoal, state: State) -> None:
        """Record a goal's state from the status topic, unless it is a final state.

        Final states are recorded when the result arrives.
        """
        seconds, rest, number = state
        remote.goal.stamp = seconds * SECOND + rest
        status = status_of(number)
        if not status.is_terminal:
            self._move(remote, status)

    def tell_of_pause(self, goal: Goal, *, is_paused: bool) -> None:
        """Tell the observers that a goal was paused or resumed."""
        remote = self.by_id.get(goal.id)
        if remote is not None and remote.is_observed:
            self._observers.pause_changed(goal, is_paused)
        goal.changed.fire()

    # states

    def _move(self, remote: RemoteGoal, status: GoalStatus) -> None:
        """Move a goal forward to a state, through all states in between.

        If the goal is already past that state, do nothing.
        """
        # The status topic, a reply to a cancel and the result may arrive in any order, and some
        # states may never be reported. Missing states are filled in, and old news is ignored.
        for event in _STEPS.get(remote.goal.status, {}).get(status, ()):
            self._apply(remote, event)

    def _apply(self, remote: RemoteGoal, event: GoalEvent) -> None:
        goal, before = remote.goal, remote.goal.status
        goal.apply(event)
        if self._observers.are_any:
            self._show(remote)
            if remote.is_observed:
                self._observers.goal_changed(goal, before, goal.status)

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
        if not goal.ended:
            goal.error, goal.status, goal.ended = error, GoalStatus.UNKNOWN, self._now()
            if remote.is_observed:
                self._observers.goal_changed(goal, before, GoalStatus.UNKNOWN)
            goal.changed.fire()

    def _let_go(self, remote: RemoteGoal) -> None:
        if remote.sent is not None:
            remote.sent.drop()
            remote.sent = None
        if remote.asked is not None:
            remote.asked.drop()
            remote.asked = None
        remote.goal.parent = None
        self.by_id.pop(remote.goal.id, None)

    def _failure(self, error: TurtleactError, *, is_accepted: bool = False) -> TurtleactError:
        """Turn the error of a failed request into an error that names the action.

        An error for an accepted goal never says that the server may have dropped the request.
        """
        if not self._is_open:
            return self._closed()
        if isinstance(error, ServerUnavailable):
            name = self._endpoints.name
            if is_accepted:
                return goal_lost(name, error)
            return ServerUnavailable(name, error.problem, otherwise=error.otherwise)
        return error

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self._endpoints.name, "the client was closed")

    # tasks

    def _run(self, running: Coroutine[object, object, None], name: str) -> Cancelable:
        """Run a coroutine in a task. Closing the client cancels the task and waits for it."""
        key = object()

        async def run() -> None:
            try:
                await running
            finally:
                del self._running[key]
                self._ended.fire()

        task = self._running[key] = self._tasks.spawn(run(), name)
        return task


def goal_lost(action: str, error: ServerUnavailable) -> ServerUnavailable:
    """Turn the error of a result request into the error for an accepted goal.

    The server has accepted the goal. If no server answers the result request, the server must have
    gone away after it accepted the goal.
    """
    problem = error.problem.removesuffix(error.when).rstrip()
    has_gone = problem == "no server answers"
    when = "before the goal ended" if error.when or has_gone else ""
    return ServerUnavailable(action, "the server went away" if has_gone else problem, when=when)


class _Patience:
    """Decides whether to send a request again after its server has gone away.

    Without ``reattach``, the client waits at most `BACK_WITHIN` seconds in all for the server's
    return, because the server may have been unreachable only for a moment. The client gives up
    after `ATTEMPTS` failed requests.

    With ``reattach``, the client waits at most ``reattach`` seconds each time that the server goes
    away. The server counts as returned when feedback arrives, or when a request has been pending
    for `SETTLED` seconds without an error. The time limit of ``reattach`` starts again only after
    the server has returned.

    Args:
        endpoints: The client's endpoints.
        remote: The goal.
    """

    def __init__(self, endpoints: ClientEndpoints, remote: RemoteGoal) -> None:
        self._endpoints = endpoints
        self._remote = remote
        self._received = 0
        self._lost: list[ServerUnavailable] = []
        self._asked = anyio.current_time()
        self._until = 0.0

    async def wait_for_return(self, error: ServerUnavailable) -> None:
        """Wait until the client can send the request again.

        Raises:
            ServerUnavailable: if the server does not return in time. The method raises the error of
                the first request that failed after the server went away.
        """
        now, lost, reattach = anyio.current_time(), self._lost, self._remote.reattach
        if reattach and self._was_back(now):
            lost.clear()
        self._received = self._remote.received
        if not lost:
            self._until = now + (reattach or BACK_WITHIN)
        lost.append(error)
        is_last = now >= self._until if reattach else len(lost) == ATTEMPTS
        with anyio.move_on_after(self._until - now):
            if reattach and len(lost) > 1:
                await anyio.sleep(PAUSE)
            await self._endpoints.wait_until_served()
        if is_last or not self._endpoints.send_goal.is_served:
            raise lost[0] from None
        self._asked = anyio.current_time()

    def _was_back(self, now: float) -> bool:
        """Return whether the server had returned before the request failed at ``now``."""
        return now - self._asked > SETTLED or self._remote.received > self._received
