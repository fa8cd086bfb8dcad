"""Lists, cancels, pauses, resumes and watches goals that others have sent.

All of this except pausing and resuming works with any ROS 2 server: the status topic shows which
goals a server holds, ``cancel_goal`` cancels them, and ``get_result`` waits for their end. Only
servers of turtleact can pause goals; ROS 2 has no pauses.

A server publishes its status when a goal changes, and its last status message is latched. A server
that never had a goal may publish nothing. The commands therefore wait only a short time for latched
messages. A latched message may also arrive from a server that hangs. To find servers that hang, the
commands ask each server to cancel a goal that does not exist. A working server answers the request.

Source: the ROS 2 design article "Actions"; action_msgs/srv/CancelGoal; rcl_action
``action_server.c`` for the contents and times of messages.
"""

from __future__ import annotations

import json
import sys
import uuid
from collections.abc import Iterable
from contextlib import aclosing
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias, cast

import anyio

from turtleact.commands import graph
from turtleact.commands.goal_printer import (
    EXIT_STATUS,
    Followed,
    after_return,
    follow,
    watch_command,
)
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import duration, note, say_lines, say_names, say_table
from turtleact.commands.send_goal import choose_printer
from turtleact.errors import ServerUnavailable, ServiceTimeout, TurtleactError, UsageError
from turtleact.goals.state import CancelCode, GoalStatus, status_of
from turtleact.goals.wire import PausedGoals, SetPaused, paused_topic, set_paused_service
from turtleact.interfaces import SECOND, Action, nanoseconds
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, GoalStatusArray
from turtleact.names import action_names, resolve_name
from turtleact.tasks.clock import within
from turtleact.transports import QoS
from turtleact.transports.graph import types_by_name

if TYPE_CHECKING:
    from turtleact.commands.goal_printer import GoalPrinter, View
    from turtleact.commands.settings import ConnectOptions
    from turtleact.node import Node

__all__ = ["Change", "HeldGoal", "Selection", "change", "held_goals", "print_goals", "run"]

STATUS_QOS = QoS(depth=100, durability="transient_local")
"""The QoS of subscriptions to the states of goals.

Each server of an action latches one message. A new subscription may therefore receive many messages
at once.
"""

LATCHED = QoS(depth=1, durability="transient_local")

LATCHED_PATIENCE = 0.5
"""How long to wait for latched messages about states (s, by the clock of the graph)."""

PAUSED_PATIENCE = 0.2
"""How long to wait for latched messages about pauses, which only turtleact sends (s, likewise)."""

ROUND_TRIPS = 5
"""How many network round trips are added to each patience.

The node must find the publisher of a latched message, perhaps through a router, and then request
the message.
"""

ANSWER = 2.0
"""How long a server that works may take to answer, or to offer a service (s, likewise)."""

PATIENCE = 10.0
"""How long to wait for the answer to a request for a goal (s, likewise)."""

HEADINGS = ("id", "action", "state", "age", "client")

LEGEND = "client: ? means that the action still has a client, gone that it has none any more"

REASONS: Final[dict[int, str]] = {
    CancelCode.REJECTED: "the server refuses",
    CancelCode.UNKNOWN_GOAL_ID: "the server does not hold it any more",
    CancelCode.GOAL_TERMINATED: "it has ended",
}
"""Why a server does not cancel a goal, by the code in its answer."""

Change: TypeAlias = Literal["cancel", "pause", "resume"]

CHANGED: Final = {"cancel": "canceled", "pause": "paused", "resume": "resumed"}


class HeldGoal(NamedTuple):
    """A goal that a server holds.

    Attributes:
        goal_id: The goal's id, 16 bytes.
        action: The name of the action.
        type_name: The type of the action.
        status: The state of the goal.
        stamp: When the goal was accepted (ns since the epoch, by the server's clock).
        is_paused: Whether the goal is paused; False if this is not known.
    """

    goal_id: bytes
    action: str
    type_name: str
    status: GoalStatus
    stamp: int
    is_paused: bool = False


class Selection(NamedTuple):
    """Which goals a user means.

    Attributes:
        names: The beginnings of ids, and the full names of actions, each of which stands for its
            only running goal. With ``is_many``, names of actions only.
        is_many: Whether all running goals are meant: those of the actions in ``names`` or, if that
            is empty, of all actions.
        before: If this is not 0, only goals accepted up to this time are meant (ns since the epoch,
            by the servers' clocks).
    """

    names: list[str]
    is_many: bool = False
    before: int = 0


async def held_goals(node: Node, name: str | None = None) -> tuple[list[HeldGoal], list[str]]:
    """Find the goals of all actions or of one, and the servers that do not answer.

    Returns:
        The goals in the order of their acceptance, and the names of the nodes that do not answer.

    Raises:
        InvalidName: if ``name`` breaks ROS 2's rules for names.
        ServerUnavailable: if nobody serves the action ``name``. The error suggests other names.
    """
    types = types_by_name(node.transport.endpoints(), "action", hidden=True)
    if name is not None:
        name = resolve_name(name)
        if name not in types:
            raise graph.not_served(name, types)
        types = {name: types[name]}
    found: dict[tuple[str, bytes], HeldGoal] = {}
    silent: set[str] = set()
    async with anyio.create_task_group() as asking:
        for server, action in _servers(node, types).items():
            asking.start_soon(_ask, node, server, action, silent)
        # The status topics are read for a fixed time, as nobody says which message is the last one.
        # Meanwhile the servers are asked; each question has its own time limit.
        async with (
            within(_patience(node, LATCHED_PATIENCE), node.clock),
            anyio.create_task_group() as listening,
        ):
            for action, (type_name, *_) in types.items():
                listening.start_soon(_listen, node, action, type_name, found)
    goals = sorted(found.values(), key=lambda goal: (goal.stamp, goal.action, goal.goal_id))
    return goals, sorted(silent)


async def print_goals(node: Node, name: str | None, *, as_json: bool) -> int:
    """Print the goals that servers hold, and return the exit status.

    Args:
        node: A node on the graph.
        name: The name of the action; None for all actions.
        as_json: Whether to print one JSON object per line instead of a table.

    Raises:
        ServerUnavailable: if nobody serves the action.
    """
    goals, silent = await held_goals(node, name)
    now = node.clock.now()
    goals = await _with_pauses(node, goals)
    if as_json:
        say_lines(_as_json(node, goal, now) for goal in goals)
    elif goals:
        say_table([HEADINGS, *(_row(node, goal, now) for goal in goals)])
        if sys.stdout is not None and sys.stdout.isatty():
            note(LEGEND)
    elif not silent:
        note("no server in reach holds a goal")
    if silent:
        note(f"{_silence(silent)}: goals may be missing")
    return 1 if silent else 0


async def change(node: Node, selected: Selection, what: Change, timeout: float = 0.0) -> int:
    """Cancel, pause or resume goals, print what becomes of each, and return the exit status.

    All servers are asked at the same time, so that one that does not answer holds up no other.

    Args:
        node: A node on the graph.
        selected: The goals.
        what: What to do with them.
        timeout: How long a server waits for a goal's body to pause (s).

    Raises:
        UsageError: before any server is asked, if a text in ``selected`` fits several goals.
        ServerUnavailable: if nobody serves an action in ``selected``.
    """
    goals, silent = await held_goals(node)
    chosen = await _chosen(node, goals, selected, what)
    why = f"; {_silence(silent)}" if silent else ""
    problems = [_lack(text) + why for text, _ in chosen]

    async def ask(number: int, goal: HeldGoal) -> None:
        problems[number] = await _problem(node, goal, what, timeout)

    async with anyio.create_task_group() as asking:
        for number, (_, goal) in enumerate(chosen):
            if goal is not None:
                asking.start_soon(ask, number, goal)
    for (text, goal), problem in zip(chosen, problems, strict=True):
        _print_change(text, goal, what, problem)
    if selected.is_many and silent:
        note(f"{_silence(silent)}: some goals may not be {CHANGED[what]}")
    elif not chosen:
        note(f"there is no goal to {what}")
    return 1 if any(problems) or (selected.is_many and silent) else 0


async def _chosen(
    node: Node, goals: list[HeldGoal], selected: Selection, what: Change
) -> list[tuple[str, HeldGoal | None]]:
    """Return the selected goals, each with its id or the text that selects it."""
    if not selected.is_many:
        return [(name, _find(node, goals, name, " or --all")) for name in selected.names]
    meant = _all_of(node, goals, selected)
    if what == "resume":
        meant = [goal for goal in await _with_pauses(node, meant) if goal.is_paused]
    return [(goal.goal_id.hex(), goal) for goal in meant]


def _print_change(text: str, goal: HeldGoal | None, what: Change, problem: str) -> None:
    """Print what has become of one goal."""
    who = text if goal is None else f"{goal.goal_id.hex()} of {goal.action}"
    if problem:
        say_names(f"{who}: not {CHANGED[what]}: {problem}\n")
    else:
        say_names(f"{who}: {'canceling' if what == 'cancel' else CHANGED[what]}\n")


def run(reach: ConnectOptions, wanted: str, view: View | None, options: str) -> int:
    """Follow a goal to its end, print its result, and return the exit status.

    Args:
        reach: The graph.
        wanted: The beginning of the goal's id, or the full name of an action with one running goal.
        view: How to show the goal; None to print only its result.
        options: The command-line options for the graph and the interfaces, with a space before each
            option. If the server goes away, the error suggests a command with these options.

    Raises:
        UsageError: if ``wanted`` selects several goals.
        ServerUnavailable: if the server goes away.
        TurtleactError: if no server holds the goal, or this process does not know the action's
            type.
    """
    printer = choose_printer(
        view or "plain", wants_feedback=view is not None, wants_feedback_live=False
    )
    interrupts = Interrupts()
    interrupts.restore = printer.close
    return graph.run(reach, lambda node: _follow(node, wanted, printer, options), interrupts)


async def _follow(node: Node, wanted: str, printer: GoalPrinter, options: str) -> int:
    goal = await _find_one(node, wanted)
    action_type = await graph.chosen_class(node, "action", Action, goal.action, goal.type_name)
    client: Any = node.action_client(cast("Any", action_type), goal.action)
    age = (node.clock.now() - goal.stamp) / SECOND
    try:
        handle = await client.attach(goal.goal_id)
        printer.follows(Followed(node, goal.action, action_type, handle, age))
        outcome = await follow(printer, handle)
    except ServerUnavailable as error:
        error.hint = after_return(watch_command(goal.goal_id, options))
        raise
    return EXIT_STATUS[outcome.status]


async def _find_one(node: Node, wanted: str) -> HeldGoal:
    """Find the goal that ``wanted`` selects. If its server does not answer, print a note."""
    goals, silent = await held_goals(node)
    found = _find(node, goals, wanted)
    if found is None:
        goal = f"a running goal of {wanted}" if wanted.startswith("/") else f"a goal {wanted}"
        hint = _silence(silent) if silent else "'turtleact goals' lists all goals"
        raise TurtleactError(f"no server in reach holds {goal}; {hint}")
    stuck = [server for server in _servers(node, [found.action]) if server in silent]
    if stuck:
        note(f"{_silence(stuck)}; waiting for it")
    return found


def _find(node: Node, goals: Iterable[HeldGoal], wanted: str, others: str = "") -> HeldGoal | None:
    """Return the goal that an id's beginning or an action's full name selects, if there is one.

    Raises:
        UsageError: if several goals match ``wanted``. The error also offers ``others``.
        ServerUnavailable: if ``wanted`` is the name of an action that nobody serves.
    """
    if wanted.startswith("/"):
        found = _all_of(node, goals, Selection([wanted]))
        problem = f"action '{wanted}' has {len(found)} running goals, give one{others}"
    else:
        found = [goal for goal in goals if goal.goal_id.hex().startswith(wanted)]
        problem = f"'{wanted}' is the beginning of several goals"
    if len(found) > 1:
        raise UsageError(f"{problem}: {', '.join(goal.goal_id.hex() for goal in found)}")
    return found[0] if found else None


def _all_of(node: Node, goals: Iterable[HeldGoal], selected: Selection) -> list[HeldGoal]:
    """Return all running goals of the selected actions.

    Raises:
        ServerUnavailable: if nobody serves one of the actions.
    """
    served = types_by_name(node.transport.endpoints(), "action", hidden=True)
    for name in selected.names:
        if name not in served:
            raise graph.not_served(name, served)
    return [
        goal
        for goal in goals
        if goal.status.is_active
        and goal.action in (selected.names or served)
        and (not selected.before or goal.stamp <= selected.before)
    ]


def _lack(text: str) -> str:
    """Return why there is no goal for the beginning of an id, or for the name of an action."""
    return "it has no running goal" if text.startswith("/") else "no server in reach holds it"


def _silence(silent: list[str]) -> str:
    if len(silent) == 1:
        return f"server {silent[0]} does not answer"
    return f"servers {', '.join(silent)} do not answer"


# asking servers


def _patience(node: Node, seconds: float) -> float:
    return seconds + ROUND_TRIPS * node.transport.round_trip


async def _listen(
    node: Node, name: str, type_name: str, found: dict[tuple[str, bytes], HeldGoal]
) -> None:
    """Add the goals in the latched status messages of an action's servers to ``found``."""
    topic = action_names(name).status
    subscription = node.subscription(GoalStatusArray, topic, STATUS_QOS)
    servers = node.count_publishers(topic)
    async with aclosing(subscription):
        while servers > 0:
            message = await anext(subscription)
            for each in message.status_list:
                goal_id, stamp = each.goal_info.goal_id.uuid, nanoseconds(each.goal_info.stamp)
                goal = HeldGoal(goal_id, name, type_name, status_of(each.status), stamp)
                found[name, goal_id] = goal
            # A server whose goals change sends more messages, and no message says who sent it.
            # Several servers are therefore heard until the caller ends this.
            if servers == 1:
                break


async def _with_pauses(node: Node, goals: list[HeldGoal]) -> list[HeldGoal]:
    """Find out which goals are paused."""
    paused = set[bytes]()

    async def listen(action: str) -> None:
        subscription = node.subscription(PausedGoals, paused_topic(action), LATCHED)
        async with aclosing(subscription):
            message = await anext(subscription)
            paused.update(bytes(each.uuid) for each in message.goal_ids)

    async with (
        within(_patience(node, PAUSED_PATIENCE), node.clock),
        anyio.create_task_group() as listening,
    ):
        for action in {goal.action for goal in goals if goal.status.is_active}:
            listening.start_soon(listen, action)
    return [goal._replace(is_paused=goal.goal_id in paused) for goal in goals]


def _servers(node: Node, actions: Iterable[str]) -> dict[str, str]:
    """Return each node that serves any of these actions, with one action that the node serves."""
    services = {action_names(name).cancel_goal: name for name in actions}
    return {
        each.node: services[each.name]
        for each in node.transport.endpoints()
        if each.kind == "service" and each.name in services
    }


async def _ask(node: Node, server: str, action: str, silent: set[str]) -> None:
    """Ask a server to cancel a goal that does not exist.

    If the server does not answer, add its name to ``silent``.
    """
    try:
        await _cancel(node, action, uuid.uuid4().bytes, ANSWER)
    except ServiceTimeout:
        silent.add(server)
    except TurtleactError:
        pass  # it has been closed, or answers with an error


async def _problem(node: Node, goal: HeldGoal, what: Change, timeout: float) -> str:
    """Cancel, pause or resume a goal. Return why this failed; empty if it did not."""
    if goal.status.is_terminal:
        return f"it has ended {goal.status.name}"
    try:
        if what == "cancel":
            response = await _cancel(node, goal.action, goal.goal_id, PATIENCE)
            return REASONS.get(response.return_code, "")
        return await _set_paused(node, goal, is_paused=what == "pause", timeout=timeout)
    except ServiceTimeout:
        return "the server does not answer"
    except ServerUnavailable as error:
        return error.problem


async def _cancel(node: Node, action: str, goal_id: bytes, timeout: float) -> CancelGoal.Response:
    """Send a cancel request, and return the response. Raises the errors of the service client."""
    async with aclosing(
        node.service_client(CancelGoal, action_names(action).cancel_goal)
    ) as client:
        return await client.call(CancelGoal.Request(GoalInfo(UUID(goal_id))), timeout)


async def _set_paused(node: Node, goal: HeldGoal, *, is_paused: bool, timeout: float) -> str:
    """Pause or resume a goal, and wait until its server has done so. Return why it does not."""
    async with aclosing(node.service_client(SetPaused, set_paused_service(goal.action))) as client:
        if not await client.wait_for_service(ANSWER):
            return "its server does not offer that; is it a server of turtleact?"
        request = SetPaused.Request(UUID(goal.goal_id), is_paused, timeout)
        response = await client.call(request, timeout + PATIENCE)
        return "" if response.success else response.message


# the list of goals


def _row(node: Node, goal: HeldGoal, now: int) -> tuple[str, ...]:
    # Even a single client may be the wrong one: the sender may have left, and its name with it.
    client = "?" if _clients(node, goal.action) else "gone"
    age = duration((now - goal.stamp) / SECOND)
    state = f"{goal.status.name}{' (paused)' * goal.is_paused}"
    return goal.goal_id.hex(), goal.action, state, age, client


def _as_json(node: Node, goal: HeldGoal, now: int) -> str:
    sec, nanosec = divmod(goal.stamp, SECOND)
    return json.dumps(
        {
            "id": goal.goal_id.hex(),
            "action": goal.action,
            "type": goal.type_name,
            "state": goal.status.name,
            "is_paused": goal.is_paused,
            "stamp": {"sec": sec, "nanosec": nanosec},
            "age": (now - goal.stamp) / SECOND,
            "clients": _clients(node, goal.action),
        }
    )


def _clients(node: Node, action: str) -> list[str]:
    """Return the nodes that have a client of the action, because each may have sent the goal."""
    service = action_names(action).send_goal
    return sorted(
        {
            each.node
            for each in node.transport.endpoints()
            if each.kind == "client" and each.name == service
        }
    )
