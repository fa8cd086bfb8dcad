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
from collections.abc import Callable, Sequence
from typing import Any, Protocol, cast

import anyio

from turtleact.errors import GoalRejected
from turtleact.goal import Goal, GoalStatus
from turtleact.interfaces import Action, Implied, Message, WireFormat, implied
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    GoalStatusArray,
    GoalStatusMessage,
)
from turtleact.names import ActionNames
from turtleact.server.action_server import ActionServer
from turtleact.services import ServiceServer
from turtleact.tasks import GRACE, Signal, Tasks
from turtleact.transports.base import Endpoint, EndpointKind, Publication, QoS, Reply, Transport

__all__ = ["ActionEndpoints"]

logger = logging.getLogger("turtleact.server")

STATUS_QOS = QoS(depth=1, durability="transient_local")


class MakeEndpoint(Protocol):
    """Makes the description of an endpoint of the server's node."""

    def __call__(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None
    ) -> Endpoint: ...


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
        self._tasks = tasks
        self._services = {
            kind: _Lazy(server, make, tasks.signal())
            for kind, make in (
                ("SendGoal", self._make_send_goal),
                ("CancelGoal", self._make_cancel_goal),
                ("GetResult", self._make_get_result),
            )
        }
        action = server.action_type.type_name
        if transport.local(names.send_goal, f"{action}_SendGoal") is not None:
            logger.warning("%s is served already; clients go to the first server", names.name)
        self._opened = [
            transport.serve(endpoint("service", at, type_name), WireFormat(interface), handler)
            for at, type_name, interface, handler in (
                (names.send_goal, f"{action}_SendGoal", lambda: _implied(server).send_goal, server),
                (names.cancel_goal, CancelGoal.type_name, CancelGoal, self._services["CancelGoal"]),
                (
                    names.get_result,
                    f"{action}_GetResult",
                    lambda: _implied(server).get_result,
                    self._services["GetResult"],
                ),
            )
        ]
        self._publications = self._advertise(transport, endpoint)

    def close(self) -> None:
        """Serve no more; requests that are under way go on, and changes are still told."""
        for opened in self._opened:
            opened.close()

    async def send_goal(self, request: object) -> object:
        """Answer a ``SendGoal`` request."""
        return await self._services["SendGoal"].answer(request)

    async def aclose(self) -> None:
        """Answer all who still wait; with results, as the goals have ended."""
        await self._services["GetResult"].drain()
        for service in self._services.values():
            await service.aclose()
        for publication in self._publications:
            publication.close()

    def _advertise(self, transport: Transport, endpoint: MakeEndpoint) -> list[Publication]:
        """Open the topics."""
        server, names = self._server, self._names
        feedback, status = _Feedback(server), _Status(server)
        described = endpoint(
            "publisher", names.feedback, f"{server.action_type.type_name}_FeedbackMessage"
        )
        format = WireFormat(lambda: _implied(server).feedback_message)
        feedback.publication = transport.advertise(described, format, feedback)
        described = endpoint("publisher", names.status, GoalStatusArray.type_name, STATUS_QOS)
        format = WireFormat(GoalStatusArray)
        status.publication = transport.advertise(described, format, status)
        return [feedback.publication, status.publication]

    # the services

    def _make_send_goal(self) -> ServiceServer[Any, Any]:
        service_type = _implied(self._server).send_goal
        server, response = self._server, service_type.Response

        async def send_goal(request: Any) -> Message:  # noqa: ANN401  # of the action's own class
            goal_id, message = request.goal_id.uuid, request.goal
            if not any(goal_id):  # zeros name no goal: nobody could ask for it
                return response(accepted=False)
            try:
                if server.waits_first():
                    message = await server.prepare(message)
                goal = server.begin(message, goal_id, None, is_streamed=False)
            except GoalRejected:
                return response(accepted=False)
            return response(accepted=True, stamp=server.info(goal).stamp)

        return ServiceServer(service_type, self._names.send_goal, send_goal, tasks=self._tasks)

    def _make_cancel_goal(self) -> ServiceServer[Any, Any]:
        server = self._server

        async def cancel_goal(request: CancelGoal.Request) -> CancelGoal.Response:
            stamp = request.goal_info.stamp
            nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
            return await server.cancel(request.goal_info.goal_id.uuid, nanoseconds)

        return ServiceServer(CancelGoal, self._names.cancel_goal, cancel_goal, tasks=self._tasks)

    def _make_get_result(self) -> ServiceServer[Any, Any]:
        service_type = _implied(self._server).get_result
        server, response = self._server, service_type.Response

        async def get_result(request: Any) -> Message:  # noqa: ANN401  # of the action's own class
            goal = server.find(request.goal_id.uuid)
            if goal is None:
                return response(status=GoalStatus.UNKNOWN)
            await server.wait_for_end(goal)
            return response(status=int(goal.status), result=cast("Message", goal.result))

        return ServiceServer(service_type, self._names.get_result, get_result, tasks=self._tasks)


class _Lazy:
    """A service that is made with its first request: its classes take a while to make."""

    def __init__(
        self,
        server: ActionServer[Any, Any, Any],
        make: Callable[[], ServiceServer[Any, Any]],
        answered: Signal,
    ) -> None:
        self._server = server
        self._make = make
        self._answered = answered
        self._waiting = 0
        self._made: ServiceServer[Any, Any] | None = None

    @property
    def is_open(self) -> bool:
        """Whether it takes requests."""
        return self._server.is_open

    async def answer(self, request: object) -> object:
        """Have a request handled, and wait for its response."""
        if self._made is None:
            self._made = self._make()
        self._waiting += 1
        try:
            return await self._made.answer(request)
        finally:
            self._waiting -= 1
            self._answered.fire()

    async def reply(self, request: object, caller: bytes) -> Reply:  # noqa: ARG002  # all are equal
        """Answer a request that came over a wire; as `answer`."""
        return Reply(await self.answer(request))

    async def drain(self) -> None:
        """Wait until all who wait have their answer, `GRACE` seconds at most."""
        with anyio.move_on_after(GRACE, shield=True):
            while self._waiting:
                await self._answered.wait()

    async def aclose(self) -> None:
        """Answer all who wait."""
        if self._made is not None:
            await self._made.aclose()


class _Feedback:
    """The source of the feedback topic."""

    publication: Publication

    def __init__(self, server: ActionServer[Any, Any, Any]) -> None:
        self._server = server

    def current(self) -> Sequence[object]:
        """Feedback is for those who are there."""
        return ()

    def readers_changed(self, *, has_readers: bool) -> None:
        """Publish while somebody reads."""
        self._server.execution.also_feedback = self._publish if has_readers else None

    def _publish(self, goal: Goal, feedback: Any) -> None:  # noqa: ANN401  # of the action's own class
        message = _implied(self._server).feedback_message
        self.publication.publish(message(UUID(self._server.name_goal(goal)), feedback))


class _Status:
    """The source of the status topic."""

    publication: Publication

    def __init__(self, server: ActionServer[Any, Any, Any]) -> None:
        self._server = server
        self._is_watching = False

    def current(self) -> Sequence[object]:
        """All goals that the server holds."""
        statuses = [
            GoalStatusMessage(self._server.info(goal), int(goal.status))
            for goal in self._server.held()
        ]
        return (GoalStatusArray(statuses),)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Publish while somebody reads."""
        if has_readers and not self._is_watching:
            self._server.hooks.add(self._publish)
        elif self._is_watching and not has_readers:
            self._server.hooks.remove(self._publish)
        self._is_watching = has_readers

    def _publish(self, *_change: object) -> None:
        self.publication.refresh()


def _implied(server: ActionServer[Any, Any, Any]) -> Implied:
    return implied(cast("type[Action]", server.action_type))
