"""Makes the replies of tools. Replies have text for models, and may have data for programs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from mcp.server.context import ServerRequestContext
from mcp.types import CallToolResult, TextContent

from turtleact.errors import GoalAborted, GoalCanceled
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import to_dict
from turtleact.interfaces.text import flow
from turtleact.mcp.schema import Schema, output_schema, plain

if TYPE_CHECKING:
    from turtleact.goals.client import Outcome
    from turtleact.interfaces import Action, Message

__all__ = ["LONGEST_TEXT", "Request", "answer", "data_of", "failure", "goal_schema", "one_line"]

Request: TypeAlias = ServerRequestContext[Any, Any]
"""A client's request, and the session for sending messages to the client."""

LONGEST_TEXT: Final = 100_000
"""The maximum length of a reply's text for models (characters of JSON).

The structured data for programs are never shortened.
"""

LONGEST_LINE: Final = 500
"""The maximum length of a progress message (characters)."""

DECIMALS: Final = 3
MOST_SHOWN: Final = 100
"""The maximum number of items of each list that are used for a progress message."""

ENDS: Final = [GoalStatus.SUCCEEDED.name, GoalStatus.CANCELED.name, GoalStatus.ABORTED.name]


def goal_schema(action_type: type[Action]) -> Schema:
    """Return the JSON Schema of the replies of an action's tool."""
    properties: Schema = {
        "goal_id": {"type": "string", "description": "The id of the goal, 32 hexadecimal digits."},
        "status": {"type": "string", "enum": ENDS, "description": "How the goal ended."},
        "reason": {"type": "string", "description": "Why it was aborted; empty otherwise."},
        "result": output_schema(action_type.Result),
        "feedback": output_schema(action_type.Feedback)
        | {"description": "The last feedback, if there was any."},
    }
    required = ["goal_id", "status", "reason", "result"]
    return {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def data_of(goal_id: bytes, outcome: Outcome[Any], feedback: Message | None) -> CallToolResult:
    """Make the reply of an action's tool from the outcome of the goal.

    If the goal did not succeed, the reply is an error. The text of the error says how the goal
    ended, and quotes the server's reason.
    """
    data = {
        "goal_id": goal_id.hex(),
        "status": outcome.status.name,
        "reason": outcome.reason,
        "result": plain(outcome.result),
    }
    if feedback is not None:
        data["feedback"] = plain(feedback)
    if outcome.status is GoalStatus.SUCCEEDED:
        return answer(data)
    kind = GoalCanceled if outcome.status is GoalStatus.CANCELED else GoalAborted
    return answer(data, error=str(kind(outcome.reason)))


def answer(data: dict[str, Any], *, error: str = "") -> CallToolResult:
    """Make a reply that contains ``data``. The reply is an error if ``error`` is not empty."""
    text = json.dumps(data, ensure_ascii=False)
    if len(text) > LONGEST_TEXT:
        text = f"{text[:LONGEST_TEXT]}… {len(text) - LONGEST_TEXT} more characters"
    texts = [error, text] if error else [text]
    return CallToolResult(
        content=[TextContent(text=each) for each in texts],
        structured_content=data,
        is_error=bool(error),
    )


def failure(problem: object) -> CallToolResult:
    """Make a reply that shows an error to the model."""
    return CallToolResult(content=[TextContent(text=str(problem))], is_error=True)


def one_line(message: Message) -> str:
    """Return a message as one readable line.

    >>> from turtleact.interfaces.standard import Point
    >>> one_line(Point(x=1.0, y=2.50001))
    'x: 1.0, y: 2.5, z: 0.0'
    """
    text = flow(_rounded(to_dict(message)))[1:-1]
    return text if len(text) <= LONGEST_LINE else f"{text[:LONGEST_LINE]}…"


def _rounded(value: object) -> object:
    """Round all floats in nested dictionaries and lists, and shorten long lists."""
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value[:MOST_SHOWN]]
    return round(value, DECIMALS) if isinstance(value, float) else value
