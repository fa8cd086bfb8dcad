"""What makes up an action on the wire: three services and two topics, open to any node.

A client in the same process needs none of them. They are here for all others: whoever sends
``SendGoal`` requests by hand, cancels the goals of others, asks for results, or listens to feedback
and status. Nothing is made or published before somebody asks or listens.

========================  ==================================  ==================================
``…/_action/send_goal``   ``pkg/action/Name_SendGoal``        takes a goal under an id
``…/_action/cancel_goal`` ``action_msgs/srv/CancelGoal``      cancels by id and stamp
``…/_action/get_result``  ``pkg/action/Name_GetResult``       waits for the end, and answers
``…/_action/feedback``    ``pkg/action/Name_FeedbackMessage`` the feedback of all goals
``…/_action/status``      ``action_msgs/msg/GoalStatusArray`` all goals held, at each change
========================  ==================================  ==================================

Source: rcl_action ``action_server.c``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, cast

from turtleact.errors import GoalRejected
from turtleact.goal import CancelCode, Goal, GoalStatus
from turtleact.goal_note import GoalNote
from turtleact.interfaces import (
    Action,
    Implied,
    Message,
    WireFormat,
    implied,
    nanoseconds,
    stamp_of,
)
from turtleact.interfaces.standard import CancelGoal, GoalStatusArray
from turtleact.names import ActionNames
from turtleact.server.action_server import SHUTDOWN, ActionServer
from turtleact.server.feedback import FeedbackSource
from turtleact.server.lazy_service import LazyService
from turtleact.server.status import StatusSource
from turtleact.summaries import STOPPED
from turtleact.tasks import GRACE, Tasks, wait_while
from turtleact.transports.base import STATUS_QOS, MakeEndpoint, Publication, Reply, Transport

__all__ = ["ActionEndpoints"]

logger = logging.getLogger("turtleact.server")

NAMELESS = "zeros name no goal: nobody could ask for it"
"""Why a goal of the id zero is rejected."""

OURS = GoalNote().write()
"""What stands beside an answer with nothing to add: only that the server is one of turtleact's."""

LATE_REQUEST = 0.5
"""A client elsewhere whose goal ends with its server may take so long to ask for the end (s)."""


class ActionEndpoints:
    """The endpoints of one action server; open as soon as made.

    Args:
        server: The server.
        names: Their names.
        transport: Where they are opened.
        endpoint: Describes them.
        tasks: Runs what answers requests.
    """

    def __init__(
        self,
        server: ActionServer[Any, Any, Any],
        names: ActionNames,
        transport: Transport,
        endpoint: MakeEndpoint,
        tasks: Tasks,
    ) -> None:
        self._server = server
        self._names = names
        self._transport = transport
        self._tasks = tasks
        self._expects_readers = False
        self._taken_up: list[bytes] = []
        self._taken = tasks.signal()
        self._send_goal = LazyService(
            server,
            names.send_goal,
            lambda: self._implied.send_goal,
            self._take,
            tasks,
            now=self._take_now,
        )
        self._cancel_goal = LazyService(
            server, names.cancel_goal, lambda: CancelGoal, self._cancel, tasks
        )
        self._get_result = LazyService(
            server,
            names.get_result,
            lambda: self._implied.get_result,
            self._wait,
            tasks,
            now=self._wait_now,
        )
        action = server.action_type.type_name
        if transport.local(names.send_goal, f"{action}_SendGoal") is not None:
            logger.warning("%s is served already; clients go to the first server", names.name)
        self._opened = [
            transport.serve(
                endpoint("service", each.name, type_name), WireFormat(each.find_type), handler
            )
            for each, type_name, handler in (
                (self._cancel_goal, CancelGoal.type_name, self._cancel_goal),
                (self._get_result, f"{action}_GetResult", self._get_result),
                # last, as who sees it takes the others to be there
                (self._send_goal, f"{action}_SendGoal", server),
            )
        ]
        self._feedback = FeedbackSource(server)
        self._publications = self._advertise(transport, endpoint)

    @property
    def is_asked(self) -> bool:
        """Whether a request waits for its answer."""
        return any(each.waiting for each in (self._send_goal, self._cancel_goal, self._get_result))

    def close(self) -> None:
        """Take no more goals; those that there are can be canceled and waited for."""
        self._opened[-1].close()

    def read_last(self, goal: Goal) -> None:
        """Make a message of a goal's newest feedback, if it was kept as it was sent."""
        self._feedback.read_last(goal)

    async def send_goal(self, request: object) -> object:
        """Answer a ``SendGoal`` request."""
        return await self._send_goal.answer(request)

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a ``SendGoal`` request that came over a wire."""
        self._expect_readers()
        return await self._send_goal.reply(request, caller)

    def reply_now(self, request: object, caller: bytes) -> Reply | None:
        """The same if it takes no waiting."""
        self._expect_readers()
        return self._send_goal.reply_now(request, caller)

    def _expect_readers(self) -> None:
        """Publish feedback from now on: who sends goals reads it, known yet or not."""
        if not self._expects_readers:
            self._expects_readers = True
            self._feedback.publication.expect_readers()

    async def aclose(self) -> None:
        """Answer all who still wait; with results, as the goals have ended."""
        answered = self._get_result.answered
        await wait_while(self._is_expected, answered, LATE_REQUEST)
        await wait_while(lambda: self._get_result.waiting, answered, GRACE)
        for opened in self._opened:
            opened.close()
        for service in (self._send_goal, self._cancel_goal, self._get_result):
            await service.aclose()
        for publication in self._publications:
            publication.close()

    def _is_expected(self) -> bool:
        """Whether a client elsewhere is about to ask how a goal has ended."""
        return any(map(_may_be_asked_for, self._server.held()))

    def _advertise(self, transport: Transport, endpoint: MakeEndpoint) -> list[Publication]:
        """Open the topics."""
        server, names = self._server, self._names
        feedback, status = self._feedback, StatusSource(server)
        described = endpoint(
            "publisher", names.feedback, f"{server.action_type.type_name}_FeedbackMessage"
        )
        feedback.publication = transport.advertise(described, feedback.format, feedback)
        server.execution.outlet = feedback.publication
        described = endpoint("publisher", names.status, GoalStatusArray.type_name, STATUS_QOS)
        format = WireFormat(GoalStatusArray)
        status.publication = transport.advertise(described, format, status)
        return [feedback.publication, status.publication]

    @cached_property
    def _implied(self) -> Implied:
        return implied(cast("type[Action]", self._server.action_type))

    # the services

    def _take_now(self, request: Any, caller: bytes) -> Reply | None:  # noqa: ANN401  # see below
        try:
            goal_id = _named(request)
            goal = self._server.begin(request.goal, goal_id, None, caller, is_streamed=False)
        except GoalRejected as rejected:
            return self._decided(rejected)
        return None if goal is None else self._decided(goal)

    async def _take(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401
        try:
            goal_id = _named(request)
            with self._taking_up(goal_id):
                goal = await self._server.take(
                    request.goal, goal_id, None, caller, is_streamed=False
                )
        except GoalRejected as rejected:
            return self._decided(rejected)
        return self._decided(goal)

    def _decided(self, outcome: Goal | GoalRejected) -> Reply:
        response = self._implied.send_goal.Response
        if isinstance(outcome, GoalRejected):
            return Reply(response(accepted=False), GoalNote(outcome.reason).write())
        return Reply(response(accepted=True, stamp=stamp_of(outcome.stamp)), OURS)

    @contextmanager
    def _taking_up(self, goal_id: bytes) -> Iterator[None]:
        """A block in which a goal is thought about: who asks for its result meanwhile waits."""
        self._taken_up.append(goal_id)  # a list: a second goal of the same id may come
        try:
            yield
        finally:
            self._taken_up.remove(goal_id)
            self._taken.fire()

    async def _cancel(self, request: Any, _caller: bytes) -> Reply:  # noqa: ANN401
        goal_id, stamp = request.goal_info.goal_id.uuid, nanoseconds(request.goal_info.stamp)
        servers = (self._server, *self._siblings())
        return Reply(_joined([await each.cancel(goal_id, stamp) for each in servers]))

    def _siblings(self) -> list[ActionServer[Any, Any, Any]]:
        """The servers of other actions of the same name in this process: they share a service."""
        handlers = self._transport.all_local(self._names.cancel_goal, CancelGoal.type_name)
        lazy = [each for each in handlers if isinstance(each, LazyService)]
        return [each.server for each in lazy if each is not self._cancel_goal]

    def _wait_now(self, request: Any, _caller: bytes) -> Reply | None:  # noqa: ANN401
        goal_id = request.goal_id.uuid
        goal = self._server.find(goal_id)
        if goal is None and goal_id not in self._taken_up:
            return Reply(self._implied.get_result.Response(status=GoalStatus.UNKNOWN), OURS)
        if goal is None or not goal.ended:
            return None
        goal.is_asked_for = True
        return self._end(goal)

    async def _wait(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401
        while (goal := self._server.find(request.goal_id.uuid)) is None:
            reply = self._wait_now(request, caller)
            if reply is not None:
                return reply
            await self._taken.wait()
        goal.is_asked_for = True
        await self._server.wait_for_end(goal)
        return self._end(goal)

    def _end(self, goal: Goal) -> Reply:
        response = self._implied.get_result.Response
        message = response(status=int(goal.status), result=cast("Message", goal.result))
        if goal.reason or goal.published:
            return Reply(message, GoalNote(goal.reason, goal.published).write())
        return Reply(message, OURS)


def _joined(answers: list[CancelGoal.Response]) -> CancelGoal.Response:
    """The answer of several servers that share a cancel service: none but one knows a goal."""
    codes = [each.return_code for each in answers]
    known = [code for code in codes if code != CancelCode.UNKNOWN_GOAL_ID]
    return CancelGoal.Response(
        return_code=min(known, default=CancelCode.UNKNOWN_GOAL_ID),  # NONE is the least
        goals_canceling=[goal for each in answers for goal in each.goals_canceling],
    )


def _named(request: Any) -> bytes:  # noqa: ANN401  # of the action's own class
    """The id that a goal is sent under; raises `GoalRejected` if it is none."""
    goal_id: bytes = request.goal_id.uuid
    if not any(goal_id):
        raise GoalRejected(NAMELESS)
    return goal_id


def _may_be_asked_for(goal: Goal) -> bool:
    """Whether a client elsewhere is about to ask for the end that came with the server's own."""
    is_sent_from_elsewhere = isinstance(goal.sender, bytes) and bool(goal.sender)
    is_ended_late = goal.reason in (SHUTDOWN, STOPPED)
    return is_sent_from_elsewhere and is_ended_late and not goal.is_asked_for
