"""Lengths of time."""

from __future__ import annotations

import math
from functools import total_ordering
from typing import ClassVar

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class

__all__ = ["S_TO_NS", "Duration", "Infinite"]

S_TO_NS = 1_000_000_000


LARGEST = 2**63
"""Durations and times must be below this limit, to fit into signed 64-bit integers (ns)."""


@total_ordering
class Duration:
    """A length of time, in whole nanoseconds.

    Args:
        seconds: Seconds, as an int or float.
        nanoseconds: Nanoseconds to add to ``seconds``.

    Raises:
        OverflowError: if the length does not fit into 64 bits.
    """

    Infinite: ClassVar[Duration]

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0) -> None:
        total = int(seconds * S_TO_NS) + int(nanoseconds)
        if not -LARGEST <= total < LARGEST:
            raise OverflowError(
                f"Total nanoseconds value is too large to store in C duration: {total}"
            )
        self._nanoseconds = total

    @property
    def nanoseconds(self) -> int:
        """The length in nanoseconds."""
        return self._nanoseconds

    def __repr__(self) -> str:
        return f"Duration(nanoseconds={self._nanoseconds})"

    def __str__(self) -> str:
        if self == Infinite:
            return "Infinite"
        return f"{self._nanoseconds} nanoseconds"

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Duration):
            return self._nanoseconds == other._nanoseconds
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self._nanoseconds)

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Duration):
            return self._nanoseconds < other._nanoseconds
        return NotImplemented

    def __add__(self, other: object) -> Duration:
        if isinstance(other, Duration):
            return Duration(nanoseconds=self._nanoseconds + other._nanoseconds)
        return NotImplemented

    def __sub__(self, other: object) -> Duration:
        if isinstance(other, Duration):
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        return NotImplemented

    def __mul__(self, factor: object) -> Duration:
        if isinstance(factor, int | float):
            if math.isinf(factor):
                return Infinite
            return Duration(nanoseconds=self._nanoseconds * factor)
        return NotImplemented

    def __rmul__(self, factor: object) -> Duration:
        return self.__mul__(factor)

    def to_msg(self) -> Anything:
        """Return the duration as a ``builtin_interfaces.msg.Duration``."""
        seconds, rest = divmod(self._nanoseconds, S_TO_NS)
        message: Anything = interface_class("builtin_interfaces/msg/Duration")
        return message(sec=seconds, nanosec=rest)

    @classmethod
    def from_msg(cls, msg: Anything) -> Duration:
        """Return a ``builtin_interfaces.msg.Duration`` as a `Duration`.

        Raises:
            TypeError: if ``msg`` is of another type.
        """
        wanted: Anything = interface_class("builtin_interfaces/msg/Duration")
        if not isinstance(msg, wanted):
            raise TypeError("Must pass a builtin_interfaces.msg.Duration object")
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec)


Infinite = Duration(nanoseconds=LARGEST - 1)
"""The longest duration. It means that there is no time limit."""

Duration.Infinite = Infinite
