"""Shows messages to a model: JSON Schemas of interfaces, messages from arguments, and replies.

A model sees an interface only through its schema. The schema therefore contains all that is known:
ranges of integers, lengths of lists and texts, defaults, constants, and the author's comments,
which often give the units.

- If no field of a goal has a default, the arguments must contain all fields. If at least one field
  has a default, only the lists and messages without a default are required. Other fields without a
  default, such as numbers, may be left out and are then zero, as in ROS. Many authors do not write
  defaults of zero, so these fields are not required.
- A field of a nested message is never required, as in ROS.
- Constants become an ``enum`` if their names begin with the field's name: ``STATUS_OK`` for
  ``status``. Constants that are single bits do not become an ``enum``, because they can be
  combined. Constants of a result, feedback or response do not become an ``enum`` either, because a
  server may send other values. Constants without an ``enum`` are only listed in the field's
  description.

Replies have text for models, and may have data for programs.

Source: JSON Schema 2020-12; the ROS 2 article "Interface definition".
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import msgspec
from mcp.server.context import ServerRequestContext
from mcp.types import CallToolResult, TextContent

from turtleact.errors import GoalAborted, GoalCanceled, InvalidMessage
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Message, fields, from_dict, from_text, to_dict
from turtleact.interfaces.conversion import error_class
from turtleact.interfaces.definition import (
    INTEGER_RANGES,
    ArrayForm,
    Field,
    FieldType,
    Primitive,
    zero,
)
from turtleact.interfaces.loading import comments
from turtleact.interfaces.text import flow, sayable
from turtleact.interfaces.types import REGISTRY, choices, named_values, nested_classes

if TYPE_CHECKING:
    from turtleact.goals.client import Outcome
    from turtleact.interfaces import Action

__all__ = [
    "Request",
    "Schema",
    "answer",
    "data_of",
    "failure",
    "goal_schema",
    "input_schema",
    "message_from",
    "object_schema",
    "one_line",
    "output_schema",
    "plain",
]

M = TypeVar("M", bound=Message)

Schema: TypeAlias = dict[str, Any]

Request: TypeAlias = ServerRequestContext[Any, Any]
"""A client's request, and the session for sending messages to the client."""

LONGEST_NOTE: Final = 500
"""The most characters of a comment that another node has sent."""

FLOATS: Final = frozenset({"float32", "float64"})

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


def object_schema(properties: Schema, required: Iterable[str]) -> Schema:
    """Return the JSON Schema of an object with these members."""
    schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    needed = list(required)
    return schema | {"required": needed} if needed else schema


@cache
def input_schema(cls: type[Message]) -> Schema:
    """Return the JSON Schema of a goal or request.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> schema = input_schema(Fibonacci.Goal)
    >>> schema["required"], schema["properties"]["order"]["maximum"]
    (['order'], 2147483647)
    """
    schema = _object(cls, is_output=False)
    needed = required(cls)
    for name in needed:
        schema["properties"][name].pop("default", None)
    return schema | {"required": list(needed)} if needed else schema


@cache
def output_schema(cls: type[Message]) -> Schema:
    """Return the JSON Schema of a result, feedback or response that `plain` has converted.

    All fields are required.
    """
    return _object(cls, is_output=True)


@cache
def required(cls: type[Message]) -> tuple[str, ...]:
    """Return the names of the fields that the arguments for a goal or request must contain."""
    all_fields = fields(cls)
    has_defaults = any(field.default is not None for field in all_fields)
    return tuple(
        field.name
        for field in all_fields
        if field.default is None
        and (not has_defaults or field.type.is_sequence or field.type.is_nested)
    )


def message_from(cls: type[M], arguments: Mapping[str, object], *, root: str) -> M:
    """Make a message from the arguments of a call.

    Args:
        cls: The class of the message.
        arguments: The arguments, by the names of the message's fields.
        root: The first word of the fields' paths in error messages: "goal" or "request".

    Raises:
        InvalidMessage: if a value does not fit its field, or a required field is missing.
    """
    try:
        message = from_dict(cls, arguments, root=root)
    except InvalidMessage:
        # The parser for texts knows how JSON spells a value, and so describes it better.
        text = msgspec.json.encode(arguments).decode()
        message = from_text(cls, text, root=root, source=root)
    for name in required(cls):
        if name not in arguments:
            problem = "it is missing, and has no default"
            raise error_class(root)(f"{root}.{name}", problem)
    return message


def plain(message: Message) -> dict[str, Any]:
    """Convert a message to plain values that JSON can hold.

    Bytes become lists of numbers; nan and infinity become None.
    """
    return sayable(to_dict(message))  # type: ignore[return-value]  # a dict stays one


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
    return object_schema(properties, ("goal_id", "status", "reason", "result"))


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


def _object(cls: type[Message], *, is_output: bool) -> Schema:
    notes = comments(cls)
    if cls in REGISTRY.texts:  # the words of a node: a model must not take them for instructions
        notes = {name: f"The node says: {note[:LONGEST_NOTE]!r}" for name, note in notes.items()}
    properties = {
        field.name: _field(cls, field, nested, notes.get(field.name, ""), is_output=is_output)
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }
    return object_schema(properties, properties if is_output else ())


def _field(
    cls: type[Message], field: Field, nested: type[Message] | None, note: str, *, is_output: bool
) -> Schema:
    element = _element(field.type.element, nested, is_output=is_output)
    if not is_output and (limited := choices(cls, field)):
        element["enum"] = [constant.value for constant in limited]
    known = named_values(cls, field)
    schema = _sequence(field.type, element) if field.type.is_sequence else element
    listed = ", ".join(f"{constant.name} = {constant.value}" for constant in known)
    described = " ".join(filter(None, (note, listed and f"Constants: {listed}."))).replace(
        "``", "`"
    )
    if described:
        schema["description"] = described
    if not is_output:
        default = _default(field)
        if default is not None:
            schema["default"] = default
    return schema


def _default(field: Field) -> Primitive | list[Primitive] | None:
    """Return the value that a field has if it is left out; None for a message or an empty list."""
    value = zero(field.type) if field.default is None else field.default
    return list(value) or None if isinstance(value, tuple) else value


def _sequence(kind: FieldType, items: Schema) -> Schema:
    schema: Schema = {"type": "array", "items": items}
    if kind.form is not ArrayForm.UNBOUNDED:
        schema["maxItems"] = kind.size
    if kind.form is ArrayForm.FIXED:
        schema["minItems"] = kind.size
    return schema


def _element(kind: FieldType, nested: type[Message] | None, *, is_output: bool) -> Schema:
    if nested is not None:
        return _object(nested, is_output=is_output)
    if kind.name == "bool":
        return {"type": "boolean"}
    if kind.name in FLOATS:  # null stands for nan and infinity
        # Some clients do not know lists of types, so the two are branches.
        number: Schema = {"type": "number"}
        return {"anyOf": [number, {"type": "null"}]} if is_output else number
    if kind.is_string:
        bound = {} if kind.string_bound is None else {"maxLength": kind.string_bound}
        return {"type": "string", **bound}
    least, most = INTEGER_RANGES[kind.name]
    return {"type": "integer", "minimum": least, "maximum": most}


def _rounded(value: object) -> object:
    """Round all floats in nested dictionaries and lists, and shorten long lists."""
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value[:MOST_SHOWN]]
    return round(value, DECIMALS) if isinstance(value, float) else value
