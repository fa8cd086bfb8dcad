"""Serves the services and actions that one client offers.

On the graph, the bridge is the server. It sends each request and each goal to the client with an
id, and waits until the client answers or disconnects.

Source: rosbridge_library ``capabilities/advertise_{service,action}.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, Protocol, cast

import anyio

from turtleact.errors import Abort, Cancel, ServiceError, TurtleactError
from turtleact.goals.body import ActionType
from turtleact.goals.state import GoalStatus
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import Message
from turtleact.names import resolve_name
from turtleact.node import Node, ServerGoalHandle
from turtleact.node.services import ServiceType
from turtleact.tasks import current_tasks
from turtleact.transports.base import REQUEST_NOTE
from turtleact.web.message_conversion import json_values, read_message, request
from turtleact.web.name_lookup import action_class, service_class
from turtleact.web.operations import (
    ActionFeedback,
    ActionResult,
    AdvertiseAction,
    AdvertiseService,
    ServiceResponse,
)

__all__ = ["Serving"]

CANCEL_WITHIN: Final = 30.0
"""How long a client may take to end a goal that it was asked to cancel (s)."""

Handle = ServerGoalHandle[Any, Any, Any]


class Server(Protocol):
    """A server of a service or an action on the node."""

    async def aclose(self) -> None:
        """Close the server."""


class Serving:
    """Serves the services and actions that one client offers.

    Args:
        node: The node on which the services and actions are served.
        keep: Called with each frame to send to the client.
    """

    def __init__(self, node: Node, keep: Callable[[str], None]) -> None:
        self._node = node
        self._keep = keep
        self._tasks = current_tasks()
        self._servers: dict[tuple[str, str], Server] = {}
        self._asked: dict[str, _Question] = {}
        self._count = 0

    def __len__(self) -> int:
        return len(self._servers)

    def __contains__(self, place: tuple[str, str]) -> bool:
        """Whether a service or action, given by its kind and name, is served."""
        return place in self._servers

    def serve(self, said: AdvertiseService | AdvertiseAction) -> None:
        """Start to serve a service or an action of the client.

        Raises:
            InvalidName: if the name breaks ROS 2's rules.
            UnknownInterface: if the type is not known.
        """
        if isinstance(said, AdvertiseService):
            service_type = cast("ServiceType[Message, Message]", service_class(said.type))
            handle = partial(self._handle, said, service_type)
            service = self._node.service(service_type, resolve_name(said.service), handle)
            self._servers["service", said.service] = service
            return
        action_type = cast("ActionType[Message, Message, Message]", action_class(said.type))

        async def execute(goal: Message, handle: Handle) -> Message:
            return await self._execute(said, action_type, goal, handle)

        action = self._node.action_server(action_type, resolve_name(said.action), execute)
        self._servers["action", said.action] = action

    def withdraw(self, kind: str, name: str) -> Server:
        """Stop waiting for the client's answers for a service or action, and return its server.

        The caller must close the server. When the server is closed, callers that still wait get an
        error.
        """
        # First the questions are given up, so that closing the server does not wait for answers.
        for question in self._asked.values():
            if question.about == (kind, name):
                question.over.set()
        return self._servers.pop((kind, name))

    def answer(self, said: ServiceResponse | ActionResult) -> bool:
        """Record the client's answer. Return False if it belongs to no request or goal."""
        question = self._asked.get(str(said.id))
        if question is not None:
            question.said = question.said or said  # any later answer is ignored
            question.over.set()
        return question is not None

    async def take_feedback(self, said: ActionFeedback) -> None:
        """Publish the client's feedback, unless the goal has ended.

        Raises:
            TurtleactError: if the feedback does not fit the action.
        """
        question = self._asked.get(str(said.id))
        if question is not None and question.handle is not None:
            feedback = await read_message(question.feedback_type, said.values, root="feedback")
            question.handle.publish_feedback(feedback)

    async def aclose(self) -> None:
        """Close all servers, because the client has gone."""
        # One after the other is quick enough: `withdraw` has given up the questions, so no server
        # waits for an answer of the client that has gone.
        for kind, name in list(self._servers):
            await self.withdraw(kind, name).aclose()

    @contextmanager
    def _asking(self, kind: str, name: str, prefix: str) -> Iterator[_Question]:
        """Wait for the client's answer to one question for the length of a block."""
        self._count += 1
        question = _Question(f"{prefix}:{name}:{self._count}", (kind, name))
        self._asked[question.id] = question
        try:
            yield question
        finally:
            del self._asked[question.id]

    async def _handle(
        self,
        said: AdvertiseService,
        service_type: ServiceType[Message, Message],
        message: Message,
    ) -> Message:
        """Send a service request to the client, and return the client's response."""
        name = said.service
        with self._asking("service", name, "service_request") as question:
            values = json_values(message)
            self._keep(request("call_service", id=question.id, service=name, args=values))
            await question.over.wait()
        answer = question.said
        if answer is None:
            raise ServiceError(name, "its server has gone")
        if not answer.result:
            raise ServiceError(name, f"its server says: {answer.values}")
        response = cast("type[Message]", service_type.Response)
        return await read_message(response, answer.values, root="response")

    async def _execute(
        self,
        said: AdvertiseAction,
        action_type: ActionType[Message, Message, Message],
        goal: Message,
        handle: Handle,
    ) -> Message:
        """Send a goal to the client, and return the result. This is the body of the action."""
        with self._asking("action", said.action, "action_goal") as question:
            question.handle = handle
            question.feedback_type = cast("type[Message]", action_type.Feedback)
            members = {"id": question.id, "action": said.action}
            self._keep(
                request(
                    "send_action_goal",
                    **members,
                    action_type=action_type.type_name,
                    args=json_values(goal),
                    feedback=True,
                    **_trace(),
                )
            )
            try:
                await question.over.wait()
            except self._tasks.cancelled:
                # The goal is being canceled, or its server closed. The client is asked to end it
                # and decides how: its goal may be done by now. If it is gone, nobody is left to
                # ask.
                if question.over.is_set() and question.said is None:
                    raise
                self._keep(request("cancel_action_goal", **members))
                with anyio.move_on_after(CANCEL_WITHIN, shield=True):
                    await question.over.wait()
                if question.said is None:
                    raise
        try:
            return await _result(
                cast("ActionResult | None", question.said),
                cast("type[Message]", action_type.Result),
            )
        except Cancel as verdict:
            # In ROS 2 a goal ends CANCELED only if somebody asked for that.
            if handle.is_cancel_requested:
                raise
            raise Abort("the client canceled it without being asked", verdict.result) from None


def _trace() -> dict[str, str]:
    """Return the frame members for the running goal's tracing span, if it has one."""
    note = GoalMetadata.read(REQUEST_NOTE.get())
    members = {"traceparent": note.traceparent, "tracestate": note.tracestate}
    return {name: value for name, value in members.items() if value}


class _Question:
    """A request or a goal that was sent to the client.

    Attributes:
        id: The id of the request or goal in frames.
        about: The kind (``service`` or ``action``) and the name of the service or action.
        said: The client's answer; None until the answer has come.
        over: Set when the answer has come, or when none will come.
        handle: The handle of a goal; None for a request.
        feedback_type: The class of a goal's feedback.
    """

    feedback_type: type[Message]

    def __init__(self, id: str, about: tuple[str, str]) -> None:
        self.id = id
        self.about = about
        self.said: ServiceResponse | ActionResult | None = None
        self.over = anyio.Event()
        self.handle: Handle | None = None


async def _result(said: ActionResult | None, result_type: type[Message]) -> Message:
    """Return the goal's result from the client's answer, or raise the error that ends the goal.

    Raises:
        Abort: if the client has gone, has aborted the goal, or has sent an answer that does not fit
            the action.
        Cancel: if the client has canceled the goal.
    """
    if said is None:
        raise Abort("the client that serves it has gone")
    status = said.status or GoalStatus.SUCCEEDED if said.result else GoalStatus.ABORTED
    values = said.values if said.result else None
    try:
        result = await read_message(result_type, values, root="result")
    except TurtleactError as misfit:
        raise Abort(f"the client's result does not fit: {misfit}") from None
    if status == GoalStatus.SUCCEEDED:
        return result
    if status == GoalStatus.CANCELED:
        raise Cancel(result)
    raise Abort(str(said.values) if isinstance(said.values, str) else "", result)
