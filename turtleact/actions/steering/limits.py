"""What a turtle may do: its speeds, accelerations, tolerances, and where it stays."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal, TypeAlias

import msgspec

from turtleact.errors import InvalidMessage

__all__ = ["Area", "Limits", "Point", "Pose", "Speeds", "Style"]

Pose: TypeAlias = tuple[float, float, float]
"""x and y (m), and the heading (rad, any angle)."""

Point: TypeAlias = tuple[float, float]
"""x and y (m)."""

Speeds: TypeAlias = tuple[float, float]
"""Linear (m/s, negative in reverse) and angular speed (rad/s, positive to the left)."""

Style: TypeAlias = Literal["arc", "forward", "rotate_then_drive"]


class Area(msgspec.Struct, frozen=True):
    """The rectangle that the turtle stays in (m); without arguments it has no end."""

    left: float = -math.inf
    bottom: float = -math.inf
    right: float = math.inf
    top: float = math.inf


class Limits(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """What a turtle may do, and how near is near enough.

    Attributes:
        max_linear: Highest speed, forwards and backwards (m/s).
        max_angular: Highest turn rate, to either side (rad/s).
        max_acceleration: How fast the speed may change (m/s²); may be infinite.
        max_angular_acceleration: How fast the turn rate may change (rad/s²); may be infinite.
        tolerance: A target at this distance or nearer is reached (m).
        heading_tolerance: Where a heading is wanted too, it may be off by so much (rad).
        dt: Length of a tick (s).
        area: Where the turtle stays; a target outside is driven to all the same.

    Raises:
        InvalidMessage: if a number is not above zero, or not finite where it must be, or a tick
            turns over pi/2 rad.
    """

    max_linear: float = 2.0
    max_angular: float = 2.0
    max_acceleration: float = math.inf
    max_angular_acceleration: float = math.inf
    tolerance: float = 0.1
    heading_tolerance: float = 0.05
    dt: float = 0.016
    area: Area = Area(0.0, 0.0, 11.088889, 11.088889)

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "tolerance", "heading_tolerance", "dt"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidMessage(name, f"must be finite and above zero, not {value}")
        for name in ("max_acceleration", "max_angular_acceleration"):
            value = getattr(self, name)
            if not value > 0.0:
                raise InvalidMessage(name, f"must be above zero, not {value}")
        if self.turn > math.pi / 2:
            raise InvalidMessage("dt", f"a tick may turn pi/2 rad at most, not {self.turn}")

    @cached_property
    def is_eased(self) -> bool:
        """Whether an acceleration is limited."""
        return min(self.max_acceleration, self.max_angular_acceleration) < math.inf

    @cached_property
    def step(self) -> float:
        """The way of one tick at full speed (m)."""
        return self.max_linear * self.dt

    @cached_property
    def turn(self) -> float:
        """The turn of one tick at full rate (rad)."""
        return self.max_angular * self.dt

    @cached_property
    def radius(self) -> float:
        """Of the turning circle at full speed (m)."""
        return self.max_linear / self.max_angular
