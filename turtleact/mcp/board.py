"""Finds the goals that the servers of the offered actions hold, from their status topics.

A status topic is read from the first question about goals on. Its last message is latched, so
earlier goals are known, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import anyio

from turtleact.goal import GoalStatus, status_of
from turtleact.interfaces import nanoseconds
from turtleact.interfaces.standard import GoalStatusArray
from turtleact.names import action_names
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from turtleact.node import Node
    from turtleact.topics import Subscription

__all__ = ["Board", "HeldGoal"]

PATIENCE: Final = 0.5
"""How long to wait for latched messages, besides some round trips (s, event loop time)."""

ROUND_TRIPS: Final = 5

STATUS_QOS: Final = QoS(depth=1, durability="transient_local")


class HeldGoal(NamedTuple):
    """A goal that a server holds.

    Attributes:
        goal_id: The 16 bytes of its id.
        action: The name of its action.
        status: Its state.
        stamp: When the goal was accepted (ns since the epoch, by the server's clock).
    """

    goal_id: bytes
    action: str
    status: GoalStatus
    stamp: int


class Board:
    """Reads the status topics of some actions.

    Args:
        node: The node that subscribes to the topics.
        actions: A function that returns the names of the actions that count now.
    """

    def __init__(self, node: Node, actions: Callable[[], Collection[str]]) -> None:
        self._node = node
        self._actions = actions
        self._topics: dict[str, Subscription[GoalStatusArray]] = {}

    async def goals(self) -> list[HeldGoal]:
        """All goals, in the order of their acceptance."""
        await self._join()
        found = [
            HeldGoal(
                each.goal_info.goal_id.uuid,
                action,
                status_of(each.status),
                nanoseconds(each.goal_info.stamp),
            )
            for action, topic in self._topics.items()
            if topic.latest is not None
            for each in topic.latest.status_list
        ]
        return sorted(found, key=lambda goal: goal.stamp)

    async def find(self, goal_id: bytes) -> HeldGoal | None:
        """The goal with an id, if a server holds it."""
        return next((goal for goal in await self.goals() if goal.goal_id == goal_id), None)

    async def _join(self) -> None:
        """Read the topics of new actions, wait for their latched messages, and leave old topics."""
        actions = self._actions()
        for gone in self._topics.keys() - set(actions):
            self._topics.pop(gone).close()
        new = [action for action in actions if action not in self._topics]
        for action in new:
            name = action_names(action).status
            self._topics[action] = self._node.subscription(GoalStatusArray, name, STATUS_QOS)
        patience = PATIENCE + ROUND_TRIPS * self._node.transport.round_trip
        with anyio.move_on_after(patience):
            for action in new:
                topic = self._topics[action]
                if topic.latest is None and self._node.count_publishers(topic.topic):
                    await anext(topic)
