"""The goals of one client that a server in another process holds, each followed to its end.

For each goal there is a `Goal` here, too, which the messages of the server keep up to date. A goal
is two requests: one that sends it, and one that waits for its result. A server of turtleact gets
both at once and answers the second when the goal has ended, which saves half of the way; nothing
waits for the replies then, what they say is noted as they come. If that server does not know the
goal yet when the second request comes, it says so, and from then on gets one after the other. So do
servers of ROS 2, whose services may be answered in any order.

Whatever takes waiting has a task, which the client owns: a server of which nothing is known yet, a
cancel, feedback that comes after its goal's result, a server that went away.

Source: rcl_action ``action_client.c``, ``goal_state_machine.c``, and
``rcl_action_process_result_request``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Final, cast

import anyio

from turtleact.client.client_endpoints import ClientEndpoints
from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    ServiceTimeout,
    TurtleactError,
    UnknownGoal,
)
from turtleact.feedback import FeedbackLog
from turtleact.goal import Cancelable, Goal, GoalEvent, GoalStatus, status_of
from turtleact.goal_wire import GoalNote, State
from turtleact.interfaces import SECOND, Message, nanoseconds, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.observers import Observers
from turtleact.summaries import STOPS, loggable, summary
from turtleact.tasks import Signal, Tasks, wait_while
from turtleact.transports.base import PendingCall, Reply

__all__ = ["RemoteGoal", "RemoteGoals"]

logger = logging.getLogger("turtleact.client")

MOST_UNREAD: Final = 1 << 16
"""A reader that lags further behind loses the oldest feedback messages."""

LATE_FEEDBACK: Final = 1.0
"""How long feedback that comes after its goal's result is waited for (s, event loop time)."""

BACK_WITHIN: Final = 0.5
"""A server that is back after so long was only out of reach (s, event loop time)."""

ATTEMPTS: Final = 3
"""How often the result of a goal is asked for, if its server seems to be back."""

CLOSING: Final = 5.0
"""How long a client that is closed waits for its tasks, all of which can be cancelled (s)."""

_EXECUTING: Final = GoalStatus.EXECUTING

_ENDS: Final = {
    GoalStatus.SUCCEEDED: GoalEvent.SUCCEED,
    GoalStatus.CANCELED: GoalEvent.CANCELED,
    GoalStatus.ABORTED: GoalEvent.ABORT,
}


class RemoteGoal:
    """What a client knows of a goal that a server elsewhere holds.

    Attributes:
        goal: The goal, as it is known here.
        goal_id: Its id.
        log: Its feedback.
        is_sender: Whether it was sent from here.
        is_accepted: Whether the server has taken it.
        is_abandoned: Whether it must be canceled as soon as it is accepted.
        is_awaited: Whether somebody waits for its acceptance.
        is_observed: Whether observers have heard of it.
        received: How many feedback messages have come.
        sent: The request that sends the goal, while it is under way without a task.
        asked: The request for its result, while that is under way without a task.
        task: What follows the goal, if that takes waiting.
    """

    __slots__ = (
        "asked",
        "goal",
        "goal_id",
        "is_abandoned",
        "is_accepted",
        "is_awaited",
        "is_observed",
        "is_sender",
        "log",
        "received",
        "sent",
        "task",
    )

    def __init__(self, goal: Goal, *, is_sender: bool) -> None:
        self.goal = goal
        self.goal_id = cast("bytes", goal.id)
        self.log = goal.feedback = FeedbackLog()
        goal.is_streamed = True
        self.is_sender = is_sender
        self.is_accepted = not is_sender
        self.is_abandoned = False
        self.is_awaited = False
        self.is_observed = False
        self.received = 0
        self.sent: PendingCall | None = None
        self.asked: PendingCall | None = None
        self.task: Cancelable | None = None


class RemoteGoals:
    """Sends the goals of one client and follows them.

    Args:
        endpoints: The client's endpoints.
        tasks: The tasks of the event loop.
        now: The time (ns since the epoch).
        observers: Told of each change of the goals that were sent from here.

    Attributes:
        by_id: All goals that have not ended, by their ids.
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
        self._running: dict[object, Cancelable | None] = {}
        self._ended = tasks.signal()

    # what the client does

    def send(self, goal: Goal) -> RemoteGoal:
        """Send a goal, and follow it.

        Raises:
            InvalidMessage: if a value does not fit its type; nothing was sent.
        """
        if not self._endpoints.is_open:
            self.open()
        remote = RemoteGoal(goal, is_sender=True)
        is_under_way = self._send_both(remote)
        self.by_id[remote.goal_id] = remote
        if not is_under_way:
            self._follow_in_task(remote)
        return remote

    def attach(self, goal: Goal, state: State) -> None:
        """Follow a goal that somebody else has sent, and that is in this state."""
        remote = RemoteGoal(goal, is_sender=False)
        self.take_state(remote, state)
        self.by_id[remote.goal_id] = remote
        self._follow_in_task(remote)

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Ask the server to cancel by id, by stamp (ns), by both, or every goal.

        Raises:
            ServerUnavailable: if nobody answers, or the client was closed.
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

    def cancel_nowait(self, goal: Goal) -> None:
        """Ask the server to cancel a goal, in a task of the client."""

        async def ask() -> None:
            try:
                await self.cancel(goal.id, 0)
            except TurtleactError as error:
                logger.warning("goal %s could not be canceled: %s", goal.hex, error)

        self._run(ask(), f"a cancel of {self._endpoints.name}")

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
        if goal.listener is None:
            goal.listener = self._tasks.signal()
        return goal.listener  # type: ignore[return-value]  # nobody else puts one there

    def open(self) -> None:
        """Open what goals take, before the first request: no feedback comes too early then."""
        self._endpoints.open(self.by_id, self._take_feedback)

    def close(self) -> None:
        """Follow no goal any more; all who wait for one hear that the client was closed."""
        self._is_open = False
        for task in tuple(self._running.values()):
            if task is not None:
                task.cancel()
        for remote in tuple(self.by_id.values()):
            if remote.task is None:
                self._lose(remote, self._closed())
                self._let_go(remote)

    async def aclose(self) -> None:
        """Close, and wait for the end of the tasks."""
        self.close()
        await wait_while(lambda: self._running, self._ended, CLOSING)

    # two requests at once, without a task

    def _send_both(self, remote: RemoteGoal) -> bool:
        """Send both requests, if the server is known to take both at once.

        One may be under way even if this answers False; the task then goes on with it.
        """
        endpoints = self._endpoints
        if not (endpoints.knows_ours() and endpoints.takes_both):
            return False
        implied, goal_id = endpoints.implied, UUID(remote.goal_id)
        request = implied.send_goal.Request(goal_id, cast("Any", remote.goal.request))
        sent = remote.sent = endpoints.send_goal.ask(request)
        if sent is None:
            return False
        asked = remote.asked = endpoints.get_result.ask(implied.get_result.Request(goal_id))
        if asked is None:
            return False
        on_reply = partial(self._on_reply, remote)
        sent.tell(on_reply)
        asked.tell(on_reply)
        return True

    def _on_reply(self, remote: RemoteGoal) -> None:
        """Take up the replies that have come; whatever takes waiting goes on in a task.

        Called for each of the two, in any order; a result is taken up after the acceptance only.
        A request that has failed is left as it is: the task meets the failure again and sees to it.
        """
        if remote.task is not None:
            return
        try:
            sent = remote.sent
            if sent is not None:
                if not sent.is_over:
                    return
                self._accept(remote, sent.take())
                remote.sent = None
            asked = remote.asked
            if asked is None or remote.is_abandoned:
                self._follow_in_task(remote)
                return
            if not asked.is_over:
                return
            reply = asked.take()
            note = GoalNote.read(reply.note)
            is_complete = self._has_ended(reply) and note.feedback <= remote.received
        except Exception:
            is_complete = False
        if is_complete:
            remote.asked = None
            self._conclude(remote, reply, note)
            self._let_go(remote)
        else:
            self._follow_in_task(remote)

    # one after the other, in a task

    def _follow_in_task(self, remote: RemoteGoal) -> None:
        name = f"a goal of {self._endpoints.name}"
        remote.task = self._run(self._follow(remote), name)

    async def _follow(self, remote: RemoteGoal) -> None:
        """Send a goal, unless that is done, and follow it to its end."""
        goal = remote.goal
        try:
            if remote.asked is not None:  # what comes with a reply may say why it is none
                await self._tasks.checkpoint()
            if not remote.is_accepted:
                await self._send(remote)
            if remote.is_abandoned:
                await self.cancel(goal.id, 0)
            reply = await self._wait_for_result(remote)
            note = GoalNote.read(reply.note)
            if remote.is_sender:
                await self._wait_for_feedback(remote, note.feedback)
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
        """Send a goal, unless that is done, and wait for its acceptance.

        Raises:
            GoalRejected: if it is not taken.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """
        sent, remote.sent = remote.sent, None
        if sent is None:
            goal_id, goal = UUID(remote.goal_id), cast("Any", remote.goal.request)
            request = self._endpoints.implied.send_goal.Request(goal_id, goal)
            self._accept(remote, await self._endpoints.ask_for_goal(request))
        else:
            self._accept(remote, await sent.reply())

    async def _wait_for_result(self, remote: RemoteGoal) -> Reply:
        """Wait for the end of a goal, as its server tells it.

        Raises:
            UnknownGoal: if the server does not hold it.
            ServerUnavailable: if the server goes away, and does not come back at once.
        """
        lost = list[ServerUnavailable]()
        while True:
            asked, remote.asked = remote.asked, None
            try:
                if asked is not None:
                    reply = await asked.reply()
                else:
                    question = self._endpoints.implied.get_result.Request(UUID(remote.goal_id))
                    reply = await self._endpoints.get_result.call(question)
            except ServiceTimeout:  # the goal takes longer than the transport waits
                continue
            except ServerUnavailable as error:
                lost.append(error)
                if len(lost) == ATTEMPTS or not await self._is_back():
                    raise lost[0] from None
                continue
            if self._has_ended(reply):
                return reply
            if asked is None:
                name, goal = self._endpoints.name, remote.goal
                raise UnknownGoal(f"'{name}' holds no goal {goal.hex}, or not any more")
            self._endpoints.takes_both = False

    async def _is_back(self) -> bool:
        """Whether the server was out of reach for a moment only."""
        with anyio.move_on_after(BACK_WITHIN):
            await self._endpoints.wait_until_served()
        return self._endpoints.send_goal.is_served

    async def _wait_for_feedback(self, remote: RemoteGoal, count: int) -> None:
        """Wait for the feedback that the result has overtaken."""
        if remote.received >= count:
            return
        signal = self.signal(remote.goal)
        with anyio.move_on_after(LATE_FEEDBACK):
            while remote.received < count:
                await signal.wait()
        if remote.received < count:
            lost = count - remote.received
            logger.warning("%d feedback messages of goal %s were lost", lost, remote.goal.hex)

    # what the server says

    def _accept(self, remote: RemoteGoal, reply: Reply) -> None:
        """Note the answer to a goal that was sent.

        Raises:
            GoalRejected: if it is not taken.
        """
        if not (reply.note and self._endpoints.is_ours):
            self._endpoints.learn(reply)
        response: Any = reply.message
        if not response.accepted:
            raise GoalRejected(GoalNote.read(reply.note).reason)
        goal = remote.goal
        goal.stamp = nanoseconds(response.stamp)
        remote.is_accepted = True
        if self._observers.are_any:
            self._show(remote)
        if remote.is_awaited:
            self.signal(goal).fire()

    def _has_ended(self, reply: Reply) -> bool:
        """Whether a reply to the request for a result is one, and not that the goal is unknown."""
        if not (reply.note and self._endpoints.is_ours):
            self._endpoints.learn(reply)
        return cast("Any", reply.message).status in _ENDS

    def _take_feedback(self, remote: RemoteGoal, feedback: Message) -> None:
        """Note a feedback message, and tell the sender's callback."""
        goal, log = remote.goal, remote.log
        if goal.status < _EXECUTING:
            self._move(remote, _EXECUTING)
        remote.received += 1
        goal.last_feedback = feedback
        log.append(feedback)
        if log.read is not None and log.count - log.read > MOST_UNREAD:
            log.read = log.count - MOST_UNREAD
        if remote.is_observed:
            self._observers.feedback_published(goal, feedback)
        if goal.on_feedback is not None:
            try:
                goal.on_feedback(feedback)
            except STOPS:
                raise
            except BaseException as error:  # a cancellation too: nobody has cancelled it
                told = loggable(error)
                logger.error("the feedback_callback of goal %s failed", goal.hex, exc_info=told)
        if goal.listener is not None:
            goal.listener.fire()

    def take_state(self, remote: RemoteGoal, state: State) -> None:
        """Note what the status topic says of a goal; its end comes with the result."""
        seconds, rest, number = state
        remote.goal.stamp = seconds * SECOND + rest
        status = status_of(number)
        if not status.is_terminal:
            self._move(remote, status)

    # states

    def _move(self, remote: RemoteGoal, status: GoalStatus) -> None:
        """Bring a goal into a state through those that must have come before; never backwards."""
        goal = remote.goal
        if status <= goal.status or goal.status.is_terminal:
            return
        if goal.status is GoalStatus.ACCEPTED:
            self._apply(remote, GoalEvent.EXECUTE)
        if status in (GoalStatus.CANCELING, GoalStatus.CANCELED) and (
            goal.status is not GoalStatus.CANCELING
        ):
            self._apply(remote, GoalEvent.CANCEL_GOAL)
        if status in _ENDS:
            self._apply(remote, _ENDS[status])

    def _apply(self, remote: RemoteGoal, event: GoalEvent) -> None:
        goal, before = remote.goal, remote.goal.status
        goal.apply(event)
        if self._observers.are_any:
            self._show(remote)
            if remote.is_observed:
                self._observers.goal_changed(goal, before, goal.status)

    def _show(self, remote: RemoteGoal) -> None:
        """Tell the observers of a goal that was sent from here, before they hear more of it.

        Feedback may overtake the acceptance, as it goes another way; this is called at either.
        """
        if remote.is_sender and not remote.is_observed:
            remote.is_observed = True
            self._observers.goal_changed(remote.goal, GoalStatus.UNKNOWN, GoalStatus.ACCEPTED)

    def _conclude(self, remote: RemoteGoal, reply: Reply, note: GoalNote) -> None:
        """End a goal as its server has."""
        response, goal = cast("Any", reply.message), remote.goal
        goal.result, goal.reason = response.result, note.reason
        goal.ended = self._now()
        self._move(remote, GoalStatus(response.status))

    def _lose(self, remote: RemoteGoal, error: TurtleactError) -> None:
        """End a goal of which nothing more will be heard."""
        goal, before = remote.goal, remote.goal.status
        if not goal.ended:
            goal.error, goal.status, goal.ended = error, GoalStatus.UNKNOWN, self._now()
            if remote.is_observed:
                self._observers.goal_changed(goal, before, GoalStatus.UNKNOWN)
            if goal.listener is not None:
                goal.listener.fire()

    def _let_go(self, remote: RemoteGoal) -> None:
        for early in (remote.sent, remote.asked):
            if early is not None:
                early.drop()
        remote.sent = remote.asked = None
        self.by_id.pop(remote.goal_id, None)

    def _failure(self, error: TurtleactError, *, is_accepted: bool = False) -> TurtleactError:
        """What the user is told if a request has failed: the action's name, and why.

        A goal that was accepted was not dropped: a server that lives would be asked again.
        """
        if not self._is_open:
            return self._closed()
        if isinstance(error, ServerUnavailable):
            otherwise = "" if is_accepted else error.otherwise
            return ServerUnavailable(self._endpoints.name, error.problem, otherwise=otherwise)
        return error

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self._endpoints.name, "the client was closed")

    # tasks

    def _run(self, running: Coroutine[object, object, None], name: str) -> Cancelable:
        """Run something in a task that is cancelled and waited for when the client is closed."""
        key = object()

        async def run() -> None:
            try:
                await running
            finally:
                del self._running[key]
                self._ended.fire()

        self._running[key] = None
        task = self._tasks.spawn(run(), name)
        if key in self._running:  # its first steps may have been all
            self._running[key] = task
        return task
