"""How the endpoints of one interface write what they send, and read what they receive.

The bytes are CDR, the name of the layout is the type hash. What a transport that reaches other
processes is given beside each endpoint, so that it need know no message class.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, cast

from turtleact.errors import InvalidMessage
from turtleact.interfaces.type_hash import type_hash
from turtleact.interfaces.types import Message, Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from turtleact.interfaces.registry import Interface

__all__ = ["WireFormat"]


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
        if not isinstance(message, self._classes[0]):
            problem = f"expected {self._classes[0].type_name}, not {type(message).__name__}"
            raise InvalidMessage("message", problem)
        data: bytes = self._cdr.encode(message)
        return data

    def decode(self, data: bytes) -> Message:
        """What was received, as a message.

        Raises:
            InvalidMessage: if the bytes hold none; it says where.
        """
        message: Message = self._cdr.decode(self._classes[1], data)
        return message

    @cached_property
    def _cdr(self) -> ModuleType:
        from turtleact.interfaces import cdr  # only who sends bytes waits for its import

        return cdr

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
