"""Encodes and decodes the messages of an endpoint.

The messages are encoded as CDR, and the type hash identifies their layout. Each endpoint comes with
a `WireFormat`, so a transport to other processes needs no message classes.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, cast

from turtleact.errors import InvalidMessage
from turtleact.interfaces.classes import implied
from turtleact.interfaces.conversion import name_of
from turtleact.interfaces.standard.unique_identifier_msgs.msg import UUID
from turtleact.interfaces.type_hash import type_hash
from turtleact.interfaces.types import Action, Message, Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from turtleact.interfaces.types import Interface

__all__ = ["GOAL_ID", "FeedbackFormat", "WireFormat"]

GOAL_ID: Final = slice(4, 20)
"""The bytes of a feedback message that hold the goal id, in either byte order."""


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
