"""Follows a goal, and prints what happens to it as ``ros2 action send_goal`` does, or as JSON.

Stdout is flushed after each block of text, so that a program that reads it through a pipe gets the
block at once.
"""

from __future__ import annotations

import json
import sys
import textwrap
from contextlib import aclosing
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import anyio

from turtleact.commands.output import say
from turtleact.goals.client_handle import FeedbackReceived, StatusChanged
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import to_json, to_yaml
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.goals.client_handle import ClientGoalHandle, Event, Outcome
    from turtleact.interfaces import Action, Message
    from turtleact.node import Node

__all__ = [
    "EXIT_STATUS",
    "WAITING",
    "Followed",
    "GoalPrinter",
    "JsonPrinter",
    "View",
    "after_return",
    "follow",
    "result_text",
    "watch_command",
]

View = Literal["auto", "plain", "json"]
"""The ways to show a goal. ``auto`` is live on a terminal."""

WAITING = "Waiting for an action server to become available...\n"

EXIT_STATUS: Final = {GoalStatus.SUCCEEDED: 0, GoalStatus.ABORTED: 4, GoalStatus.CANCELED: 5}
"""The exit status for each final state of a goal."""


class Followed(NamedTuple):
    """A goal that the server has accepted.

    Attributes:
        node: The node that follows the goal.
        name: The action's name.
        action_type: The action's type.
        handle: The client's goal handle.
        age: The time from the goal's acceptance to the creation of this object (s).
    """

    node: Node
    name: str
    action_type: type[Action]
    handle: ClientGoalHandle[Message, Message]
    age: float = 0.0


class GoalPrinter:
    """Prints what ``ros2 action send_goal`` prints, but indents each line of YAML.

    ROS 2 indents only the first line below ``Feedback:`` and ``Result:``, so its output is not
    valid YAML.

    Args:
        wants_feedback: Whether to print each feedback message.
        most_lines: The maximum number of lines to print for the goal. If the goal has more lines,
            the lines in the middle are left out.

    Attributes:
        wants_events: Whether to call `show`.
    """

    def __init__(self, *, wants_feedback: bool, most_lines: int = sys.maxsize) -> None:
        self.wants_events = wants_feedback
        self._most_lines = most_lines

    def sending(self, goal: Message) -> None:
        """Print the goal, which is about to be sent."""
        lines = _indented(goal, 5).removesuffix("\n").split("\n")
        if len(lines) > self._most_lines:
            first = self._most_lines // 2
            left_out = slice(first, len(lines) - (self._most_lines - first - 1))
            lines[left_out] = [f"     … {len(lines[left_out])} more lines …"]
        say("\n".join(("Sending goal:", *lines, "\n")))

    def rejected(self, reason: str) -> None:  # noqa: ARG002  # ros2 does not print it
        """Print that the server has rejected the goal. The caller prints the reason."""
        say("Goal was rejected.\n")

    def accepted(self, goal: Followed) -> None:
        """Print that the server has accepted the goal with this id."""
        say(f"Goal accepted with ID: {goal.handle.goal_id.hex()}\n\n")

    def follows(self, goal: Followed) -> None:
        """Called when the goal can be followed, also if somebody else has sent the goal."""

    async def animate(self) -> None:
        """Animate the display. When the goal ends, the caller cancels this coroutine."""

    def show(self, event: Event[Message, Message]) -> None:
        """Print an event of the goal. Plain text tells of feedback alone."""
        if isinstance(event, FeedbackReceived):
            self.feedback(event.feedback)

    def feedback(self, feedback: Message) -> None:
        """Print a feedback message."""
        say(f"Feedback:\n{_indented(feedback, 4)}\n")

    def canceling(self) -> None:
        """Print that the server is asked to cancel the goal."""
        say("Canceling goal...\n\n")

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the result and the final status of the goal, once the display has ended."""
        say(result_text(outcome))

    def close(self) -> None:
        """Restore the terminal. A signal handler may call this."""


class JsonPrinter(GoalPrinter):
    """Prints each event of a goal as a JSON object on a line of its own.

    The member ``event`` is ``accepted``, ``rejected``, ``status``, ``feedback`` or ``result``.
    """

    def __init__(self) -> None:
        super().__init__(wants_feedback=True)
        self._goal_id = ""

    def sending(self, goal: Message) -> None:
        """Print nothing: the event ``accepted`` has the goal."""

    def canceling(self) -> None:
        """Print nothing: the events ``status`` tell of it."""

    def rejected(self, reason: str) -> None:
        """Print the event ``rejected``, with an empty goal id."""
        self._print("rejected", reason=_json(reason))

    def accepted(self, goal: Followed) -> None:
        """Print the event ``accepted``."""
        self._goal_id = goal.handle.goal_id.hex()
        request = goal.handle.request
        self._print(
            "accepted",
            name=_json(goal.name),
            type=_json(goal.action_type.type_name),
            stamp=to_json(goal.handle.stamp),
            goal="null" if request is None else to_json(request),
        )

    def show(self, event: Event[Message, Message]) -> None:
        """Print the events ``feedback`` and ``status``."""
        if isinstance(event, FeedbackReceived):
            self._print("feedback", feedback=to_json(event.feedback))
        elif isinstance(event, StatusChanged):
            self._print("status", status=_json(event.status.name))

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the event ``result``."""
        self._print(
            "result",
            status=_json(outcome.status.name),
            result=to_json(outcome.result),
            reason=_json(outcome.reason),
        )

    def _print(self, event: str, **values: str) -> None:
        """Print an event. The texts in ``values`` must be JSON."""
        pairs = {"event": _json(event), "goal_id": _json(self._goal_id), **values}
        say("{" + ", ".join(f'"{name}": {value}' for name, value in pairs.items()) + "}\n")


async def follow(
    printer: GoalPrinter, handle: ClientGoalHandle[Message, Message]
) -> Outcome[Message]:
    """Show a goal to its end. The display has ended when its result is printed."""
    async with aclosing(Background(printer.animate(), "the display")):
        await anyio.lowlevel.checkpoint()  # the display begins, however soon the goal ends
        if printer.wants_events:
            async for event in handle.events():
                printer.show(event)
        outcome = await handle.outcome()
    printer.ended(outcome)
    return outcome


def watch_command(goal_id: bytes, options: str) -> str:
    """Return the command that follows a goal.

    Args:
        goal_id: The goal's id, 16 bytes.
        options: The options for the graph and the interfaces, with a space before each option.
    """
    return f"turtleact watch {goal_id.hex()}{options}"


def after_return(command: str) -> str:
    """Return a hint: once the goal's server is back, ``command`` follows the goal again."""
    return f"if the server returns and continues the goal, '{command}' follows it again"


def result_text(outcome: Outcome[Message]) -> str:
    """Return the last lines that are printed of a goal: the result and the final status."""
    result = _indented(outcome.result, 4)
    return f"Result:\n{result}\nGoal finished with status: {outcome.status.name}\n"


def _indented(message: Message, columns: int) -> str:
    return textwrap.indent(to_yaml(message), " " * columns)


def _json(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
