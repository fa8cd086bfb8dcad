"""Asks servers to pause or resume goals, and asks which goals are paused.

ROS 2 cannot pause goals. Servers of turtleact offer a service and a topic for pauses, as soon as a
client looks for the service or the topic; see `turtleact.goals.wire`.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from typing import TYPE_CHECKING, Final

import anyio

from turtleact.errors import PauseRefused, ServiceTimeout
from turtleact.goals.wire import PausedGoals, SetPaused, paused_topic, set_paused_service
from turtleact.interfaces.standard import UUID
from turtleact.tasks.clock import within
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["TIMEOUT", "follow_paused", "paused_goals", "set_paused"]

TIMEOUT: Final = 5.0
"""The default time that a body may take to pause (s, event loop time)."""

ANSWER: Final = 10.0
"""How long the server may take to answer, in addition to the body's time to pause.

In seconds, by the clock of the graph.
"""

OFFERED_WITHIN: Final = 2.0
"""How long a server may take to offer the service (s, by the clock of the graph)."""

TOLD_WITHIN: Final = 0.2
"""How long to wait for the message with the paused goals (s, by the clock of the graph).

The time for `ROUND_TRIPS` is added. Servers without turtleact do not publish this message.
"""

ROUND_TRIPS: Final = 5
"""The wait for the message with the paused goals also includes this many network round trips.

The node must ask for the topic, find the topic's publisher, and get the latched message.
"""

LATCHED: Final = QoS(depth=1, durability="transient_local")


async def paused_goals(node: Node, actions: Iterable[str]) -> frozenset[bytes]:
    """Return the ids of all paused goals of these actions."""
    found = set[bytes]()

    async def listen(action: str) -> None:
        async for paused in follow_paused(node, action):
            found.update(paused)
            break

    patience = TOLD_WITHIN + ROUND_TRIPS * node.transport.round_trip
    async with within(patience, node.clock), anyio.create_task_group() as listening:
        for action in actions:
            listening.start_soon(listen, action)
    return frozenset(found)


async def follow_paused(node: Node, action: str) -> AsyncGenerator[frozenset[bytes], None]:
    """Yield the ids of all paused goals of an action: at the start, and after each change."""
    subscription = node.subscription(PausedGoals, paused_topic(action), LATCHED)
    try:
        async for message in subscription:
            yield frozenset(bytes(each.uuid) for each in message.goal_ids)
    finally:
        await subscription.aclose()


async def set_paused(
    node: Node, action: str, goal_id: bytes, *, is_paused: bool, timeout: float = TIMEOUT
) -> None:
    """Pause or resume a goal, and wait until its server has done so.

    Args:
        node: The node of this process, which sends the request.
        action: The fully qualified name of the action.
        goal_id: The id of the goal.
        is_paused: True to pause the goal, False to resume it.
        timeout: How long the server waits for the goal's body to pause (s).

    Raises:
        PauseRefused: if the server refuses, cannot pause goals, or does not answer.
        ServerUnavailable: if the server goes away.
    """
    client = node.service_client(SetPaused, set_paused_service(action))
    try:
        if not await client.wait_for_service(OFFERED_WITHIN):
            raise PauseRefused("its server does not offer that; is it a server of turtleact?")
        request = SetPaused.Request(UUID(goal_id), is_paused, timeout)
        response = await client.call(request, timeout + ANSWER)
    except ServiceTimeout:
        raise PauseRefused("the server does not answer") from None
    finally:
        await client.aclose()
    if not response.success:
        raise PauseRefused(response.message)
