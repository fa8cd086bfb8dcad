"""``send-goal``: one goal's way from its text to the exit status.

Knows when a goal is sent, canceled and let go of; what is printed of it stands in
`turtleact.commands.transcript` and `turtleact.commands.live`.

Source: ros2cli ``ros2action/verb/send_goal.py`` for the order of things.
"""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING, Literal, NamedTuple, NoReturn, cast

import anyio

from turtleact.commands.interrupts import leave
from turtleact.commands.transcript import JsonTranscript, PlainTranscript, Sent, Transcript
from turtleact.errors import GoalRejected, ServerUnavailable
from turtleact.goal import CancelCode, GoalStatus
from turtleact.interfaces import Action, from_text, get_interface
from turtleact.interfaces.definition import did_you_mean
from turtleact.names import resolve_name

if TYPE_CHECKING:
    from turtleact.client import ClientGoalHandle, Outcome
    from turtleact.commands.goal_text import GoalText
    from turtleact.commands.interrupts import Interrupts
    from turtleact.interfaces import Message
    from turtleact.node import Node

__all__ = ["Order", "View", "run"]

View = Literal["auto", "plain", "json"]

SUCCEEDED, REJECTED, ABORTED, CANCELED, TIMEOUT = 0, 3, 4, 5, 124
ENDS = {GoalStatus.SUCCEEDED: SUCCEEDED, GoalStatus.ABORTED: ABORTED}

PATIENCE = 5.0
"""Wall seconds that a goal has to end in after a timeout has canceled it."""


class Order(NamedTuple):
    """What the user wants.

    Attributes:
        name: The action.
        type_name: Its type, or None for whatever it is served with.
        text: The goal.
        feedback: Whether to print each feedback message.
        timeout: Wall seconds after which the goal is canceled; 0 leaves once it is accepted.
        view: How it is shown; ``auto`` is live on a terminal.
        speed: Of the embedded world.
        seed: Of the embedded world.
    """

    name: str
    type_name: str | None
    text: GoalText
    feedback: bool
    timeout: float | None
    view: View
    speed: float | str
    seed: int


def run(order: Order, interrupts: Interrupts) -> int:
    """Send the goal, follow it to its end, and give the exit status.

    Raises:
        InvalidName: if the action's name is no name.
        InvalidGoal: if the goal does not fit the action.
        UnknownInterface: if the type is not known.
        ServerUnavailable: if nobody serves the action, or not with this type.
    """
    transcript = choose_transcript(order)
    name = resolve_name(order.name)
    goal = None
    if order.type_name is not None:
        goal = read_goal(action_class(order.type_name), order.text)
    transcript.waiting()
    sending = _Sending(order, name, goal, transcript, interrupts)
    try:
        return asyncio.run(sending.run())
    finally:
        transcript.close()


def embedded_world(speed: float | str, seed: int) -> AbstractAsyncContextManager[Node]:
    """The world that goals are sent to; numpy and the rest are imported here, and no sooner."""
    from turtleact.app import open_world

    return open_world(speed=speed, seed=seed)


def choose_transcript(order: Order) -> Transcript:
    """A live display on a terminal that can show it, JSON if asked for, else plain."""
    if order.view == "json":
        return JsonTranscript()
    if order.view == "auto" and _is_terminal():
        from turtleact.commands.live import LiveTranscript

        return LiveTranscript(wants_feedback=order.feedback)
    return PlainTranscript(wants_feedback=order.feedback)


def action_class(type_name: str) -> type[Action]:
    """The class of an action's type.

    Raises:
        UnknownInterface: if it is not known.
        ServerUnavailable: if it is a message or a service.
    """
    found = get_interface(type_name)
    if not issubclass(found, Action):
        raise UsageError(f"'{type_name}' is not an action but a {found.type_name.split('/')[1]}")
    return found


def read_goal(action_type: type[Action], text: GoalText) -> Message:
    """The goal message that a text says."""
    return from_text(action_type.Goal, text.text, root="goal", source=text.source)
