"""Encodes and decodes the messages of an endpoint.

The messages are encoded as CDR, and the type hash identifies their layout. Each endpoint comes with
a `WireFormat`, so a transport to other processes needs no message classes.
"""

from __future__ import annotations

import struct
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, cast

from turtleact.errors import InvalidMessage
from turtleact.interfaces.classes import event_message, implied
from turtleact.interfaces.conversion import SECOND, name_of
from turtleact.interfaces.standard.unique_identifier_msgs.msg import UUID
from turtleact.interfaces.type_hash import type_hash
from turtleact.interfaces.types import Action, Message, Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from turtleact.interfaces.types import Interface

__all__ = ["GOAL_ID", "EventFormat", "FeedbackFormat", "WireFormat"]

GOAL_ID: Final = slice(4, 20)
"""The bytes of a feedback message that hold the goal id, in either byte order."""

_EVENT: Final = struct.Struct("<4sB3xiI16s4xq")
"""The CDR header and a ``service_msgs/msg/ServiceEventInfo``; two sequences follow."""

_NONE: Final = struct.pack("<I", 0)
_ONE: Final = struct.pack("<I", 1)


class WireFormat:
    """Encodes and decodes the messages of one endpoint.

    Creating a WireFormat is cheap, because the codec is built on first use.

    Args:
        interface: The message or service class, or a function that returns the class when needed.
        asks: Whether the endpoint is the client of a service, and therefore sends requests.

    >>> from turtleact.interfaces.standard import Time
    >>> time = WireFormat(Time)
    >>> time.decode(time.encode(Time(sec=1)))
    Time(sec=1, nanosec=0)
    """

    def __init__(self, interface: Interface | Callable[[], object], *, asks: bool = False) -> None:
        self._interface = interface
        self._asks = asks

    @cached_property
    def type_hash(self) -> str:
        """The type hash of the message or of the whole service.

        Raises:
            InvalidInterface: if the class has no type name.
        """
        return type_hash(self._found)

    def encode(self, message: object) -> bytes:
        """Encode a message.

        Raises:
            InvalidMessage: if the message is of another class, or a value does not fit its type.
        """
        if type(message) is not self._classes[0]:
            given = type(message)
            got = name_of(given) if issubclass(given, Message) else given.__name__
            problem = f"expected {self._classes[0].type_name}, not {got}"
            raise InvalidMessage("message", problem)
        try:
            written: bytes = self._cdr.encoder(self._classes[0])(message)
            return written
        except self._cdr.UNFIT:
            data: bytes = self._cdr.encode(message)  # converts the value, or raises a clear error
            return data

    def decode(self, data: bytes) -> Message:
        """Decode a message.

        Raises:
            InvalidMessage: if the bytes are not a message of the expected class.
        """
        message: Message = self._cdr.decode(self._classes[1], data)
        return message

    @cached_property
    def _cdr(self) -> ModuleType:
        from turtleact.interfaces import cdr  # slow to import; only needed to encode or decode

        return cdr

    @cached_property
    def _found(self) -> Interface:
        given = self._interface
        return given if isinstance(given, type) else cast("Interface", given())

    @cached_property
    def _classes(self) -> tuple[type[Message], type[Message]]:
        """The class of messages to send, and the class of messages to receive."""
        found = self._found
        if not issubclass(found, Service):
            message = cast("type[Message]", found)
            return message, message
        if self._asks:
            return found.Request, found.Response
        return found.Response, found.Request


class FeedbackFormat(WireFormat):
    """Encodes and decodes the messages on an action's feedback topic.

    A feedback message consists of a goal id and the feedback. Feedback is frequent, so this class
    saves time: it encodes and decodes the goal id and the feedback without creating an object for
    the whole message.

    Args:
        action: The class of the action.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> feedback = FeedbackFormat(Fibonacci)
    >>> feedback.read(feedback.write(bytes(16), Fibonacci.Feedback([0, 1])))
    Feedback(partial_sequence=[0, 1])
    """

    def __init__(self, action: type[Action]) -> None:
        super().__init__(lambda: implied(action).feedback_message)
        self._feedback = action.Feedback

    def write(self, goal_id: bytes, feedback: Message) -> bytes:
        """Encode a feedback message for the goal with this id (16 bytes).

        Raises:
            InvalidMessage: if a value does not fit its type.
        """
        try:
            written: bytes = self._cdr.encoder(self._feedback)(feedback, self._cdr.HEADER + goal_id)
            return written
        except self._cdr.UNFIT:
            message: Any = self._classes[0]
            return self.encode(message(UUID(goal_id), feedback))

    def read(self, data: bytes) -> Message:
        """Decode only the feedback in a feedback message. The goal id is ``data[GOAL_ID]``.

        Raises:
            InvalidMessage: if the bytes are not a feedback message of the action.
        """
        if data[:2] == self._cdr.HEADER[:2]:
            try:
                read: Message = self._cdr.decoder(self._feedback, place=GOAL_ID.stop)(data)
                return read
            except self._cdr.MISREAD:
                pass  # the decoding below raises again, with a clear error
        message: Any = WireFormat.decode(self, data)
        return cast("Message", message.feedback)


class EventFormat(WireFormat):
    """Encodes and decodes the messages on a service's event topic.

    An event consists of a ``ServiceEventInfo`` about a call and, if contents are published, the
    request or response. `write` can also build an event from a request or response that is already
    encoded, which takes a fifth of the time of encoding an event object.

    Args:
        find_service: A function that returns the class of the service.

    >>> from turtleact.interfaces.standard.std_srvs.srv import SetBool
    >>> events, requests = EventFormat(lambda: SetBool), WireFormat(SetBool, asks=True)
    >>> sent = requests.encode(SetBool.Request(data=True))
    >>> event = events.decode(events.write(events.info(0, 7, bytes(16), 1), request=sent))
    >>> event.request[0].data, event.response
    (True, [])
    """

    def __init__(self, find_service: Callable[[], object]) -> None:
        self._find_service = find_service
        super().__init__(lambda: event_message(self._service))

    def info(self, kind: int, stamp: int, gid: bytes, sequence: int) -> bytes:
        """Encode the ``ServiceEventInfo`` at the beginning of an event.

        Args:
            kind: What happened: a constant of ``ServiceEventInfo``.
            stamp: When the event happened (ns since the epoch).
            gid: The gid of the client.
            sequence: The sequence number of the request.
        """
        return _EVENT.pack(self._cdr.HEADER, kind, *divmod(stamp, SECOND), gid, sequence)

    def write(
        self, info: bytes, *, request: bytes | None = None, response: bytes | None = None
    ) -> bytes:
        """Encode an event.

        Args:
            info: The encoded ``ServiceEventInfo``, which the method `info` returns.
            request: The encoded request, if the event contains one.
            response: The encoded response, if the event contains one.

        Raises:
            InvalidMessage: if the request or a big-endian response cannot be decoded. A
                little-endian response is copied without being decoded.
        """
        if response is not None and response[:2] == self._cdr.HEADER[:2]:
            # It begins at a multiple of the widest alignment, so its padding stays as it is. What
            # ROS 2 leaves behind a message does no harm at the end.
            return b"".join((info, _NONE, _ONE, response[4:]))
        if response is not None:
            swapped = self._responses.encode(self._responses.decode(response))
            return self.write(info, response=swapped)
        if request is None:
            return info + _NONE + _NONE
        # It begins where its padding may differ, and nothing may be left behind it.
        write = self._cdr.encoder(self._service.Request)
        written: bytes = write(self._requests.decode(request), info + _ONE)
        return b"".join((written, bytes(-len(written) % 4), _NONE))

    @cached_property
    def _service(self) -> type[Service]:
        return cast("type[Service]", self._find_service())

    @cached_property
    def _requests(self) -> WireFormat:
        return WireFormat(self._service.Request)

    @cached_property
    def _responses(self) -> WireFormat:
        return WireFormat(self._service.Response)
