"""Points in time, lengths of time, and the kinds of clocks."""

from __future__ import annotations

import math
from enum import IntEnum
from functools import total_ordering
from typing import ClassVar, Self, overload

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class

__all__ = ["S_TO_NS", "ClockType", "Duration", "Infinite", "Time"]

S_TO_NS = 1_000_000_000

LARGEST = 2**63
"""Durations and times must be below this limit, to fit into signed 64-bit integers (ns)."""


class ClockType(IntEnum):
    """The kind of time that a clock shows."""

    UNINITIALIZED = 0
    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


@total_ordering
class _Nanoseconds:
    """A number of nanoseconds, which compares only with numbers of its own class."""

    MESSAGE: ClassVar[str]

    def __init__(self, nanoseconds: int) -> None:
        self._nanoseconds = nanoseconds

    @property
    def nanoseconds(self) -> int:
        """The whole length, or the time since the start of the clock (ns)."""
        return self._nanoseconds

    def _check(self, other: Self) -> None:
        """Raise TypeError if this object cannot be compared with another one of its class."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return NotImplemented
        self._check(other)
        return self._nanoseconds == other._nanoseconds

    def __lt__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return NotImplemented
        self._check(other)
        return self._nanoseconds < other._nanoseconds

    def __hash__(self) -> int:
        return hash(self._nanoseconds)

    def to_msg(self) -> Anything:
        """Return the message of package ``builtin_interfaces`` that has the same value."""
        seconds, rest = divmod(self._nanoseconds, S_TO_NS)
        return interface_class(self.MESSAGE)(sec=seconds, nanosec=rest)

    @classmethod
    def _of(cls, message: Anything) -> int:
        """Return the nanoseconds in a message.

        Raises:
            TypeError: if the message is of another type.
        """
        if not isinstance(message, interface_class(cls.MESSAGE)):
            raise TypeError(f"Must pass a {cls.MESSAGE.replace('/', '.')} object")
        return int(message.sec * S_TO_NS + message.nanosec)


class Duration(_Nanoseconds):
    """A length of time, in whole nanoseconds.

    Args:
        seconds: Seconds, as an int or float.
        nanoseconds: Nanoseconds to add to ``seconds``.

    Raises:
        OverflowError: if the length does not fit into 64 bits.
    """

    MESSAGE = "builtin_interfaces/msg/Duration"
    Infinite: ClassVar[Duration]

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0) -> None:
        total = int(seconds * S_TO_NS) + int(nanoseconds)
        if not -LARGEST <= total < LARGEST:
            raise OverflowError(
                f"Total nanoseconds value is too large to store in C duration: {total}"
            )
        super().__init__(total)

    def __repr__(self) -> str:
        return f"Duration(nanoseconds={self._nanoseconds})"

    def __str__(self) -> str:
        return "Infinite" if self == Infinite else f"{self._nanoseconds} nanoseconds"

    def __add__(self, other: object) -> Duration:
        if isinstance(other, Duration):
            return Duration(nanoseconds=self._nanoseconds + other._nanoseconds)
        return NotImplemented

    def __sub__(self, other: object) -> Duration:
        if isinstance(other, Duration):
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        return NotImplemented

    def __mul__(self, factor: object) -> Duration:
        if not isinstance(factor, int | float):
            return NotImplemented
        return Infinite if math.isinf(factor) else Duration(nanoseconds=self._nanoseconds * factor)

    __rmul__ = __mul__

    @classmethod
    def from_msg(cls, msg: Anything) -> Duration:
        """Return a ``builtin_interfaces.msg.Duration`` as a `Duration`.

        Raises:
            TypeError: if ``msg`` is of another type.
        """
        return cls(nanoseconds=cls._of(msg))


Infinite = Duration(nanoseconds=LARGEST - 1)
"""The longest duration. It means that there is no time limit."""

Duration.Infinite = Infinite


class Time(_Nanoseconds):
    """A point in time, in whole nanoseconds since the start of its clock.

    Args:
        seconds: The seconds since the start of the clock.
        nanoseconds: Nanoseconds to add to ``seconds``.
        clock_type: The kind of clock that the time belongs to.

    Raises:
        ValueError: if ``seconds`` or ``nanoseconds`` is negative.
        OverflowError: if the time in nanoseconds is 2**63 or more.
    """

    MESSAGE = "builtin_interfaces/msg/Time"

    def __init__(
        self,
        *,
        seconds: float = 0,
        nanoseconds: float = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        if seconds < 0:
            raise ValueError("Seconds value must not be negative")
        if nanoseconds < 0:
            raise ValueError("Nanoseconds value must not be negative")
        total = int(seconds * S_TO_NS) + int(nanoseconds)
        if total >= LARGEST:
            raise OverflowError(
                f"Total nanoseconds value is too large to store in C time point: {total}"
            )
        super().__init__(total)
        self._clock_type = clock_type

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock that the time belongs to."""
        return self._clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return the time as whole seconds and the remaining nanoseconds."""
        return divmod(self._nanoseconds, S_TO_NS)

    def __repr__(self) -> str:
        return f"Time(nanoseconds={self._nanoseconds}, clock_type={self._clock_type.name})"

    def _check(self, other: Self) -> None:
        if self._clock_type != other._clock_type:
            raise TypeError("Can't compare times with different clock types")

    def __add__(self, other: object) -> Time:
        if not isinstance(other, Duration):
            return NotImplemented
        try:
            return self._moved(other.nanoseconds)
        except OverflowError as error:
            raise OverflowError("Addition leads to overflow in C storage.") from error

    __radd__ = __add__

    @overload
    def __sub__(self, other: Time) -> Duration: ...
    @overload
    def __sub__(self, other: Duration) -> Time: ...
    def __sub__(self, other: Time | Duration) -> Duration | Time:
        if isinstance(other, Time):
            if self._clock_type != other._clock_type:
                raise TypeError("Can't subtract times with different clock types")
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        if not isinstance(other, Duration):
            return NotImplemented
        try:
            return self._moved(-other.nanoseconds)
        except ValueError as error:
            raise ValueError("Subtraction leads to negative time") from error

    def _moved(self, nanoseconds: int) -> Time:
        return Time(nanoseconds=self._nanoseconds + nanoseconds, clock_type=self._clock_type)

    @classmethod
    def from_msg(cls, msg: Anything, clock_type: ClockType = ClockType.ROS_TIME) -> Time:
        """Return a ``builtin_interfaces.msg.Time`` as a `Time`.

        Raises:
            TypeError: if ``msg`` is of another type.
        """
        return cls(nanoseconds=cls._of(msg), clock_type=clock_type)
