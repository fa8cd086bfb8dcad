"""Runs the tools that do not send goals, such as those that list goals or call services."""

from __future__ import annotations

import base64
from contextlib import suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final, cast

import anyio
from mcp.types import CallToolResult, ImageContent, Tool

from turtleact.errors import InvalidMessage, ServerUnavailable, TurtleactError, UnknownGoal
from turtleact.goals.server import goal_id_bytes
from turtleact.interfaces import SECOND, Message, get_message
from turtleact.interfaces.definition import did_you_mean, names_like
from turtleact.interfaces.values import describe
from turtleact.mcp.messages import answer, plain
from turtleact.names import resolve_name
from turtleact.sim.world_services import TakeSnapshot
from turtleact.transports import QoS
from turtleact.transports.graph import graph_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from turtleact.goals.client import ClientGoalHandle
    from turtleact.interfaces import Service
    from turtleact.mcp.catalogue import Offer
    from turtleact.mcp.goals import Goals, HeldGoal
    from turtleact.node import Node
    from turtleact.node.services import ServiceClient, ServiceType

__all__ = ["Tools", "picture", "read_topic"]

PATIENCE: Final = 5.0
"""How long to wait for a topic's message, or for a canceled goal's end (s, event loop time)."""

PICTURE_PATIENCE: Final = 10.0
"""How long to wait for a world's picture, which a thread draws (s, event loop time)."""


class Tools:
    """Runs the tools that do not send goals.

    Args:
        node: The node that the tools use.
        offer: Which actions, services and topics the tools may use.
        goals: Finds goals, and limits how many goals and calls are under way.
    """

    def __init__(self, node: Node, offer: Offer, goals: Goals) -> None:
        self._node = node
        self._offer = offer
        self._goals = goals
        self._services: dict[tuple[str, str], ServiceClient[Any, Any]] = {}
        self._runs: dict[str, Callable[..., Awaitable[CallToolResult]]] = {
            "list_goals": self.list_goals,
            "read_topic": self._read_topic,
            "take_picture": self._take_picture,
            "cancel_goal": self._cancel,
            "cancel_all_goals": self._cancel_all,
            "pause_goal": self._pause,
            "resume_goal": self._resume,
        }

    async def run(self, tool: Tool, arguments: dict[str, object]) -> CallToolResult:
        """Run one of the fixed tools, which do not depend on the graph, for example ``list_goals``.

        Raises:
            TurtleactError: if the tool fails. The error's text is written for the language model.
        """
        _check_texts(tool, arguments)
        return await self._runs[tool.name](**arguments)

    async def call(
        self, name: str, service_type: type[Service], request: Message
    ) -> CallToolResult:
        """Call a service, and return its response."""
        key = name, service_type.type_name
        if key not in self._services:
            known = cast("ServiceType[Message, Message]", service_type)
            self._services[key] = self._node.service_client(known, name)
        with self._goals.place():
            return answer(plain(await self._services[key].call(request)))

    async def list_goals(self) -> CallToolResult:
        """Return the goals that the servers of the offered actions hold."""
        return answer({"goals": [_told(goal) for goal in await self._goals.held()]})

    async def _read_topic(self, topic: str) -> CallToolResult:
        message = await read_topic(self._node, self._offer, topic)
        return answer(plain(message))

    async def _take_picture(self) -> CallToolResult:
        data = base64.b64encode(await picture(self._node)).decode()
        return CallToolResult(content=[ImageContent(data=data, mime_type="image/png")])

    async def _cancel(self, goal_id: str) -> CallToolResult:
        handle = await self._attach(goal_id)
        await handle.cancel()
        with anyio.move_on_after(PATIENCE):
            await handle.outcome()
        if not handle.done:
            raise TurtleactError(f"goal {goal_id} has not ended: it is {handle.status.name}")
        return _status(handle)

    async def _cancel_all(self) -> CallToolResult:
        active = [goal for goal in await self._goals.held() if not goal.status.is_terminal]
        async with anyio.create_task_group() as canceling:
            for goal in active:
                canceling.start_soon(self._cancel_one, goal)
        ended = {goal.goal_id for goal in active}
        goals = [goal for goal in await self._goals.held() if goal.goal_id in ended]
        left = [goal.goal_id.hex() for goal in goals if not goal.status.is_terminal]
        problem = f"these goals have not ended: {', '.join(left)}" if left else ""
        return answer({"goals": [_told(goal) for goal in goals]}, error=problem)

    async def _cancel_one(self, goal: HeldGoal) -> None:
        with suppress(TurtleactError):  # the reply lists the goals that have not ended
            await self._cancel(goal.goal_id.hex())

    async def _pause(self, goal_id: str) -> CallToolResult:
        handle = await self._attach(goal_id)
        await handle.pause()
        return _status(handle)

    async def _resume(self, goal_id: str) -> CallToolResult:
        handle = await self._attach(goal_id)
        await handle.resume()
        return _status(handle)

    async def _attach(self, text: str) -> ClientGoalHandle[Any, Any]:
        """Return a client's handle for a goal of an offered action."""
        found = await self._goals.find(goal_id_bytes(text))
        if found is None:
            raise UnknownGoal(f"no server of an offered action holds {text}")
        goal, client = found
        return await client.attach(goal.goal_id)


async def read_topic(node: Node, offer: Offer, topic: str) -> Message:
    """Return the newest message of a topic. If no message is latched, wait for the next one.

    Raises:
        TurtleactError: if the topic is not offered, does not exist, or has no message in time.
    """
    name = resolve_name(topic)
    topics = {
        each: types for each, types in graph_of(node.transport).topics.items()
        if offer.allows_topic(each)
    }  # fmt: skip
    if name not in topics:
        raise TurtleactError(f"topic '{name}' is not offered{names_like(name, topics)}")
    message_type = get_message(topics[name][0])
    subscription = node.subscription(message_type, name, QoS(depth=1, durability="transient_local"))
    try:
        with anyio.move_on_after(PATIENCE):
            return await anext(subscription)
    finally:
        subscription.close()
    raise TurtleactError(f"topic '{name}' had no message within {PATIENCE:g} s")


async def picture(node: Node) -> bytes:
    """Return a PNG picture of the simulated world.

    Raises:
        TurtleactError: if there is no world, or if the world makes no picture in time.
    """
    services = graph_of(node.transport).services
    names = [name for name, types in services.items() if TakeSnapshot.type_name in types]
    if not names:
        problem = "no world of turtles is on this graph"
        raise ServerUnavailable("/world/snapshot", problem, kind="service")
    client = node.service_client(TakeSnapshot, names[0])
    try:
        with anyio.move_on_after(PICTURE_PATIENCE):
            await client.wait_for_service()
            taken = await client.call(TakeSnapshot.Request("png"))
            if taken.problem:
                raise TurtleactError(taken.problem)
            return bytes(taken.data)
    finally:
        await client.aclose()
    raise TurtleactError(f"the world made no picture within {PICTURE_PATIENCE:g} s")


def _check_texts(tool: Tool, arguments: dict[str, object]) -> None:
    """Check the arguments of a tool that takes only strings."""
    names = list(tool.input_schema["properties"])
    for name, value in arguments.items():
        if name not in names:
            hint = did_you_mean(name, names) or f": it takes {', '.join(names) or 'nothing'}"
            raise InvalidMessage(tool.name, f"unknown argument '{name}'{hint}")
        if not isinstance(value, str):
            raise InvalidMessage(f"{tool.name}.{name}", f"expected text, got {describe(value)}")
    for name in names:
        if name not in arguments:
            raise InvalidMessage(f"{tool.name}.{name}", "it is missing")


def _told(goal: HeldGoal) -> dict[str, str]:
    accepted = datetime.fromtimestamp(goal.stamp / SECOND, UTC)
    return {
        "goal_id": goal.goal_id.hex(),
        "action": goal.action,
        "status": goal.status.name,
        "accepted": accepted.isoformat(timespec="milliseconds"),
    }


def _status(handle: ClientGoalHandle[Any, Any]) -> CallToolResult:
    return answer({"goal_id": handle.goal_id.hex(), "status": handle.status.name})
