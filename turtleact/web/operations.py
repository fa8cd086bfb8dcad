"""The operations of rosbridge v2 that a client may send, one class each.

A client sends each operation as a frame of JSON text. Unknown members of a frame are ignored, but a
frame with an unknown operation is `Malformed`. This module does no I/O.

Source: ``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2; the frames that its clients send.
"""

from __future__ import annotations

import re
from typing import Any, TypeAlias

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
    traceparent: str | None = None
    tracestate: str | None = None


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

DECODER: msgspec.json.Decoder[Operation] = msgspec.json.Decoder(Operation)

not_json = re.compile(r"(?<=[:,\[])(\s*)-?(?:NaN|Infinity)(?=\s*[,\]}])")
"""Numbers that Python writes into its JSON. JSON has only null for them."""


class Malformed(msgspec.Struct, frozen=True):
    """A frame that is not a valid operation.

    Attributes:
        problem: What is wrong with the frame.
        id: The frame's id; None if the frame has none.
    """

    problem: str
    id: Id = None


class Identified(msgspec.Struct):
    """The one member that every frame may have."""

    id: Id = None


def parse(frame: str | bytes) -> Operation | Malformed:
    """Return the operation in a frame, or `Malformed` if there is none.

    >>> parse('{"op": "unsubscribe", "topic": "/pose"}').topic
    '/pose'
    """
    if isinstance(frame, bytes):
        return Malformed("binary frames are not supported: send JSON in a text frame")
    try:
        return DECODER.decode(frame)
    except (ValueError, RecursionError) as error:
        problem = str(error)
    try:
        return DECODER.decode(not_json.sub(r"\1null", frame))
    except (ValueError, RecursionError):
        return Malformed(problem, _id_of(frame))


def _id_of(frame: str) -> Id:
    try:
        return msgspec.json.decode(frame, type=Identified).id
    except (ValueError, RecursionError):
        return None
