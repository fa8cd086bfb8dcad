"""Tools for testing actions: virtual time, a call that runs a goal, and an unreliable transport.

This package uses nodes, clocks and transports, but no simulated world and no particular action.
``turtleact.testing.plugin`` is the pytest plug-in, and the only module that imports pytest.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Generic, NamedTuple, TypeVar, overload

from turtleact.goals.body import ActionDeclaration
from turtleact.goals.client import ActionClient, Outcome
from turtleact.interfaces import Message
from turtleact.node import ActionServer, open_node
from turtleact.tasks import wait_until_idle
from turtleact.testing.faults import Faults, FaultyTransport
from turtleact.testing.time import run, virtual_backend

__all__ = [
    "Faults",
    "FaultyTransport",
    "GoalRun",
    "run",
    "run_goal",
    "virtual_backend",
    "wait_until_idle",
]

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class GoalRun(NamedTuple, Generic[R, F]):
    """The feedback and the outcome of a goal.

    Attributes:
        feedbacks: All feedback, in order.
        outcome: How the goal ended: status, result, reason.
    """

    feedbacks: list[F]
    outcome: Outcome[R]


@overload
async def run_goal(action: ActionServer[G, R, F], goal: G) -> GoalRun[R, F]: ...


@overload
async def run_goal(action: ActionDeclaration[..., object], goal: Message) -> GoalRun[Any, Any]: ...


async def run_goal(action: Any, goal: Message) -> GoalRun[Any, Any]:
    """Send a goal and wait for its end.

    If the goal ends ABORTED or CANCELED, this raises no error. Cancelling: cancels the goal and
    waits for its end.

    Args:
        action: An open server, or an action declared with `turtleact.action`. A declared action is
            served on a new node, which is alone on its graph.
        goal: The goal message.

    Returns:
        All feedback of the goal, and its outcome.

    Raises:
        InvalidGoal: if a value does not fit its type.
        ServerUnavailable: if the server is closed.
        GoalRejected: if the server rejects the goal.
    """
    async with _client(action) as client, client.send_goal(goal) as handle:
        feedbacks = [feedback async for feedback in handle]
        return GoalRun(feedbacks, await handle.outcome())


@asynccontextmanager
async def _client(
    action: ActionServer[Message, Message, Message] | ActionDeclaration[..., object],
) -> AsyncIterator[ActionClient[Message, Message, Message]]:
    if isinstance(action, ActionDeclaration):
        async with open_node("run_goal") as node:
            node.serve(action)
            yield node.action_client(action.action_type, action.name)
        return
    client = action.node.action_client(action.action_type, action.name)
    try:
        yield client
    finally:
        await client.aclose()
