"""How the endpoints of one interface write what they send, and read what they receive.

The bytes are CDR, the name of the layout is the type hash. What a transport that reaches other
processes is given beside each endpoint, so that it need know no message class.
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
"""Where a feedback message has the id of its goal, in either byte order: behind CDR's header."""


class WireFormat:
    """The format of one endpoint; cheap until it is used.

    Args:
        interface: The message or service class, or what gives it once it is needed.
        asks: Whether the endpoint is the client of a service: it sends requests.

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
        """The type hash of the message, or of the whole service.

        Raises:
            InvalidInterface: if the class has no type name.
        """
        return type_hash(self._found)

    def encode(self, message: object) -> bytes:
        """What is sent, as bytes.

        Raises:
            InvalidMessage: if it is of another class, or a value does not fit its type.
        """
        if type(message) is not self._classes[0]:
            given = type(message)
            got = name_of(given) if issubclass(given, Message) else given.__name__
            problem = f"expected {self._classes[0].type_name}, not {got}"
            raise InvalidMessage("message", problem)
        try:
            return self._encoded(message, self._header)
        except self._cdr.UNFIT:
            data: bytes = self._cdr.encode(message)  # converts it, or says what is wrong
            return data

    def decode(self, data: bytes) -> Message:
        """What was received, as a message.

        Raises:
            InvalidMessage: if the bytes hold none; it says where.
        """
        if data[:2] == self._order and len(data) >= len(self._header):
            try:
                return self._decoded(data)
            except self._cdr.MISREAD:
                pass  # it is said below where that is
        message: Message = self._cdr.decode(self._classes[1], data)
        return message

    @cached_property
    def _cdr(self) -> ModuleType:
        from turtleact.interfaces import cdr  # only who sends bytes waits for its import

        return cdr

    @cached_property
    def _header(self) -> bytes:
        return cast("bytes", self._cdr.HEADER)

    @cached_property
    def _order(self) -> bytes:
        return self._header[:2]

    @cached_property
    def _encoded(self) -> Callable[[object, bytes], bytes]:
        found: Callable[[object, bytes], bytes] = self._cdr.writer_behind(
            self._classes[0], len(self._header)
        )
        return found

    @cached_property
    def _decoded(self) -> Callable[[bytes], Message]:
        found: Callable[[bytes], Message] = self._cdr.reader_behind(
            self._classes[1], len(self._header)
        )
        return found

    @cached_property
    def _found(self) -> Interface:
        given = self._interface
        return given if isinstance(given, type) else cast("Interface", given())

    @cached_property
    def _classes(self) -> tuple[type[Message], type[Message]]:
        """The class that is sent, and the one that is received."""
        found = self._found
        if not issubclass(found, Service):
            message = cast("type[Message]", found)
            return message, message
        if self._asks:
            return found.Request, found.Response
        return found.Response, found.Request


class FeedbackFormat(WireFormat):
    """The format of an action's feedback topic.

    A message of it is the id of a goal, and feedback. Both are written and read here by themselves
    too: there is much feedback, and the message around it is nothing that anybody looks at.

    Args:
        action: The action.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> feedback = FeedbackFormat(Fibonacci)
    >>> feedback.read(feedback.write(bytes(16), Fibonacci.Feedback([0, 1])))
    Feedback(partial_sequence=[0, 1])
    """

    def __init__(self, action: type[Action]) -> None:
        super().__init__(lambda: implied(action).feedback_message)
        self._feedback = action.Feedback

    def write(self, goal_id: bytes, feedback: Message) -> bytes:
        """What is sent of a goal of this id (16 bytes).

        Raises:
            InvalidMessage: if a value does not fit its type.
        """
        try:
            return self._write(feedback, self._header + goal_id)
        except self._cdr.UNFIT:
            message: Any = self._classes[0]
            return self.encode(message(UUID(goal_id), feedback))

    def write_unchecked(self, goal_id: bytes, feedback: object) -> bytes | None:
        """The same of what may be no such feedback, or hold anything.

        None if it is not what ``snapshot`` would copy as it is; that then says what is wrong.
        """
        try:
            return self._write_strictly(feedback, self._header + goal_id)
        except self._cdr.UNFIT:
            return None

    def read(self, data: bytes) -> Message:
        """The feedback that was received; the id of its goal stands at `GOAL_ID`.

        Raises:
            InvalidMessage: if the bytes hold no such message; it says where.
        """
        if data[:2] == self._order:
            try:
                return self._read(data)
            except self._cdr.MISREAD:
                pass  # it is said below where that is
        message: Any = WireFormat.decode(self, data)
        return cast("Message", message.feedback)

    @cached_property
    def _write(self) -> Callable[[object, bytes], bytes]:
        return self._writer(is_strict=False)

    @cached_property
    def _write_strictly(self) -> Callable[[object, bytes], bytes]:
        return self._writer(is_strict=True)

    def _writer(self, *, is_strict: bool) -> Callable[[object, bytes], bytes]:
        found: Callable[[object, bytes], bytes] = self._cdr.writer_behind(
            self._feedback, GOAL_ID.stop, is_strict=is_strict
        )
        return found

    @cached_property
    def _read(self) -> Callable[[bytes], Message]:
        found: Callable[[bytes], Message] = self._cdr.reader_behind(self._feedback, GOAL_ID.stop)
        return found
