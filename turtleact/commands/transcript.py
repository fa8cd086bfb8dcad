"""Prints what happens to a goal, in the format of ``ros2 action send_goal`` or as JSON.

Stdout is flushed after each block of text, so that a program that reads it through a pipe gets the
block at once.
"""

from __future__ import annotations

import json
import sys
import textwrap
from typing import TYPE_CHECKING, Literal, NamedTuple

from turtleact.commands.output import note, say
from turtleact.interfaces import to_json, to_yaml

if TYPE_CHECKING:
    from turtleact.goals.client import ClientGoalHandle, Outcome
    from turtleact.goals.state import GoalStatus
    from turtleact.interfaces import Action, Message
    from turtleact.node import Node

__all__ = [
    "WAITING",
    "Followed",
    "JsonTranscript",
    "PlainTranscript",
    "Transcript",
    "View",
    "after_return",
    "result_text",
    "watch_command",
]

View = Literal["auto", "plain", "json"]
"""The ways to show a goal. ``auto`` is live on a terminal."""

WAITING = "Waiting for an action server to become available...\n"


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


class Transcript:
    """Tells the user what happens to a goal. This one prints only notes.

    Attributes:
        wants_feedback: Whether to call `feedback` with each feedback message.
    """

    wants_feedback = False

    def sending(self, goal: Message) -> None:
        """Called when the goal is about to be sent."""

    def rejected(self, reason: str) -> None:
        """Called when the server has rejected the goal. `note` is called with the reason, too."""

    def accepted(self, goal: Followed) -> None:
        """Called when the server has accepted the goal."""

    def follows(self, goal: Followed) -> None:
        """Called when the goal can be followed, also if somebody else has sent the goal."""

    def served(self, *, is_served: bool) -> None:
        """Called when the goal's server has gone or has come back. The caller also calls `note`."""

    async def animate(self) -> None:
        """Animate the display. When the goal ends, the caller cancels this coroutine."""

    def feedback(self, feedback: Message) -> None:
        """Called with each feedback message."""

    def status(self, status: GoalStatus) -> None:
        """Called with the goal's status, which may be the same as before."""

    def canceling(self) -> None:
        """Called when the server is asked to cancel the goal."""

    def ended(self, outcome: Outcome[Message]) -> None:
        """Called when the goal has ended, and the display too."""

    def note(self, text: str) -> None:
        """Print a message that is not an event of the goal, such as a warning."""
        note(text)

    def close(self) -> None:
        """Restore the terminal. A signal handler may call this."""


class PlainTranscript(Transcript):
    """Prints what ``ros2 action send_goal`` prints, but indents each line of YAML.

    ROS 2 indents only the first line below ``Feedback:`` and ``Result:``, so its output is not
    valid YAML.

    Args:
        wants_feedback: Whether to print each feedback message.
        most_lines: The maximum number of lines to print for the goal. If the goal has more lines,
            the lines in the middle are left out.
    """

    def __init__(self, *, wants_feedback: bool, most_lines: int = sys.maxsize) -> None:
        self.wants_feedback = wants_feedback
        self._most_lines = most_lines

    def sending(self, goal: Message) -> None:
        """Print the goal, which is about to be sent."""
        lines = _indented(goal, 5).removesuffix("\n").split("\n")
        if len(lines) > self._most_lines:
            first = self._most_lines // 2
            left_out = slice(first, len(lines) - (self._most_lines - first - 1))
            lines[left_out] = [f"     … {len(lines[left_out])} more lines …"]
        say("\n".join(("Sending goal:", *lines, "\n")))

    def rejected(self, reason: str) -> None:  # noqa: ARG002  # ros2 does not print it here
        """Print that the server has rejected the goal."""
        say("Goal was rejected.\n")

    def accepted(self, goal: Followed) -> None:
        """Print that the server has accepted the goal with this id."""
        say(f"Goal accepted with ID: {goal.handle.goal_id.hex()}\n\n")

    def feedback(self, feedback: Message) -> None:
        """Print a feedback message."""
        say(f"Feedback:\n{_indented(feedback, 4)}\n")

    def canceling(self) -> None:
        """Print that the server is asked to cancel the goal."""
        say("Canceling goal...\n\n")

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the result and the final status of the goal."""
        say(result_text(outcome))


class JsonTranscript(Transcript):
    """Prints each event of a goal as a JSON object on a line of its own.

    The member ``event`` is ``accepted``, ``rejected``, ``status``, ``feedback`` or ``result``.
    """

    wants_feedback = True

    def __init__(self) -> None:
        self._goal_id = ""
        self._status: GoalStatus | None = None

    def rejected(self, reason: str) -> None:
        """Print the event ``rejected``, with an empty goal id."""
        self._tell("rejected", reason=json.dumps(reason, ensure_ascii=False))

    def accepted(self, goal: Followed) -> None:
        """Print the event ``accepted``."""
        self._goal_id = goal.handle.goal_id.hex()
        request = goal.handle.request
        self._tell(
            "accepted",
            name=json.dumps(goal.name),
            type=json.dumps(goal.action_type.type_name),
            stamp=to_json(goal.handle.stamp),
            goal="null" if request is None else to_json(request),
        )

    def feedback(self, feedback: Message) -> None:
        """Print the event ``feedback``."""
        self._tell("feedback", feedback=to_json(feedback))

    def status(self, status: GoalStatus) -> None:
        """Print the event ``status``, if the status has changed."""
        if status is not self._status:
            self._status = status
            self._tell("status", status=json.dumps(status.name))

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the event ``result``, after an event ``status`` if the status has changed."""
        self.status(outcome.status)
        self._tell(
            "result",
            status=json.dumps(outcome.status.name),
            result=to_json(outcome.result),
            reason=json.dumps(outcome.reason, ensure_ascii=False),
        )

    def _tell(self, event: str, **values: str) -> None:
        """Print an event. The texts in ``values`` must be JSON."""
        pairs = {"event": json.dumps(event), "goal_id": json.dumps(self._goal_id), **values}
        say("{" + ", ".join(f'"{name}": {value}' for name, value in pairs.items()) + "}\n")


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
    """The last lines of a transcript: the result and the final status."""
    result = _indented(outcome.result, 4)
    return f"Result:\n{result}\nGoal finished with status: {outcome.status.name}\n"


def _indented(message: Message, columns: int) -> str:
    return textwrap.indent(to_yaml(message), " " * columns)
