"""Opens the endpoints with which other processes pause and resume goals.

An endpoint is declared only when another process has an endpoint of the same name.
`turtleact.goals.wire` has the messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import anyio

from turtleact.errors import PauseRefused, TurtleactError
from turtleact.goals.observers import ObservingSource
from turtleact.goals.service_server import LocalServiceServer
from turtleact.goals.state import Goal, GoalStatus
from turtleact.goals.wire import PausedGoals, SetPaused, paused_topic, set_paused_service
from turtleact.interfaces import WireFormat
from turtleact.interfaces.standard import UUID
from turtleact.interfaces.standard.std_srvs.srv import Trigger
from turtleact.transports.base import STATUS_QOS, Closeable, Publication

if TYPE_CHECKING:
    from turtleact.goals.server import LocalActionServer
    from turtleact.transports.base import MakeEndpoint, Transport

__all__ = ["PauseEndpoints"]

PATIENCE = 5.0
"""The timeout for pausing a goal when a client pauses all goals at once (s, event loop time)."""

_PAUSABLE = (GoalStatus.ACCEPTED, GoalStatus.EXECUTING)


class PauseEndpoints(ObservingSource):
    """The services and the topic with which other processes pause and resume a server's goals.

    Args:
        server: The server of the goals.
        transport: The transport to open the services and the topic on.
        endpoint: A function that returns the `Endpoint` for a kind, a name and a type.
    """

    def __init__(
        self, server: LocalActionServer, transport: Transport, endpoint: MakeEndpoint
    ) -> None:
        super().__init__(server.observers)
        self._server = server
        self._transport = transport
        self._endpoint = endpoint
        self._services: list[LocalServiceServer[Any, Any]] = []
        self._opened: list[Closeable] = []
        self._publication: Publication | None = None

    def open(self) -> None:
        """Open the services and the topic."""
        name = self._server.name
        self._serve(SetPaused, set_paused_service(name), self._set_paused)
        self._serve(Trigger, f"{name}/pause", self._pause_all)
        self._serve(Trigger, f"{name}/resume", self._resume_all)
        topic = self._endpoint("publisher", paused_topic(name), PausedGoals.type_name, STATUS_QOS)
        self._publication = self._transport.advertise(topic, WireFormat(PausedGoals), self)
        self._opened.append(self._publication)

    async def aclose(self) -> None:
        """Close the services and the topic."""
        self._server.observers.remove(self)
        for opened in self._opened:
            opened.close()
        for service in self._services:
            await service.aclose()

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:  # noqa: ARG002
        """Publish which goals are paused now."""
        if self._publication is not None:
            self._publication.refresh()

    def current(self) -> Sequence[object]:
        """Build the message with all goals that are paused."""
        ids = [UUID(goal.id) for goal in self._server.pauses.paused]
        return (PausedGoals(goal_ids=ids),)

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """Build the message with all goals that are paused, as bytes."""
        return [encode(message) for message in self.current()]

    def _serve(self, service: Any, name: str, handle: Callable[[Any], Any]) -> None:  # noqa: ANN401
        server = LocalServiceServer(service, name, handle, tasks=self._server.tasks)
        endpoint = self._endpoint("service", name, service.type_name)
        self._services.append(server)
        self._opened.append(self._transport.serve(endpoint, WireFormat(service), server))

    async def _set_paused(self, request: SetPaused.Request) -> SetPaused.Response:
        goal = self._server.find(bytes(request.goal_id.uuid))
        if goal is None:
            return SetPaused.Response(message="the server holds no such goal")
        try:
            if request.is_paused:
                await self._server.pauses.pause(goal, request.timeout)
            else:
                await self._server.pauses.resume(goal)
        except PauseRefused as refused:
            return SetPaused.Response(message=refused.reason)
        return SetPaused.Response(success=True)

    async def _pause_all(self, _: Trigger.Request) -> Trigger.Response:
        # Goals that wait for their turn are paused too: otherwise one could begin in the pause.
        meant = [each for each in self._server.held().values() if each.status in _PAUSABLE]
        return await self._each(
            meant, lambda goal: self._server.pauses.pause(goal, PATIENCE), "paused"
        )

    async def _resume_all(self, _: Trigger.Request) -> Trigger.Response:
        return await self._each(self._server.pauses.paused, self._server.pauses.resume, "resumed")

    async def _each(
        self, goals: list[Goal], switch: Callable[[Goal], Any], done: str
    ) -> Trigger.Response:
        problems = list[str]()

        async def try_to(goal: Goal) -> None:
            try:
                await switch(goal)
            except TurtleactError as error:
                problems.append(f"goal {goal.hex}: {error}")

        async with anyio.create_task_group() as group:  # no robot waits for another
            for goal in goals:
                group.start_soon(try_to, goal)
        count = len(goals) - len(problems)
        what = f"{count} of {len(goals)}" if problems else str(count)
        told = f"{what} goal{'s' * (len(goals) != 1)} {done}"
        return Trigger.Response(success=not problems, message="; ".join([told, *problems]))
