"""Speeds that change no faster than they may, and still end where they should.

The arithmetic is that of ticks, not of smooth time: a speed holds for a tick, and the next one
differs from it by the acceleration times the tick at most. The same functions serve lengths (m) and
angles (rad). An infinite acceleration is allowed everywhere.

Source: Lynch and Park, Modern Robotics, section 9.2.2.2 (trapezoidal motion profiles).
"""

from __future__ import annotations

import math

__all__ = ["ramp", "ramp_time", "stopping_speed"]


def ramp(wanted: float, now: float, most: float) -> float:
    """The speed of the next tick: the wanted one, or as near to it as it may come.

    Args:
        wanted: In the unit of the others.
        now: The speed of this tick.
        most: The largest change from tick to tick, zero or more; may be infinite.

    Example:
        >>> ramp(2.0, 0.5, 0.25), ramp(0.5, 0.6, 0.25)
        (0.75, 0.5)
    """
    return max(now - most, min(now + most, wanted))


def stopping_speed(room: float, acceleration: float, dt: float) -> float:
    """The highest speed for the next tick from which it is still possible to stop in some room.

    From v, ticks cover v dt + (v - a dt) dt + …, which is (v + a dt / 2)² / 2a at most; and a
    speed up to a dt is gone after its tick.

    Args:
        room: What may still be covered, 0 or more (m or rad).
        acceleration: Above zero (m/s² or rad/s²).
        dt: Length of a tick (s).

    Example:
        >>> stopping_speed(0.5, math.inf, 0.25)
        2.0
        >>> stopping_speed(8.0, 1.0, 0.5)
        3.75
    """
    at_once = room / dt
    if math.isinf(acceleration):
        return at_once
    change = acceleration * dt
    return min(at_once, max(change, math.sqrt(2.0 * acceleration * room) - change / 2.0))


def ramp_time(length: float, speed: float, acceleration: float) -> float:
    """The shortest time (s) to cover a length from rest, moving at its end.

    At the acceleration up to the speed, and on at the speed.

    Args:
        length: 0 or more (m or rad).
        speed: The highest, above zero (m/s or rad/s).
        acceleration: Above zero (m/s² or rad/s²).

    Example:
        >>> ramp_time(4.0, 2.0, math.inf), ramp_time(4.0, 2.0, 2.0), ramp_time(0.25, 2.0, 2.0)
        (2.0, 2.5, 0.5)
    """
    rising = speed / acceleration
    if length >= speed * rising / 2.0:
        return length / speed + rising / 2.0
    return math.sqrt(2.0 * length / acceleration)
