"""The operations of rosbridge v2 that a client may send, one class each.

A client sends each operation as a frame of JSON text. Unknown members of a frame are ignored, but a
frame with an unknown operation is `Malformed`. This module does no I/O.

Source: ``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2; the frames that its clients send.
"""

from __future__ import annotations

import json
import re
from typing import Any, Final, TypeAlias, cast

import msgspec

__all__ = [
    "ActionFeedback",
    "ActionResult",
    "Advertise",
    "AdvertiseAction",
    "AdvertiseService",
    "CallService",
    "CancelActionGoal",
    "Id",
    "Malformed",
    "Operation",
    "Publish",
    "SendActionGoal",
    "ServiceResponse",
    "SetLevel",
    "Subscribe",
    "Unadvertise",
    "UnadvertiseAction",
    "UnadvertiseService",
    "Unsubscribe",
    "parse",
]

Id: TypeAlias = str | int | float | None
"""The id that a client gives an operation; None without an id."""

Arguments: TypeAlias = dict[str, Any] | list[Any] | None


class Base(msgspec.Struct, tag_field="op", frozen=True, kw_only=True):
    """The base of all operations. Any operation may have an id."""

    id: Id = None


class SetLevel(Base, tag="set_level", frozen=True, kw_only=True):
    """The client sets the lowest severity of the ``status`` frames that it wants."""

    level: str | None = None


class Advertise(Base, tag="advertise", frozen=True, kw_only=True):
    """The client announces that it will publish to a topic."""

    topic: str
    type: str
    latch: bool | None = False
    queue_size: int | float | None = None


class Unadvertise(Base, tag="unadvertise", frozen=True, kw_only=True):
    """The client announces that it will no longer publish to a topic."""

    topic: str


class Publish(Base, tag="publish", frozen=True, kw_only=True):
    """The client publishes a message to a topic."""

    topic: str
    msg: dict[str, Any] | None = None
    type: str | None = None
    latch: bool | None = False


class Subscribe(Base, tag="subscribe", frozen=True, kw_only=True):
    """The client subscribes to a topic.

    Attributes:
        topic: The topic's name.
        type: The topic's type. If left out, the topic's type on the graph is used.
        throttle_rate: The minimum time between two messages (ms).
        queue_length: Ignored: messages that come too soon are dropped.
        compression: How messages are encoded: ``none``, ``png``, ``cbor`` or ``cbor-raw``.
    """

    topic: str
    type: str | None = None
    throttle_rate: int | float | None = 0
    queue_length: int | float | None = 0
    compression: str | None = "none"


class Unsubscribe(Base, tag="unsubscribe", frozen=True, kw_only=True):
    """The client ends a subscription or, if ``id`` is None, all its subscriptions to the topic."""

    topic: str


class CallService(Base, tag="call_service", frozen=True, kw_only=True):
    """The client calls a service. ``timeout`` is the longest time to wait for the response (s)."""

    service: str
    type: str | None = None
    args: Arguments = None
    timeout: int | float | None = None


class AdvertiseService(Base, tag="advertise_service", frozen=True, kw_only=True):
    """The client starts to serve a service."""

    service: str
    type: str


class UnadvertiseService(Base, tag="unadvertise_service", frozen=True, kw_only=True):
    """The client stops serving a service."""

    service: str


class ServiceResponse(Base, tag="service_response", frozen=True, kw_only=True):
    """The client answers a ``call_service`` that the bridge has sent to it."""

    service: str | None = None
    values: Arguments | str = None
    result: bool = True


class SendActionGoal(Base, tag="send_action_goal", frozen=True, kw_only=True):
    """The client sends a goal.

    Attributes:
        action: The name of the action.
        action_type: The type of the action.
        args: The goal message.
        feedback: Whether the client wants feedback.
        traceparent: The client's tracing span, in the format of W3C Trace Context. Other rosbridge
            servers ignore this member.
        tracestate: More data of the client's tracing system, in the format of W3C Trace Context.
    """

    action: str
    action_type: str
    args: Arguments = None
    feedback: bool | None = False
    traceparent: Any = None
    tracestate: Any = None


class CancelActionGoal(Base, tag="cancel_action_goal", frozen=True, kw_only=True):
    """The client cancels a goal. ``id`` is that of the goal's ``send_action_goal``."""

    action: str


class AdvertiseAction(Base, tag="advertise_action", frozen=True, kw_only=True):
    """The client starts to serve an action."""

    action: str
    type: str


class UnadvertiseAction(Base, tag="unadvertise_action", frozen=True, kw_only=True):
    """The client stops serving an action."""

    action: str


class ActionFeedback(Base, tag="action_feedback", frozen=True, kw_only=True):
    """The client publishes feedback of a goal that it serves."""

    action: str | None = None
    values: Arguments = None


class ActionResult(Base, tag="action_result", frozen=True, kw_only=True):
    """The client ends a goal that it serves. ``result`` is false if the goal has failed."""

    # roslib leaves out ``values`` and sends ``result: false`` for a goal that has failed.
    action: str | None = None
    values: Arguments | str = None
    status: int | None = None
    result: bool = True


Operation: TypeAlias = (
    SetLevel
    | Advertise
    | Unadvertise
    | Publish
    | Subscribe
    | Unsubscribe
    | CallService
    | AdvertiseService
    | UnadvertiseService
    | ServiceResponse
    | SendActionGoal
    | CancelActionGoal
    | AdvertiseAction
    | UnadvertiseAction
    | ActionFeedback
    | ActionResult
)

MOST_NESTED: Final = 100_000
"""The maximum number of objects and lists in a frame.

Reading a frame with a million objects and lists takes seconds."""

half_pattern = re.compile(r"[\ud800-\udfff]|\\u[dD][89a-fA-F]")
"""A pattern that finds text that may be half a surrogate pair, plain or escaped."""

DECODER: msgspec.json.Decoder[Operation] = msgspec.json.Decoder(Operation)


class Malformed(msgspec.Struct, frozen=True):
    """A frame that is not a valid operation.

    Attributes:
        problem: What is wrong with the frame.
        id: The frame's id; None if the frame has none.
    """

    problem: str
    id: Id = None


def parse(frame: str | bytes) -> Operation | Malformed:
    """Return the operation in a frame, or `Malformed` if there is none.

    >>> parse('{"op": "unsubscribe", "topic": "/pose"}').topic
    '/pose'
    """
    if isinstance(frame, bytes):
        return Malformed("binary frames are not supported: send JSON in a text frame")
    # Counted before it is read, which is fast; brackets inside texts count too, and do no harm.
    if frame.count("[") + frame.count("{") > MOST_NESTED:
        return Malformed(f"more than {MOST_NESTED} objects and lists")
    # Python reads half a surrogate pair from JSON, but cannot encode it: the first answer that
    # quotes it would fail.
    if half_pattern.search(frame) and not _is_sound(frame):
        return Malformed("half a surrogate pair, which cannot be sent")
    try:
        return DECODER.decode(frame)
    except (ValueError, RecursionError) as error:
        return _second_look(frame, error)


def _is_sound(frame: str) -> bool:
    """Whether all text in a frame can be encoded as UTF-8, so that an answer can quote it."""
    try:
        json.dumps(json.loads(frame), ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        return False
    return True


def _second_look(frame: str, first: ValueError | RecursionError) -> Operation | Malformed:
    """Parse a frame with Python's own JSON parser, which allows NaN."""
    try:
        members = json.loads(frame)
    except (ValueError, RecursionError):
        return Malformed(_problem(first))
    name = members.get("id") if isinstance(members, dict) else None
    try:
        return cast("Operation", msgspec.convert(members, Operation))
    except (ValueError, RecursionError) as error:
        return Malformed(_problem(error), name if isinstance(name, str | int) else None)


def _problem(error: ValueError | RecursionError) -> str:
    return "nested too deep" if isinstance(error, RecursionError) else f"{error}"
