"""Points in time, and the kinds of clocks that they belong to."""

from __future__ import annotations

from enum import IntEnum
from functools import total_ordering
from typing import overload

from turtleact.rclpy.duration import LARGEST, S_TO_NS, Duration
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class

__all__ = ["ClockType", "Time"]


class ClockType(IntEnum):
    """The kind of time that a clock shows."""

    UNINITIALIZED = 0
    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


@total_ordering
class Time:
    """A point in time, in whole nanoseconds since the start of its clock.

    Args:
        seconds: The seconds since the start of the clock.
        nanoseconds: Nanoseconds to add to ``seconds``.
        clock_type: The kind of clock that the time belongs to.

    Raises:
        ValueError: if ``seconds`` or ``nanoseconds`` is negative.
        OverflowError: if the time in nanoseconds is 2**63 or more.
    """

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
        self._nanoseconds = total
        self._clock_type = clock_type

    @property
    def nanoseconds(self) -> int:
        """The time in nanoseconds since the start of the clock."""
        return self._nanoseconds

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock that the time belongs to."""
        return self._clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return the time as whole seconds and the remaining nanoseconds."""
        return divmod(self._nanoseconds, S_TO_NS)

    def __repr__(self) -> str:
        return f"Time(nanoseconds={self._nanoseconds}, clock_type={self._clock_type.name})"

    def __add__(self, other: object) -> Time:
        if not isinstance(other, Duration):
            return NotImplemented
        try:
            return self._moved(other.nanoseconds)
        except OverflowError as error:
            raise OverflowError("Addition leads to overflow in C storage.") from error

    def __radd__(self, other: object) -> Time:
        return self.__add__(other)

    @overload
    def __sub__(self, other: Time) -> Duration: ...
    @overload
    def __sub__(self, other: Duration) -> Time: ...
    def __sub__(self, other: Time | Duration) -> Duration | Time:
        if isinstance(other, Time):
            if self._clock_type != other._clock_type:
                raise TypeError("Can't subtract times with different clock types")
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        if isinstance(other, Duration):
            try:
                return self._moved(-other.nanoseconds)
            except ValueError as error:
                raise ValueError("Subtraction leads to negative time") from error
        return NotImplemented

    def _moved(self, nanoseconds: int) -> Time:
        return Time(nanoseconds=self._nanoseconds + nanoseconds, clock_type=self._clock_type)

    def _other(self, other: Time) -> int:
        if self._clock_type != other._clock_type:
            raise TypeError("Can't compare times with different clock types")
        return other._nanoseconds

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Time):
            return self._nanoseconds == self._other(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash((self._nanoseconds, self._clock_type))

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Time):
            return self._nanoseconds < self._other(other)
        return NotImplemented

    def to_msg(self) -> Anything:
        """Return the time as a ``builtin_interfaces.msg.Time``."""
        seconds, rest = self.seconds_nanoseconds()
        message: Anything = interface_class("builtin_interfaces/msg/Time")
        return message(sec=seconds, nanosec=rest)

    @classmethod
    def from_msg(cls, msg: Anything, clock_type: ClockType = ClockType.ROS_TIME) -> Time:
        """Return a ``builtin_interfaces.msg.Time`` as a `Time`.

        Raises:
            TypeError: if ``msg`` is of another type.
        """
        wanted: Anything = interface_class("builtin_interfaces/msg/Time")
        if not isinstance(msg, wanted):
            raise TypeError("Must pass a builtin_interfaces.msg.Time object")
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec, clock_type=clock_type)
