"""Times as ROS 2 sends them, and as whole nanoseconds.

Source: builtin_interfaces/msg/Time.
"""

from __future__ import annotations

from typing import Final

from turtleact.interfaces.standard import Time

__all__ = ["SECOND", "nanoseconds", "stamp_of"]

SECOND: Final = 1_000_000_000
"""A second (ns)."""


def nanoseconds(stamp: Time) -> int:
    """A time in ns since the epoch.

    >>> nanoseconds(Time(sec=1, nanosec=2))
    1000000002
    """
    return stamp.sec * SECOND + stamp.nanosec


def stamp_of(time: int) -> Time:
    """What is sent for a time in ns since the epoch.

    >>> stamp_of(1_000_000_002)
    Time(sec=1, nanosec=2)
    """
    return Time(*divmod(time, SECOND))
