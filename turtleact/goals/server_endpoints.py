"""Opens an action's endpoints on the graph: three services and two topics, for any node.

Clients in the same process do not need the endpoints to send goals. The endpoints are for nodes
that send ``SendGoal`` requests, cancel other nodes' goals, request results, or read feedback and
status. Messages are created and published only in reply to a request or while a topic has readers.

========================  ==================================  ==================================
``…/_action/send_goal``   ``pkg/action/Name_SendGoal``        accepts or rejects a goal
``…/_action/cancel_goal`` ``action_msgs/srv/CancelGoal``      cancels goals by id and stamp
``…/_action/get_result``  ``pkg/action/Name_GetResult``       waits for the end, then answers
``…/_action/feedback``    ``pkg/action/Name_FeedbackMessage`` the feedback of all goals
``…/_action/status``      ``action_msgs/msg/GoalStatusArray`` all goals' states, at each change
========================  ==================================  ==================================

Each service and topic makes its messages only for a request, or while the topic has readers.

Source: rcl_action ``action_server.c``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final, cast

import msgspec

from turtleact.errors import CUT_OFF, STOPPED, GoalRejected
from turtleact.goals.observers import FeedbackLost, ObservingSource
from turtleact.goals.pause_endpoints import PauseEndpoints
from turtleact.goals.server import LocalActionServer
from turtleact.goals.service_server import Introspection, service_events
from turtleact.goals.state import CancelCode, Goal, GoalRequest, GoalStatus
from turtleact.goals.wire import GoalMetadata, GoalReason, reason_topic, write_states
from turtleact.interfaces import (
    SECOND,
    Action,
    FeedbackFormat,
    Implied,
    Message,
    WireFormat,
    implied,
    nanoseconds,
    stamp_of,
)
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    GoalStatusArray,
)
from turtleact.names import ActionNames
from turtleact.tasks import GRACE, Background, wait_while
from turtleact.transports.base import (
    STATUS_QOS,
    CallObserver,
    Closeable,
    Endpoint,
    EndpointKind,
    MakeEndpoint,
    QoS,
    Reply,
    ServiceHandler,
    Source,
    Transport,
)

if TYPE_CHECKING:
    from turtleact.goals.fault_reports import LostFeedback

__all__ = ["ActionEndpoints", "FeedbackTopic", "StatusTopic"]

NAMELESS = "a goal id must not be all zeros"
"""The reason for rejecting a goal with the id zero."""

OURS = GoalMetadata().write()
"""An empty note to attach to a response.

A response with a note shows that a turtleact server has sent the response.
"""


LATE_REQUEST = 0.5
"""How long a closing server waits for clients in other processes to request results (s)."""

EXPIRED_TOGETHER: Final = 1.0
"""The shortest time between two status messages that report only expired goals (s)."""


class ActionEndpoints:
    """The endpoints of one action server.

    Args:
        server: The server.
        names: The names of the endpoints.
        transport: The transport to open the endpoints on.
        endpoint: A function that returns the `Endpoint` for a kind, a name and a type.
        introspection: Whether the three services publish events, with or without the contents of
            requests and responses.
    """

    _feedback: FeedbackTopic
    _reasons: ReasonTopic

    def __init__(
        self,
        server: LocalActionServer,
        names: ActionNames,
        transport: Transport,
        endpoint: MakeEndpoint,
        introspection: Introspection = "off",
    ) -> None:
        self._server = server
        self._names = names
        self._transport = transport
        self._endpoint = endpoint
        self._introspection = introspection
        self._cancel_goal = _ActionService(
            server, names.cancel_goal, lambda: CancelGoal, self._answer_cancel
        )
        self._get_result = _ActionService(
            server, names.get_result, lambda: self._implied.get_result, self._answer_result
        )
        self._send_goal = _ActionService(
            server, names.send_goal, lambda: self._implied.send_goal, self._answer_goal
        )
        if introspection == "off":
            self._send_goal.direct = server
        self._has_senders = False
        self._told: set[bytes] = set()  # the goals whose results were given while closing
        self._unlisted: MakeEndpoint = partial(_unlisted, endpoint)
        self._pausing = PauseEndpoints(server, transport, self._unlisted)
        self._services: list[Closeable] = []
        self._topics: list[Closeable] = []

    @property
    def is_asked(self) -> bool:
        """Whether the server has received a request that is not answered yet."""
        return any(each.waiting for each in (self._send_goal, self._cancel_goal, self._get_result))

    @cached_property
    def _implied(self) -> Implied:
        """The types of the services and of the feedback message, made when first needed."""
        return implied(cast("type[Action]", self._server.spec.action_type))

    def open(self) -> None:
        """Open the endpoints, so that the action appears on the graph."""
        action = self._server.spec.action_type.type_name
        describe, names = self._endpoint, self._names
        services = (
            (self._cancel_goal, CancelGoal.type_name),
            (self._get_result, f"{action}_GetResult"),
            (self._send_goal, f"{action}_SendGoal"),  # last: clients that see it expect the others
        )
        for service, type_name in services:  # this raises if the introspection is unknown
            described = describe("service", service.name, type_name)
            service.observer = self._observer(service, described)
        self._pausing.open()
        self._reasons = ReasonTopic(self._server, self._transport, self._unlisted)
        for service, type_name in services:
            described = describe("service", service.name, type_name)
            offered = self._transport.serve(described, WireFormat(service.find_type), service)
            self._services.append(offered)
        described = describe("publisher", names.feedback, f"{action}_FeedbackMessage")
        self._feedback = FeedbackTopic(self._server, self._transport, described)
        described = describe("publisher", names.status, GoalStatusArray.type_name, STATUS_QOS)
        status = StatusTopic(self._server, self._transport, described)
        self._topics += self._reasons, self._feedback, status

    def _observer(self, service: _ActionService, endpoint: Endpoint) -> CallObserver | None:
        """Return the observer that publishes a service's events; None if introspection is off."""
        mode, find_type = self._introspection, service.find_type
        events = service_events(self._transport, self._endpoint, endpoint, find_type, mode)
        if events is not None:
            self._topics.append(events)
        return events

    def stop_taking_goals(self) -> None:
        """Stop accepting goals. Clients can still cancel existing goals and wait for them."""
        if self._services:
            self._services[-1].close()

    async def aclose(self) -> None:
        """Answer every waiting request and close the endpoints.

        Call this after all bodies have ended.
        """
        results = self._get_result
        if self._services:
            await wait_while(self._is_expected, results.answered, LATE_REQUEST)
        await wait_while(lambda: results.waiting, results.answered, GRACE)
        for opened in self._services:
            opened.close()
        for topic in self._topics:
            topic.close()
        await self._pausing.aclose()

    def _is_expected(self) -> bool:
        """Whether a client in another process is likely to ask soon how a goal ended just now."""
        reasons = (self._server.closing_reason, STOPPED, CUT_OFF)
        return any(
            isinstance(goal.sender, bytes)
            and goal.sender != b""
            and goal.reason in reasons
            and goal.id not in self._told
            for goal in self._server.held().values()
        )

    # answers to requests

    async def _answer_goal(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401
        """Accept or reject a goal."""
        # A client that sends a goal also reads feedback, even if its subscription is not known yet.
        if not self._has_senders:
            self._has_senders = True
            self._feedback.expect_readers()
        response = self._implied.send_goal.Response
        try:
            if not any(request.goal_id.uuid):
                raise GoalRejected(NAMELESS)
            goal = await self._server.send(GoalRequest(request.goal, caller, request.goal_id.uuid))
        except GoalRejected as rejected:
            self._reasons.rejected(bytes(request.goal_id.uuid), rejected.reason)
            note = GoalMetadata(rejected.reason, is_closing=not self._server.is_open)
            return Reply(response(accepted=False), note.write())
        return Reply(response(accepted=True, stamp=stamp_of(goal.stamp)), OURS)

    async def _answer_cancel(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401, ARG002
        """Cancel goals of all servers in this process that serve an action of this name."""
        goal_id, stamp = request.goal_info.goal_id.uuid, nanoseconds(request.goal_info.stamp)
        # A node may serve several types under one name, and a cancel request names no type.
        handlers = self._transport.local(self._names.cancel_goal, CancelGoal.type_name)
        servers = [each.server for each in handlers if isinstance(each, _ActionService)]
        return Reply(_joined([await each.cancel(goal_id, stamp) for each in servers]))

    async def _answer_result(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401, ARG002
        """Answer with the result of a goal, once the goal has ended."""
        response = self._implied.get_result.Response
        await self._server.wait_until_restored()
        goal = self._server.find(request.goal_id.uuid)
        if goal is None:
            return Reply(response(status=GoalStatus.UNKNOWN), OURS)
        await goal.wait_for_end()
        if goal.error is not None:  # the server stops, and the goal goes on after a restart
            raise goal.error
        if not self._server.is_open:
            self._told.add(goal.id)
        note = GoalMetadata(goal.reason, goal.log.count).write()
        return Reply(response(status=int(goal.status), result=cast("Any", goal.result)), note)


class _ActionService(ServiceHandler):
    """One of the action's three services.

    A request needs no check: decoding it, or the service client in this process, has checked it.

    Attributes:
        server: The action server that the service belongs to.
        name: The name of the service.
        find_type: Returns the class of the service, which is made when it is first needed.
        direct: For ``send_goal``: the server that clients in the same process call directly; see
            `turtleact.goals.server`. If introspection is on, it is None. Clients in the same
            process then send requests, as clients in other processes do.
        answered: A signal that fires whenever a request has been answered.
        observer: The observer of the service's calls; None if there is none.
        waiting: The number of requests that are not answered yet.
    """

    def __init__(
        self,
        server: LocalActionServer,
        name: str,
        find_type: Callable[[], Any],
        answer: Callable[[Any, bytes], Awaitable[Reply]],
    ) -> None:
        self.server = server
        self.name = name
        self.find_type = find_type
        self.answered = server.tasks.signal()
        self.waiting = 0
        self._answer = answer

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request. ``caller`` is the client's gid."""
        self.waiting += 1
        try:
            return await self._answer(request, caller)
        finally:
            self.waiting -= 1
            self.answered.fire()

    def caller_lost(self, caller: bytes) -> None:
        """Tell the server that a client in another process has gone."""
        self.server.client_lost(caller)


class FeedbackTopic(Source):
    """Publishes the feedback of a server's goals.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: The description of the topic's endpoint.
    """

    def __init__(self, server: LocalActionServer, transport: Transport, endpoint: Endpoint) -> None:
        self._server = server
        self._action = cast("type[Action]", server.spec.action_type)
        self._format = FeedbackFormat(self._action)
        self._transport, self._endpoint = transport, endpoint
        self._lost: LostFeedback | None = None
        self._publication = transport.advertise(endpoint, self._format, self)
        self._latest: Goal | None = None  # the goal of the newest message

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to publish feedback if the topic has readers; otherwise stop."""
        self._server.publisher = self if has_readers else None

    def message_lost(self) -> None:
        """Tell observers and ``turtleact doctor`` that the newest message was dropped."""
        if self._lost is None:
            from turtleact.goals.fault_reports import LostFeedback  # few programs need it

            how, advice = "were dropped by", "publish feedback less often, or read it faster"
            place = self._transport, self._endpoint.node
            self._lost = LostFeedback(*place, self._server.name, how, advice)
        self._lost.add(1)
        if self._latest is not None:
            self._server.observers.noted(self._latest, FeedbackLost(1))

    def expect_readers(self) -> None:
        """Publish from now on, even if no reader is known yet.

        Called when a client in another process sends a goal, because that client reads feedback.
        """
        self._publication.expect_readers()

    def close(self) -> None:
        """Close the topic."""
        self._publication.close()
        if self._lost is not None:
            self._lost.close()

    @property
    def is_congested(self) -> bool:
        """Whether bodies should wait before they publish more feedback."""
        return self._publication.is_congested

    async def drained(self) -> None:
        """Wait until the topic is not congested. Cancelling: safe."""
        await self._publication.drained()

    def send(self, goal: Goal, message: Message) -> None:
        """Publish feedback that has been checked and copied."""
        self._latest = goal
        if self._publication.has_object_readers:
            self._publication.publish(self._message_type(UUID(goal.id), message))
        else:
            self._publication.send(self._format.write(goal.id, message))

    @cached_property
    def _message_type(self) -> type[Any]:
        return implied(self._action).feedback_message


class StatusTopic(ObservingSource):
    """Publishes the status of all goals that a server holds.

    A message lists all goals, and a server may hold thousands. The topic therefore builds a message
    only when it sends the message, and one message may report several changes.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: The description of the topic's endpoint.
    """

    def __init__(self, server: LocalActionServer, transport: Transport, endpoint: Endpoint) -> None:
        super().__init__(server.observers)
        self._server = server
        self._clock = transport.clock
        self._format = WireFormat(GoalStatusArray)
        self._expiring: Background | None = None
        self._publication = transport.advertise(endpoint, self._format, self)

    def current(self) -> Sequence[object]:
        """Build the message with all goals that the server holds."""
        format = self._format
        return [format.decode(data) for data in self.written(format.encode)]

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:  # noqa: ARG002
        """Build the status message as bytes, which is faster than the encoder of messages."""
        held = self._server.held().values()
        return (write_states([(goal.id, goal.stamp, goal.status) for goal in held]),)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to observe goals and their expiry if the topic has readers; otherwise stop."""
        super().readers_changed(has_readers=has_readers)
        if self._expiring is not None:
            self._expiring.cancel()
        if has_readers:
            name, tasks = f"the status of {self._server.name}", self._server.tasks
            self._expiring = Background(self._refresh_at_expiries(), name, tasks)

    async def _refresh_at_expiries(self) -> None:
        """Publish the status again when goals have expired, so that no reader asks for them."""
        while True:
            due = self._server.table.next_expiry()
            if due is None:
                await self._server.idle.wait()
            else:
                left = (due - self._server.now()) / SECOND
                await self._clock.sleep(max(left, EXPIRED_TOGETHER))
                self._publication.refresh()

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """Publish the status of all goals again.

        Readers in this process get a message at each change. Readers in other processes get one
        message for several changes in quick succession.
        """
        self._publication.refresh()

    def close(self) -> None:
        """Close the topic."""
        self.readers_changed(has_readers=False)
        self._publication.close()


class ReasonTopic(ObservingSource):
    """Publishes, for recorders, why goals were rejected or ended without success.

    ROS 2 has no topic for reasons, and its messages have no field for a reason. Clients get the
    reason as an attachment of a response, but recorders cannot record attachments.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: A function that describes the endpoint.
    """

    def __init__(
        self, server: LocalActionServer, transport: Transport, endpoint: MakeEndpoint
    ) -> None:
        super().__init__(server.observers)
        name, type_name = reason_topic(server.name), GoalReason.type_name
        described = endpoint("publisher", name, type_name, QoS(depth=100))
        self._publication = transport.advertise(described, WireFormat(GoalReason), self)

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """If a goal has ended and has a reason, publish the reason."""
        if after.is_terminal and goal.reason:
            self._publish(goal.id, after, goal.reason)

    def rejected(self, goal_id: bytes, reason: str) -> None:
        """Publish why a goal was rejected."""
        if self._publication.has_readers:
            self._publish(goal_id, GoalStatus.UNKNOWN, reason)

    def close(self) -> None:
        """Close the topic."""
        self.readers_changed(has_readers=False)
        self._publication.close()

    def _publish(self, goal_id: bytes, status: GoalStatus, reason: str) -> None:
        self._publication.publish(GoalReason(UUID(goal_id), int(status), reason))


def _unlisted(
    endpoint: MakeEndpoint, kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None
) -> Endpoint:
    """Describe an endpoint that actions in ROS 2 do not have. Lists of endpoints leave it out."""
    described = endpoint(kind, name, type_name, qos)
    return msgspec.structs.replace(described, on_demand=True, is_unlisted=True)


def _joined(answers: list[CancelGoal.Response]) -> CancelGoal.Response:
    """Join the answers of servers that share a cancel service. Each goal is in only one answer."""
    codes = [each.return_code for each in answers]
    known = [code for code in codes if code != CancelCode.UNKNOWN_GOAL_ID]
    return CancelGoal.Response(
        return_code=min(known, default=CancelCode.UNKNOWN_GOAL_ID),  # NONE is the smallest
        goals_canceling=[goal for each in answers for goal in each.goals_canceling],
    )
