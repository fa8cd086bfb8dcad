"""Sends the goals of models, and lists the goals that the servers of the offered actions hold.

Each call of an action's tool sends one goal, and returns when the goal has ended. If the call is
cancelled, the goal is canceled too, and the call waits for the goal's end. The ``async with`` block
of `turtleact.goals.client.SendGoal` ensures this. If a client disconnects, its calls are
cancelled in the same way.

The status topics are subscribed to when goals are first listed. The last message of a status topic
is latched, so goals that were accepted earlier are listed, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, cast

import anyio

from turtleact.errors import TurtleactError
from turtleact.goals.state import GoalStatus, status_of
from turtleact.interfaces import nanoseconds
from turtleact.interfaces.standard import GoalStatusArray
from turtleact.mcp.messages import data_of, failure, one_line
from turtleact.names import action_names
from turtleact.transports.base import STATUS_QOS

if TYPE_CHECKING:
    from mcp.types import CallToolResult

    from turtleact.goals.body import ActionType
    from turtleact.goals.client import ActionClient
    from turtleact.interfaces import Action, Message
    from turtleact.mcp.catalogue import Limits
    from turtleact.node import Node
    from turtleact.node.topics import Subscription

__all__ = ["AnyClient", "Goals", "HeldGoal", "Report"]

Report: TypeAlias = Callable[[float, float | None, str | None], Awaitable[None]]
"""A function that sends a progress message: a number that grows, a total, and a text."""

KEPT: Final = 64
"""How many feedback messages may wait to be reported. If there are more, the oldest are skipped."""

BURST: Final = 20
"""How many progress messages may come at once, before their rate is limited."""

FAREWELL: Final = 1.0
"""How long the last progress messages may take after the goal's end (s, event loop time)."""

AnyClient: TypeAlias = "ActionClient[Message, Message, Message]"

PATIENCE: Final = 0.5
"""How long to wait for latched messages (s, event loop time).

The time for `ROUND_TRIPS` network round trips is added.
"""

ROUND_TRIPS: Final = 5


class HeldGoal(NamedTuple):
    """A goal that a server holds.

    Attributes:
        goal_id: The 16 bytes of the goal's id.
        action: The name of the goal's action.
        status: The goal's state.
        stamp: When the goal was accepted (ns since the epoch, by the server's clock).
    """

    goal_id: bytes
    action: str
    status: GoalStatus
    stamp: int


class Goals:
    """Sends goals, limits how many are under way, and lists the goals that servers hold.

    Args:
        node: The node that sends the goals.
        actions: A function that returns the offered actions that have a server now, with their
            types.
        limits: How many goals and service calls may be under way, and how often feedback is
            reported.

    Attributes:
        active: How many goals and service calls are under way.
    """

    def __init__(
        self, node: Node, actions: Callable[[], dict[str, type[Action]]], limits: Limits
    ) -> None:
        self.active = 0
        self.limits = limits
        self._node = node
        self._actions = actions
        self._clients: dict[tuple[str, str], AnyClient] = {}
        self._topics: dict[str, Subscription[GoalStatusArray]] = {}

    def client(self, name: str, action_type: type[Action]) -> AnyClient:
        """Return the client of an action. It is created on first use, and closed with the node."""
        key = name, action_type.type_name
        client = self._clients.get(key)
        if client is None:
            known = cast("ActionType[Message, Message, Message]", action_type)
            client = self._clients[key] = self._node.action_client(known, name)
        return client

    @contextmanager
    def place(self) -> Iterator[None]:
        """Count one goal or service call as under way while a ``with`` block runs.

        Raises:
            TurtleactError: if the maximum number of concurrent goals and calls has been reached.
        """
        if self.active >= self.limits.goals:
            raise TurtleactError(
                f"{self.active} goals and calls are under way, which is the limit: wait until one "
                "has ended, or cancel one"
            )
        self.active += 1
        try:
            yield
        finally:
            self.active -= 1

    async def run(self, client: AnyClient, goal: Message, report: Report) -> CallToolResult:
        """Send a goal, report its feedback, and wait for the goal's end.

        Cancelling this call cancels the goal, and waits for the goal's end.
        """
        with self.place():
            reporter = _Reporter(report, self.limits.progress_rate)
            async with anyio.create_task_group() as beside:
                beside.start_soon(reporter.run)
                reply = await _follow(client, goal, reporter)
                reporter.end()
                beside.cancel_scope.deadline = anyio.current_time() + FAREWELL
            return reply

    async def held(self) -> list[HeldGoal]:
        """Return the goals that servers hold, in the order in which they were accepted."""
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

    async def find(self, goal_id: bytes) -> tuple[HeldGoal, AnyClient] | None:
        """Return a goal, and a client of its action; None if no server of an action holds it."""
        for goal in await self.held():
            action_type = self._actions().get(goal.action)
            if goal.goal_id == goal_id and action_type is not None:
                return goal, self.client(goal.action, action_type)
        return None

    async def _join(self) -> None:
        """Subscribe to the status topics of new actions, and wait for the latched messages.

        If an action no longer has a server, close the subscription to its status topic.
        """
        actions = self._actions()
        for gone in self._topics.keys() - actions.keys():
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


async def _follow(client: AnyClient, goal: Message, reporter: _Reporter) -> CallToolResult:
    try:
        sending = client.send_goal(goal, feedback_callback=reporter.take)
        async with sending as handle:
            outcome = await handle.outcome()
            return data_of(handle.goal_id, outcome, reporter.latest)
    except TurtleactError as error:  # rejected, not served, or the server has gone
        return failure(error)


class _Reporter:
    """Sends feedback to the client as progress messages, without delaying the goal's body.

    `take` puts feedback into a short queue, and `run` sends it. If the client reads slowly, or the
    body publishes feedback faster than ``rate`` allows, the oldest messages are skipped.

    Attributes:
        latest: The newest feedback.
    """

    def __init__(self, report: Report, rate: float) -> None:
        self.latest: Message | None = None
        self._report = report
        self._rate = rate
        self._count = 0
        self._waiting: deque[tuple[int, Message]] = deque(maxlen=KEPT)
        self._changed = anyio.Event()
        self._over = anyio.Event()

    def take(self, feedback: Any) -> None:  # noqa: ANN401  # of the action's class
        """Put a feedback message into the queue."""
        self.latest = feedback
        self._count += 1
        self._waiting.append((self._count, feedback))
        self._changed.set()

    def end(self) -> None:
        """Let `run` return as soon as it has sent the messages that are still in the queue."""
        self._over.set()
        self._changed.set()

    async def run(self) -> None:
        """Send feedback until `end` is called and the queue is empty."""
        while not (self._over.is_set() and not self._waiting):
            if self._waiting:
                count, feedback = self._waiting.popleft()
                await self._report(count, None, one_line(feedback))
                if count >= BURST:
                    await self._rest()
            else:
                self._changed = anyio.Event()
                await self._changed.wait()

    async def _rest(self) -> None:
        """Keep to the rate, and then skip all waiting messages but the newest."""
        with anyio.move_on_after(1 / self._rate):
            await self._over.wait()
        while len(self._waiting) > 1:
            self._waiting.popleft()
