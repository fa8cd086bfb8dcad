"""Prints what happens to a goal, in the format of ``ros2 action send_goal`` or as JSON.

Stdout is flushed after each block of text, so that a program that reads it through a pipe gets the
block at once.
"""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

from turtleact.commands.output import note, say
from turtleact.interfaces import to_json, to_yaml

if TYPE_CHECKING:
    from turtleact.client import ClientGoalHandle, Outcome
    from turtleact.goal import GoalStatus
    from turtleact.interfaces import Message
    from turtleact.node import Node

__all__ = [
    "WAITING",
    "Followed",
    "JsonTranscript",
    "PlainTranscript",
    "Sent",
    "Transcript",
    "View",
    "after_return",
    "result_text",
    "watch_command",
]

View = Literal["auto", "plain", "json"]
"""The ways to show a goal. ``auto`` is live on a terminal."""

WAITING = "Waiting for an action server to become available...\n"


class Transcript(Protocol):
    """Tells the user what happens to a goal, from its sending to its end."""

    @property
    def wants_feedback(self) -> bool:
        """Whether to call `feedback` with each feedback message."""

    def sending(self, goal: Message) -> None:
        """Called when the goal is about to be sent."""

    def rejected(self, reason: str) -> None:
        """Called when the server has rejected the goal. `note` is called with the reason, too."""

    def accepted(self, sent: Sent) -> None:
        """Called when the server has accepted the goal."""

    def follows(self, goal: Followed) -> None:
        """Called when the transcript starts to follow a goal that somebody else sent."""

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
        """Called when the goal has ended."""

    def note(self, text: str) -> None:
        """Print a message that is not an event of the goal, such as a warning."""

    async def drained(self) -> None:
        """Wait until everything has been written. Cancelling: safe."""

    def close(self) -> None:
        """Stop the display. Printed text stays on the screen.

        This never blocks, and may be called at any time, even by a signal handler.
        """


class Held(Protocol):
    """A goal, as a client sees it."""

    @property
    def goal_id(self) -> bytes:
        """The 16 bytes of the goal's id."""

    @property
    def status(self) -> GoalStatus:
        """The goal's status."""

    @property
    def last_feedback(self) -> Message | None:
        """The newest feedback, if there is any."""

    @property
    def is_paused(self) -> bool:
        """Whether the goal is paused."""

    async def pause(self) -> None:
        """Pause the goal. Raises `PauseRefused` if it cannot be paused."""

    async def resume(self) -> None:
        """Resume the goal. Raises `PauseRefused` if it cannot be resumed."""


class Followed(NamedTuple):
    """A goal on which a transcript reports.

    Attributes:
        node: The node that watches the goal.
        name: The action's name.
        goal_type: The type of the goal message.
        goal: The goal message; None if another process sent the goal.
        handle: The client's view of the goal.
        age: The time from the goal's acceptance to the creation of this object (s).
    """

    node: Node
    name: str
    goal_type: type[Message]
    goal: Message | None
    handle: Held
    age: float = 0.0


class Sent(NamedTuple):
    """A goal that this process has sent and the server has accepted.

    Attributes:
        node: The node that sent the goal.
        name: The action's name.
        type_name: The name of the action's type.
        goal: The goal message.
        handle: The client's goal handle.
    """

    node: Node
    name: str
    type_name: str
    goal: Message
    handle: ClientGoalHandle[Message, Message]

    def followed(self) -> Followed:
        """Return the goal as a `Followed`."""
        return Followed(self.node, self.name, type(self.goal), self.goal, self.handle)


class PlainTranscript:
    """Prints what ``ros2 action send_goal`` prints, but indents each line of YAML.

    ROS 2 indents only the first line below ``Feedback:`` and ``Result:``, so its output is not
    valid YAML.

    Args:
        wants_feedback: Whether to print each feedback message.
        say: The function that prints a block of text.
        most_lines: The maximum number of lines to print for the goal. If the goal has more lines,
            the lines in the middle are left out.
    """

    def __init__(
        self,
        *,
        wants_feedback: bool,
        say: Callable[[str], None] = say,
        most_lines: int = sys.maxsize,
    ) -> None:
        self.wants_feedback = wants_feedback
        self._say = say
        self._most_lines = most_lines

    def sending(self, goal: Message) -> None:
        """Print the goal, which is about to be sent."""
        lines = _indented(goal, 5).removesuffix("\n").split("\n")
        if len(lines) > self._most_lines:
            first = self._most_lines // 2
            left_out = slice(first, len(lines) - (self._most_lines - first - 1))
            lines[left_out] = [f"     … {len(lines[left_out])} more lines …"]
        self._say("\n".join(("Sending goal:", *lines, "\n")))

    def rejected(self, reason: str) -> None:  # noqa: ARG002  # ros2 does not print it here
        """Print that the server has rejected the goal."""
        self._say("Goal was rejected.\n")

    def accepted(self, sent: Sent) -> None:
        """Print that the server has accepted the goal with this id."""
        self._say(f"Goal accepted with ID: {sent.handle.goal_id.hex()}\n\n")

    def follows(self, goal: Followed) -> None:
        """Do nothing, because there is nothing to print yet."""

    def served(self, *, is_served: bool) -> None:
        """Print nothing, because `note` also reports that the server has gone or has come back."""

    async def animate(self) -> None:
        """Do nothing, because there is nothing to animate."""

    def feedback(self, feedback: Message) -> None:
        """Print a feedback message."""
        self._say(f"Feedback:\n{_indented(feedback, 4)}\n")

    def status(self, status: GoalStatus) -> None:
        """Do nothing, because only the final status is printed."""

    def canceling(self) -> None:
        """Print that the server is asked to cancel the goal."""
        self._say("Canceling goal...\n\n")

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the result and the final status of the goal."""
        self._say(result_text(outcome))

    def note(self, text: str) -> None:
        """Print a message that is not an event of the goal, such as a warning."""
        note(text)

    async def drained(self) -> None:
        """Do nothing, because each block is flushed at once."""

    def close(self) -> None:
        """Do nothing, because there is nothing to stop."""


class JsonTranscript:
    """Prints each event of a goal as a JSON object on a line of its own.

    The member ``event`` is ``accepted``, ``rejected``, ``status``, ``feedback`` or ``result``.
    """

    wants_feedback = True

    def __init__(self) -> None:
        self._goal_id = ""
        self._status: GoalStatus | None = None

    def sending(self, goal: Message) -> None:
        """Do nothing, because there is no event for the sending of a goal."""

    def rejected(self, reason: str) -> None:
        """Print the event ``rejected``, with an empty goal id."""
        self._tell("rejected", reason=json.dumps(reason, ensure_ascii=False))

    def accepted(self, sent: Sent) -> None:
        """Print the event ``accepted``."""
        self._goal_id = sent.handle.goal_id.hex()
        self._tell(
            "accepted",
            name=json.dumps(sent.name),
            type=json.dumps(sent.type_name),
            stamp=to_json(sent.handle.stamp),
            goal=to_json(sent.goal),
        )

    def follows(self, goal: Followed) -> None:
        """Do nothing, because there is nothing to print yet."""

    def served(self, *, is_served: bool) -> None:
        """Print nothing, because `note` also reports that the server has gone or has come back."""

    async def animate(self) -> None:
        """Do nothing, because there is nothing to animate."""

    def feedback(self, feedback: Message) -> None:
        """Print the event ``feedback``."""
        self._tell("feedback", feedback=to_json(feedback))

    def status(self, status: GoalStatus) -> None:
        """Print the event ``status``, if the status has changed."""
        if status is not self._status:
            self._status = status
            self._tell("status", status=json.dumps(status.name))

    def canceling(self) -> None:
        """Do nothing, because the event ``status`` will report that the goal is CANCELING."""

    def ended(self, outcome: Outcome[Message]) -> None:
        """Print the event ``result``, after an event ``status`` if the status has changed."""
        self.status(outcome.status)
        self._tell(
            "result",
            status=json.dumps(outcome.status.name),
            result=to_json(outcome.result),
            reason=json.dumps(outcome.reason, ensure_ascii=False),
        )

    def note(self, text: str) -> None:
        """Print a message that is not an event of the goal, such as a warning."""
        note(text)

    async def drained(self) -> None:
        """Do nothing, because each block is flushed at once."""

    def close(self) -> None:
        """Do nothing, because there is nothing to stop."""

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
