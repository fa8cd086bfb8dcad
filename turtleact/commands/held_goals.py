"""The goals that the servers on the graph hold, as their status topics tell.

A server tells of its goals when one changes, and the last it has told is latched; one that never
had a goal may tell nothing. So what is latched is waited for, but not for long. What is latched may
also outlive a server that is stuck; so each is asked to cancel a goal that nobody has, which one
that works answers.

Source: rcl_action ``action_server.c`` for what is told and when.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import anyio

from turtleact.clock import within
from turtleact.commands.graph import names_like
from turtleact.commands.kinds import types_by_name
from turtleact.commands.stderr import note
from turtleact.errors import (
    ServerUnavailable,
    ServiceTimeout,
    TurtleactError,
    UsageError,
)
from turtleact.goal import GoalStatus, status_of
from turtleact.interfaces.stamps import nanoseconds
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, GoalStatusArray
from turtleact.names import action_names, resolve_name
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = [
    "STATUS_QOS",
    "HeldGoal",
    "find_goal",
    "find_goals",
    "goals_in",
    "held_goals",
    "served_actions",
    "silence",
]

STATUS_QOS = QoS(depth=100, durability="transient_local")

PATIENCE = 0.5
"""How long is waited for what is latched (s, by the clock of the graph)."""

ROUND_TRIPS = 5
"""So many more: who keeps it is to be found, and asked, perhaps by a router in between."""

ANSWER = 2.0
"""How long a server has to answer (s, likewise)."""


class HeldGoal(NamedTuple):
    """A goal that a server holds.

    Attributes:
        goal_id: Its 16 bytes.
        action: The action's name.
        type_name: Its type.
        status: Its state.
        stamp: When it was accepted (ns since the epoch, by the server's clock).
    """

    goal_id: bytes
    action: str
    type_name: str
    status: GoalStatus
    stamp: int


def served_actions(node: Node, name: str | None) -> dict[str, str]:
    """The actions that are served, with their types; one of them if a name is given.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        ServerUnavailable: if nobody serves an action of that name, with the nearest.
    """
    found = types_by_name(node.transport.endpoints(), "action", hidden=True)
    served = {each: types[0] for each, types in found.items()}
    if name is None:
        return served
    full_name = resolve_name(name)
    if full_name not in served:
        hint = names_like(full_name, served)
        raise ServerUnavailable(full_name, f"nobody serves it{hint}")
    return {full_name: served[full_name]}


async def held_goals(node: Node, actions: dict[str, str]) -> tuple[list[HeldGoal], list[str]]:
    """The goals of some actions, and which of their servers do not answer.

    Args:
        node: A node on the graph.
        actions: The actions, with their types.

    Returns:
        The goals in the order of their acceptance, and the nodes that do not answer.
    """
    found: dict[tuple[str, bytes], HeldGoal] = {}
    silent: set[str] = set()
    patience = PATIENCE + ROUND_TRIPS * node.transport.round_trip
    async with anyio.create_task_group() as asking:
        for server, action in _servers(node, actions).items():
            asking.start_soon(_ask, node, server, action, silent)
        async with within(patience, node.clock), anyio.create_task_group() as listening:
            for name, type_name in actions.items():
                listening.start_soon(_listen, node, name, type_name, found)
    goals = sorted(found.values(), key=lambda goal: (goal.stamp, goal.action, goal.goal_id))
    return goals, sorted(silent)


def silence(silent: list[str]) -> str:
    """What is said of nodes that do not answer."""
    if len(silent) == 1:
        return f"server {silent[0]} does not answer"
    return f"servers {', '.join(silent)} do not answer"


def goals_in(message: GoalStatusArray, action: str, type_name: str) -> Iterable[HeldGoal]:
    """The goals that a status message tells of."""
    for each in message.status_list:
        info = each.goal_info
        status = status_of(each.status)
        yield HeldGoal(info.goal_id.uuid, action, type_name, status, nanoseconds(info.stamp))


def find_goals(goals: Iterable[HeldGoal], wanted: str) -> HeldGoal | None:
    """The one goal whose id begins so, or None.

    Raises:
        UsageError: if there are several.
    """
    found = [goal for goal in goals if goal.goal_id.hex().startswith(wanted)]
    if len(found) > 1:
        shown = ", ".join(goal.goal_id.hex() for goal in found)
        raise UsageError(f"'{wanted}' is the beginning of several goals: {shown}")
    return found[0] if found else None


async def find_goal(node: Node, wanted: str) -> HeldGoal:
    """The one goal on the graph whose id begins so; if its server does not answer, that is noted.

    Raises:
        UsageError: if there are several.
        TurtleactError: if there is none.
    """
    goals, silent = await held_goals(node, served_actions(node, None))
    found = find_goals(goals, wanted)
    if found is None:
        hint = silence(silent) if silent else "'turtleact goals' lists what is held"
        raise TurtleactError(f"no server in reach holds a goal {wanted}; {hint}")
    stuck = [server for server in _servers(node, {found.action: ""}) if server in silent]
    if stuck:
        note(f"{silence(stuck)}; waiting for it")
    return found


async def _listen(
    node: Node, name: str, type_name: str, found: dict[tuple[str, bytes], HeldGoal]
) -> None:
    """Take the latched message of each server of an action."""
    topic = action_names(name).status
    subscription = node.subscription(GoalStatusArray, topic, STATUS_QOS)
    left = node.count_publishers(topic)
    try:
        while left > 0:
            message = await anext(subscription)
            left -= 1
            for goal in goals_in(message, name, type_name):
                found[name, goal.goal_id] = goal
    finally:
        await subscription.aclose()


def _servers(node: Node, actions: dict[str, str]) -> dict[str, str]:
    """The nodes that serve some actions, each with one of them."""
    services = {action_names(name).cancel_goal: name for name in actions}
    return {
        each.node: services[each.name]
        for each in node.transport.endpoints()
        if each.kind == "service" and each.name in services
    }


async def _ask(node: Node, server: str, action: str, silent: set[str]) -> None:
    """Ask a server to cancel a goal that nobody has: one that works answers, whatever it says."""
    client = node.service_client(CancelGoal, action_names(action).cancel_goal)
    try:
        await client.call(CancelGoal.Request(GoalInfo(UUID(uuid.uuid4().bytes))), ANSWER)
    except ServiceTimeout:
        silent.add(server)
    except TurtleactError:
        pass  # it was closed meanwhile, or answers with an error
    finally:
        await client.aclose()
