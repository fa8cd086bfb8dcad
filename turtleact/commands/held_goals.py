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
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import anyio

from turtleact.commands import graph, send_goal
from turtleact.commands.graph import interface_class, not_served
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import duration, note, say, say_names, say_table
from turtleact.commands.transcript import Followed, after_return, watch_command
from turtleact.errors import (
    PauseRefused,
    ServerUnavailable,
    ServiceTimeout,
    TurtleactError,
    UsageError,
)
from turtleact.goals.state import CancelCode, GoalStatus, status_of
from turtleact.goals.wire import PausedGoals, SetPaused, paused_topic, set_paused_service
from turtleact.graph import types_by_name
from turtleact.interfaces import (
    SECOND,
    Action,
    Message,
    nanoseconds,
    stamp_of,
)
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, GoalStatusArray
from turtleact.names import action_names, resolve_name
from turtleact.tasks.clock import within
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach
    from turtleact.commands.transcript import Transcript, View
    from turtleact.node import Node

__all__ = [
    "STATUS_QOS",
    "HeldGoal",
    "cancel",
    "cancel_many",
    "find_goal",
    "find_goals",
    "follow",
    "goals_in",
    "held_goals",
    "print_goals",
    "run",
    "served_actions",
    "silence",
    "switch",
    "switch_all",
]

STATUS_QOS = QoS(depth=100, durability="transient_local")
"""The QoS of subscriptions to the states of goals.

Each server of an action latches one message. A new subscription may therefore receive many messages
at once.
"""

LATCHED_PATIENCE = 0.5
"""How long to wait for latched messages (s, by the clock of the graph)."""

ROUND_TRIPS = 5
"""How many network round trips are added to `LATCHED_PATIENCE`.

The node must find the publisher of a latched message, perhaps through a router, and then request
the message.
"""

ANSWER = 2.0
"""How long to wait for a server's answer (s, by the clock of the graph)."""


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


def served_actions(node: Node, name: str | None) -> dict[str, str]:
    """Return the actions on the graph that have a server, with their types.

    With ``name``, return only this action.

    Raises:
        InvalidName: if ``name`` breaks ROS 2's rules for names.
        ServerUnavailable: if nobody serves the action ``name``. The error suggests other names.
    """
    found = types_by_name(node.transport.endpoints(), "action", hidden=True)
    served = {each: types[0] for each, types in found.items()}
    if name is None:
        return served
    full_name = resolve_name(name)
    if full_name not in served:
        raise not_served(full_name, served)
    return {full_name: served[full_name]}


async def held_goals(node: Node, actions: dict[str, str]) -> tuple[list[HeldGoal], list[str]]:
    """Find the goals of some actions, and the servers that do not answer.

    Args:
        node: A node on the graph.
        actions: The names of the actions, with their types.

    Returns:
        The goals in the order of their acceptance, and the names of the nodes that do not answer.
    """
    found: dict[tuple[str, bytes], HeldGoal] = {}
    silent: set[str] = set()
    patience = LATCHED_PATIENCE + ROUND_TRIPS * node.transport.round_trip
    async with anyio.create_task_group() as asking:
        for server, action in _servers(node, actions).items():
            asking.start_soon(_ask, node, server, action, silent)
        # The status topics are read for a fixed time, as nobody says which message is the last one.
        # Meanwhile the servers are asked; each question has its own time limit.
        async with within(patience, node.clock), anyio.create_task_group() as listening:
            for name, type_name in actions.items():
                listening.start_soon(_listen, node, name, type_name, found)
    goals = sorted(found.values(), key=lambda goal: (goal.stamp, goal.action, goal.goal_id))
    return goals, sorted(silent)


def silence(silent: list[str]) -> str:
    """Return a text that says which servers do not answer."""
    if len(silent) == 1:
        return f"server {silent[0]} does not answer"
    return f"servers {', '.join(silent)} do not answer"


def goals_in(message: GoalStatusArray, action: str, type_name: str) -> Iterable[HeldGoal]:
    """Yield the goals in a status message."""
    for each in message.status_list:
        info = each.goal_info
        status = status_of(each.status)
        yield HeldGoal(info.goal_id.uuid, action, type_name, status, nanoseconds(info.stamp))


def find_goals(goals: Iterable[HeldGoal], wanted: str) -> HeldGoal | None:
    """Return the goal with an id that begins with ``wanted``; None if there is none.

    Raises:
        UsageError: if the ids of several goals begin with ``wanted``.
    """
    found = [goal for goal in goals if goal.goal_id.hex().startswith(wanted)]
    if len(found) > 1:
        shown = ", ".join(goal.goal_id.hex() for goal in found)
        raise UsageError(f"'{wanted}' is the beginning of several goals: {shown}")
    return found[0] if found else None


async def find_goal(node: Node, wanted: str) -> HeldGoal:
    """Find the goal on the graph with an id that begins with ``wanted``.

    If ``wanted`` begins with a slash, it is the name of an action, and the action's only running
    goal is found. If the goal's server does not answer, a note is printed.

    Raises:
        UsageError: if several goals match ``wanted``.
        ServerUnavailable: if ``wanted`` is the name of an action that nobody serves.
        TurtleactError: if no goal matches ``wanted``.
    """
    is_name = wanted.startswith("/")
    goals, silent = await held_goals(node, served_actions(node, wanted if is_name else None))
    found = _running_goal(goals, wanted) if is_name else find_goals(goals, wanted)
    if found is None:
        goal = f"a running goal of {wanted}" if is_name else f"a goal {wanted}"
        hint = silence(silent) if silent else "'turtleact goals' lists all goals"
        raise TurtleactError(f"no server in reach holds {goal}; {hint}")
    stuck = [server for server in _servers(node, {found.action: ""}) if server in silent]
    if stuck:
        note(f"{silence(stuck)}; waiting for it")
    return found


def _selected(node: Node, goals: list[HeldGoal], wanted: str) -> HeldGoal | None:
    """Return the goal that ``wanted`` selects, as for `find_goal`; None if there is none.

    Raises:
        UsageError: if several goals match ``wanted``.
        ServerUnavailable: if ``wanted`` is the name of an action that nobody serves.
    """
    if not wanted.startswith("/"):
        return find_goals(goals, wanted)
    return _running_goal(
        [each for each in goals if each.action in served_actions(node, wanted)], wanted
    )


def _running_goal(goals: Iterable[HeldGoal], action: str) -> HeldGoal | None:
    running = [goal for goal in goals if goal.status.is_active]
    if len(running) > 1:
        shown = ", ".join(goal.goal_id.hex() for goal in running)
        raise UsageError(f"action '{action}' has {len(running)} running goals, give one: {shown}")
    return running[0] if running else None


DONE, NOT_DONE, ABORTED, CANCELED = 0, 1, 4, 5
"""Exit statuses."""

HEADINGS = ("id", "action", "state", "age", "client")

LEGEND = "client: ? means that the action still has a client, gone that it has none any more"

NOBODY = bytes(16)
"""The id that means every goal in a cancel request."""

PATIENCE = 10.0
"""How long to wait for the answer to a cancel request (s, by the clock of the graph)."""

SILENT = "the server does not answer"


# goals


async def print_goals(node: Node, name: str | None, *, as_json: bool) -> int:
    """Print the goals that servers hold, and return the exit status.

    Args:
        node: A node on the graph.
        name: The name of the action; None for all actions.
        as_json: Whether to print one JSON object per line instead of a table.

    Raises:
        ServerUnavailable: if nobody serves the action.
    """
    goals, silent = await held_goals(node, served_actions(node, name))
    now = node.clock.now()
    paused = await _paused_goals(node, {each.action for each in goals if each.status.is_active})
    goals = [goal._replace(is_paused=goal.goal_id in paused) for goal in goals]
    if as_json:
        say("".join(f"{_as_json(node, goal, now)}\n" for goal in goals))
    elif goals:
        say_table([HEADINGS, *(_row(node, goal, now) for goal in goals)])
        if sys.stdout is not None and sys.stdout.isatty():
            note(LEGEND)
    elif not silent:
        note("no server in reach holds a goal")
    if silent:
        note(f"{silence(silent)}: goals may be missing")
    return NOT_DONE if silent else DONE


# cancel


async def cancel(node: Node, wanted: Sequence[str]) -> int:
    """Cancel the goals whose ids begin with the texts in ``wanted``, and print each outcome.

    Raises:
        UsageError: before any goal is canceled, if several ids begin with the same text in
            ``wanted``.
    """
    goals, silent = await held_goals(node, served_actions(node, None))
    status = DONE
    for found, text in [(_selected(node, goals, text), text) for text in wanted]:
        if found is None:
            holds_not = "no server in reach holds it"
            problem: str | None = f"{holds_not}; {silence(silent)}" if silent else holds_not
        elif found.status.is_terminal:
            problem = f"it has ended {found.status.name}"
        else:
            problem = await _why_not_canceling(node, found)
        _tell(found.goal_id.hex() if found else text, found.action if found else "", problem)
        status = NOT_DONE if problem else status
    return status


async def cancel_many(node: Node, name: str | None, before: int) -> int:
    """Cancel all goals, or only the goals accepted until a given time, and print each outcome.

    Args:
        node: A node on the graph.
        name: The name of the action; None for all actions.
        before: The given time (ns since the epoch, by the servers' clocks); 0 for all goals.

    Raises:
        ServerUnavailable: if nobody serves the action.
    """
    goals, silent = await held_goals(node, served_actions(node, name))
    meant = [
        goal for goal in goals if goal.status.is_active and (not before or goal.stamp <= before)
    ]
    status = DONE
    for action in sorted({goal.action for goal in meant}):
        response = await _request(node, action, NOBODY, before)
        accepted = [] if response is None else response.goals_canceling
        canceling = {bytes(info.goal_id.uuid) for info in accepted}
        why = SILENT if response is None else "the server refuses, or it has ended"
        for goal in meant:
            if goal.action != action:
                continue
            refused = goal.goal_id not in canceling and goal.status is not GoalStatus.CANCELING
            _tell(goal.goal_id.hex(), action, why if refused else None)
            status = NOT_DONE if refused else status
    if silent:
        note(f"{silence(silent)}: some goals may not be canceled")
        return NOT_DONE
    if not meant:
        note("there is no goal to cancel")
    return status


# watch, result


def run(reach: Reach, wanted: str, view: View | None, options: str) -> int:
    """Follow a goal to its end and return the exit status; see `follow`.

    Without a view, only the result is printed.
    """
    transcript = send_goal.choose_transcript(
        view or "plain", wants_feedback=view is not None, wants_feedback_live=False
    )
    interrupts = Interrupts()
    interrupts.restore = transcript.close

    async def look(node: Node) -> int:
        return await follow(node, wanted, transcript, options)

    try:
        return graph.run(reach, look, interrupts)
    finally:
        transcript.close()


async def follow(node: Node, wanted: str, transcript: Transcript, options: str) -> int:
    """Wait for the end of a goal, print its result, and return the exit status.

    Args:
        node: A node on the graph.
        wanted: The beginning of the goal's id, or the full name of an action with one running goal.
        transcript: The object that prints what happens to the goal.
        options: The command-line options for the graph and the interfaces, with a space before each
            option. If the server goes away, the error suggests a command with these options.

    Raises:
        UsageError: if ``wanted`` selects several goals.
        ServerUnavailable: if the server goes away.
        TurtleactError: if no server holds the goal, or this process does not know the action's
            type.
    """
    goal = await find_goal(node, wanted)
    action_type = interface_class(Action, goal.type_name, f"action '{goal.action}'")
    client: Any = node.action_client(cast("Any", action_type), goal.action)
    age = (node.clock.now() - goal.stamp) / SECOND
    try:
        handle = await client.attach(goal.goal_id)
        transcript.follows(Followed(node, goal.action, action_type, handle, age))
        outcome = await send_goal.follow(transcript, handle)
    except ServerUnavailable as error:
        error.hint = after_return(watch_command(goal.goal_id, options))
        raise
    return {GoalStatus.ABORTED: ABORTED, GoalStatus.CANCELED: CANCELED}.get(outcome.status, DONE)


async def switch(node: Node, wanted: Sequence[str], *, is_paused: bool, timeout: float) -> int:
    """Pause or resume the goals whose ids begin with the texts in ``wanted``.

    The outcome for each goal is printed.

    Raises:
        UsageError: before any goal is paused or resumed, if several ids begin with the same text in
            ``wanted``.
    """
    goals, silent = await held_goals(node, served_actions(node, None))
    status = DONE
    for found, text in [(_selected(node, goals, text), text) for text in wanted]:
        if found is None:
            problem = "no server in reach holds it"
            problem = f"{problem}; {silence(silent)}" if silent else problem
            say_names(f"{text}: {_pause_word(is_paused=is_paused, problem=problem)}\n")
            status = NOT_DONE
        elif await _switch(node, found, is_paused=is_paused, timeout=timeout):
            status = NOT_DONE
    return status


async def switch_all(node: Node, name: str | None, *, is_paused: bool, timeout: float) -> int:
    """Pause or resume all goals of an action, or of all actions, and print the outcome of each.

    The requests for all goals are sent at the same time.

    Raises:
        ServerUnavailable: if nobody serves the action.
    """
    goals, silent = await held_goals(node, served_actions(node, name))
    goals = [goal for goal in goals if goal.status.is_active]
    if not is_paused:
        paused = await _paused_goals(node, {goal.action for goal in goals})
        goals = [goal for goal in goals if goal.goal_id in paused]
    problems = list[str]()

    async def try_to(goal: HeldGoal) -> None:
        problem = await _switch(node, goal, is_paused=is_paused, timeout=timeout)
        problems.extend([problem] if problem else [])

    async with anyio.create_task_group() as group:
        for goal in goals:
            group.start_soon(try_to, goal)
    if silent:
        note(f"{silence(silent)}: goals may be missing")
    elif not goals:
        note(f"there is no goal to {'pause' if is_paused else 'resume'}")
    return NOT_DONE if problems or silent else DONE


async def _listen(
    node: Node, name: str, type_name: str, found: dict[tuple[str, bytes], HeldGoal]
) -> None:
    """Add the goals in the latched status messages of an action's servers to ``found``."""
    topic = action_names(name).status
    subscription = node.subscription(GoalStatusArray, topic, STATUS_QOS)
    servers = node.count_publishers(topic)
    try:
        while servers > 0:
            message = await anext(subscription)
            for goal in goals_in(message, name, type_name):
                found[name, goal.goal_id] = goal
            # A server whose goals change sends more messages, and no message says who sent it.
            # Several servers are therefore heard until the caller ends this.
            if servers == 1:
                break
    finally:
        await subscription.aclose()


def _servers(node: Node, actions: dict[str, str]) -> dict[str, str]:
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
    client = node.service_client(CancelGoal, action_names(action).cancel_goal)
    try:
        await client.call(CancelGoal.Request(GoalInfo(UUID(uuid.uuid4().bytes))), ANSWER)
    except ServiceTimeout:
        silent.add(server)
    except TurtleactError:
        pass  # it has been closed, or answers with an error
    finally:
        await client.aclose()


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


async def _why_not_canceling(node: Node, goal: HeldGoal) -> str | None:
    """Ask a server to cancel a goal. Return the reason if the request failed, otherwise None."""
    response = await _request(node, goal.action, goal.goal_id, 0)
    if response is None:
        return SILENT
    reasons: dict[int, str] = {
        CancelCode.REJECTED: "the server refuses",
        CancelCode.UNKNOWN_GOAL_ID: "the server does not hold it any more",
        CancelCode.GOAL_TERMINATED: "it has ended",
    }
    return reasons.get(response.return_code)


async def _request(
    node: Node, action: str, goal_id: bytes, stamp: int
) -> CancelGoal.Response | None:
    """Send a cancel request, and return the response; None if the server does not answer."""
    client = node.service_client(CancelGoal, action_names(action).cancel_goal)
    info = GoalInfo(UUID(goal_id), stamp_of(stamp))
    response: CancelGoal.Response | None = None
    try:
        response = await _call(client, action, CancelGoal.Request(info), PATIENCE)
    except ServiceTimeout:
        pass
    finally:
        await client.aclose()
    return response


def _tell(goal_id: str, action: str, problem: str | None) -> None:
    who = f"{goal_id} of {action}" if action else goal_id
    say_names(f"{who}: {f'not canceled: {problem}' if problem else 'canceling'}\n")


async def _call(client: Any, action: str, request: Message, timeout: float) -> Any:  # noqa: ANN401  # of whatever type
    """Call a service of an action. If the server goes away, the error names the action."""
    try:
        return await client.call(request, timeout)
    except ServerUnavailable as error:
        raise ServerUnavailable(action, error.problem) from None


async def _switch(node: Node, goal: HeldGoal, *, is_paused: bool, timeout: float) -> str:
    """Pause or resume a goal, and print the outcome. Return the problem; empty if there is none."""
    problem = ""
    if goal.status.is_terminal:
        problem = f"it has ended {goal.status.name}"
    else:
        try:
            await _set_paused(node, goal.action, goal.goal_id, is_paused=is_paused, timeout=timeout)
        except PauseRefused as refused:
            problem = refused.reason
        except TurtleactError as error:
            problem = str(error)
    word = _pause_word(is_paused=is_paused, problem=problem)
    say_names(f"{goal.goal_id.hex()} of {goal.action}: {word}\n")
    return problem


def _pause_word(*, is_paused: bool, problem: str) -> str:
    word = "paused" if is_paused else "resumed"
    return f"not {word}: {problem}" if problem else word


PAUSE_ANSWER = 10.0
"""How long the server may take to answer, in addition to the body's time to pause.

In seconds, by the clock of the graph.
"""

OFFERED_WITHIN = 2.0
"""How long a server may take to offer the service (s, by the clock of the graph)."""

TOLD_WITHIN = 0.2
"""How long to wait for the message with the paused goals (s, by the clock of the graph).

The time for `ROUND_TRIPS` is added. Servers without turtleact do not publish this message.
"""

LATCHED = QoS(depth=1, durability="transient_local")


async def _paused_goals(node: Node, actions: Iterable[str]) -> frozenset[bytes]:
    """Return the ids of all paused goals of these actions."""
    found = set[bytes]()

    async def listen(action: str) -> None:
        subscription = node.subscription(PausedGoals, paused_topic(action), LATCHED)
        try:
            message = await anext(subscription)
            found.update(bytes(each.uuid) for each in message.goal_ids)
        finally:
            await subscription.aclose()

    patience = TOLD_WITHIN + ROUND_TRIPS * node.transport.round_trip
    async with within(patience, node.clock), anyio.create_task_group() as listening:
        for action in actions:
            listening.start_soon(listen, action)
    return frozenset(found)


async def _set_paused(
    node: Node, action: str, goal_id: bytes, *, is_paused: bool, timeout: float
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
        response = await client.call(request, timeout + PAUSE_ANSWER)
    except ServiceTimeout:
        raise PauseRefused("the server does not answer") from None
    finally:
        await client.aclose()
    if not response.success:
        raise PauseRefused(response.message)
