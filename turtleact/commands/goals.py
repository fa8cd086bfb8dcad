"""``goals``, ``cancel``, ``watch``, ``result`` and ``action echo``: goals that others have sent.

All goes through the endpoints of an action that any ROS 2 peer has: the status topic says which
goals a server holds, ``cancel_goal`` cancels them, ``get_result`` waits for their end.

Source: the ROS 2 design article "Actions"; action_msgs/srv/CancelGoal.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import anyio

from turtleact.client import Outcome
from turtleact.commands.echo import yaml_lines
from turtleact.commands.graph import interface_class, say_names
from turtleact.commands.held_goals import (
    STATUS_QOS,
    HeldGoal,
    find_goal,
    find_goals,
    goals_in,
    held_goals,
    served_actions,
)
from turtleact.commands.stderr import note
from turtleact.commands.transcript import PlainTranscript, say
from turtleact.errors import UnknownGoal
from turtleact.goal import CancelCode, GoalStatus
from turtleact.interfaces import Action, Implied, Message, implied, to_dict
from turtleact.interfaces.stamps import SECOND, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, GoalStatusArray
from turtleact.names import action_names
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.commands.transcript import Transcript
    from turtleact.node import Node
    from turtleact.topics import Subscription

__all__ = ["cancel", "cancel_many", "echo", "follow", "print_goals"]

FEEDBACK_QOS = QoS(depth=1000)

DONE, NOT_DONE, ABORTED, CANCELED = 0, 1, 4, 5
"""Exit statuses."""

HEADINGS = ("id", "action", "state", "age", "client")

NOBODY = bytes(16)
"""The id that names no goal."""


# goals


async def print_goals(node: Node, name: str | None, *, as_json: bool) -> int:
    """Print the goals that servers hold, as a table or as JSON.

    Args:
        node: A node on the graph.
        name: The action; all if None.
        as_json: Whether to print one JSON object a line.

    Raises:
        ServerUnavailable: if nobody serves an action of that name.
    """
    goals = await held_goals(node, served_actions(node, name))
    now = node.clock.now()
    if as_json:
        say("".join(f"{_as_json(node, goal, now)}\n" for goal in goals))
    elif goals:
        rows = [HEADINGS, *(_row(node, goal, now) for goal in goals)]
        say_names("".join(f"{line}\n" for line in _aligned(rows)))
    else:
        note("no server in reach holds a goal")
    return DONE


def _row(node: Node, goal: HeldGoal, now: int) -> tuple[str, ...]:
    clients = _clients(node, goal.action)
    client = clients[0] if len(clients) == 1 else f"one of {len(clients)}" if clients else "gone"
    age = _duration((now - goal.stamp) / SECOND)
    return goal.goal_id.hex(), goal.action, goal.status.name, age, client


def _as_json(node: Node, goal: HeldGoal, now: int) -> str:
    sec, nanosec = divmod(goal.stamp, SECOND)
    return json.dumps(
        {
            "id": goal.goal_id.hex(),
            "action": goal.action,
            "type": goal.type_name,
            "state": goal.status.name,
            "stamp": {"sec": sec, "nanosec": nanosec},
            "age": (now - goal.stamp) / SECOND,
            "clients": _clients(node, goal.action),
        }
    )


def _clients(node: Node, action: str) -> list[str]:
    """The nodes that may have sent a goal: ROS 2 does not say which of them has."""
    service = action_names(action).send_goal
    return sorted(
        {
            each.node
            for each in node.transport.endpoints()
            if each.kind == "client" and each.name == service
        }
    )


def _duration(seconds: float) -> str:
    """A time in the two largest units that it fills."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(map(str.ljust, row, widths)).rstrip()


# cancel


async def cancel(node: Node, wanted: Sequence[str]) -> int:
    """Cancel goals by the beginnings of their ids; print of each what came of it.

    Raises:
        UsageError: if several goals begin so; nothing was canceled.
    """
    goals = await held_goals(node, served_actions(node, None))
    status = DONE
    for found, text in [(find_goals(goals, text), text) for text in wanted]:
        if found is None:
            problem: str | None = "no server in reach holds it"
        elif found.status.is_terminal:
            problem = f"it has ended {found.status.name}"
        else:
            problem = await _why_not_canceling(node, found)
        _tell(found.goal_id.hex() if found else text, found.action if found else "", problem)
        status = NOT_DONE if problem else status
    return status


async def cancel_many(node: Node, name: str | None, before: int) -> int:
    """Cancel all goals, or those accepted up to a moment; print of each what came of it.

    Args:
        node: A node on the graph.
        name: The action; all if None.
        before: The moment (ns since the epoch, by the servers' clocks); 0 for all goals.

    Raises:
        ServerUnavailable: if nobody serves an action of that name.
    """
    actions = served_actions(node, name)
    meant = [
        goal
        for goal in await held_goals(node, actions)
        if goal.status.is_active and (not before or goal.stamp <= before)
    ]
    status = DONE
    for action in sorted({goal.action for goal in meant}):
        response = await _request(node, action, NOBODY, before)
        canceling = {bytes(info.goal_id.uuid) for info in response.goals_canceling}
        for goal in meant:
            if goal.action != action:
                continue
            refused = goal.goal_id not in canceling and goal.status is not GoalStatus.CANCELING
            _tell(
                goal.goal_id.hex(),
                action,
                "the server refuses, or it has ended" if refused else None,
            )
            status = NOT_DONE if refused else status
    if not meant:
        note("there is no goal to cancel")
    return status


async def _why_not_canceling(node: Node, goal: HeldGoal) -> str | None:
    """Ask for one goal to be canceled; why it is not, or None if it is."""
    response = await _request(node, goal.action, goal.goal_id, 0)
    reasons: dict[int, str] = {
        CancelCode.REJECTED: "the server refuses",
        CancelCode.UNKNOWN_GOAL_ID: "the server does not hold it any more",
        CancelCode.GOAL_TERMINATED: "it has ended",
    }
    return reasons.get(response.return_code)


async def _request(node: Node, action: str, goal_id: bytes, stamp: int) -> CancelGoal.Response:
    client = node.service_client(CancelGoal, action_names(action).cancel_goal)
    info = GoalInfo(UUID(goal_id), stamp_of(stamp))
    try:
        return await client.call(CancelGoal.Request(info))
    finally:
        await client.aclose()


def _tell(goal_id: str, action: str, problem: str | None) -> None:
    who = f"{goal_id} of {action}" if action else goal_id
    say_names(f"{who}: {f'not canceled: {problem}' if problem else 'canceling'}\n")


# watch, result


async def follow(node: Node, wanted: str, *, with_feedback: bool) -> int:
    """Wait for the end of a goal, and print its result; the exit status says how it ended.

    Args:
        node: A node on the graph.
        wanted: The beginning of its id.
        with_feedback: Whether to print the feedback that comes meanwhile.

    Raises:
        UsageError: if several goals begin so.
        UnknownGoal: if no server holds it.
        TurtleactError: if the action's type is not known here.
    """
    goal = await find_goal(node, wanted)
    action_type = interface_class(Action, goal.type_name, f"action '{goal.action}'")
    kinds, names = implied(action_type), action_names(goal.action)
    transcript = PlainTranscript(wants_feedback=with_feedback)
    feedback = node.subscription(kinds.feedback_message, names.feedback, FEEDBACK_QOS)
    client: Any = node.service_client(kinds.get_result, names.get_result)
    async with anyio.create_task_group() as beside:
        if with_feedback:
            beside.start_soon(_tell_feedback, feedback, goal.goal_id, transcript)
        response = await client.call(kinds.get_result.Request(goal_id=UUID(goal.goal_id)))
        await feedback.aclose()  # what has come is told, and then the telling ends
    status = GoalStatus(response.status)
    if status is GoalStatus.UNKNOWN:
        raise UnknownGoal(f"'{goal.action}' holds no goal {goal.goal_id.hex()} any more")
    transcript.ended(Outcome(status, response.result))
    return {GoalStatus.ABORTED: ABORTED, GoalStatus.CANCELED: CANCELED}.get(status, DONE)


async def _tell_feedback(
    messages: Subscription[Any], goal_id: bytes, transcript: Transcript
) -> None:
    async for message in messages:
        if message.goal_id.uuid == goal_id:
            transcript.feedback(message.feedback)


# action echo


async def echo(node: Node, name: str) -> int:
    """Print the feedback and the states of all goals of an action; ends with the node.

    Raises:
        ServerUnavailable: if nobody serves an action of that name.
        TurtleactError: if its type is not known here.
    """
    [(full_name, type_name)] = served_actions(node, name).items()
    action_type = interface_class(Action, type_name, f"action '{full_name}'")
    kinds: Implied = implied(action_type)
    names = action_names(full_name)
    async with anyio.create_task_group() as telling:
        statuses = node.subscription(GoalStatusArray, names.status, STATUS_QOS)
        telling.start_soon(_echo_statuses, statuses, full_name, type_name)
        feedback = node.subscription(kinds.feedback_message, names.feedback, FEEDBACK_QOS)
        telling.start_soon(_echo_feedback, feedback)
    return DONE


async def _echo_statuses(
    messages: Subscription[GoalStatusArray], name: str, type_name: str
) -> None:
    """Print each state of a goal once."""
    known: dict[bytes, GoalStatus] = {}
    async for message in messages:
        goals = list(goals_in(message, name, type_name))
        for goal in goals:
            if known.get(goal.goal_id) is not goal.status:
                _echo(goal.goal_id, [f"status: {goal.status.name}"])
        known = {goal.goal_id: goal.status for goal in goals}


async def _echo_feedback(messages: Subscription[Any]) -> None:
    async for message in messages:
        feedback: Message = message.feedback
        _echo(message.goal_id.uuid, yaml_lines({"feedback": to_dict(feedback)}))


def _echo(goal_id: bytes, lines: Iterable[str]) -> None:
    say("".join(f"{line}\n" for line in (f"goal_id: '{goal_id.hex()}'", *lines, "---")))
