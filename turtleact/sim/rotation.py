"""turtlesim's controller of ``rotate_absolute``: turn at 1 rad/s until it is close enough.

Pure: one call a tick. Where turtlesim rounds to float32, so does this.

Source: turtlesim 1.8.2, ``Turtle::update`` and ``Turtle::rotateAbsoluteAcceptCallback``.
"""

from __future__ import annotations

from array import array
from typing import Final

from turtleact.sim.kinematics import StepRule, half_turn, wrap

__all__ = ["SPEED", "TOLERANCE", "Rotation"]

SPEED: Final = 1.0
"""How fast a turtle turns (rad/s)."""

TOLERANCE: Final = 0.02
"""How close to its target a turtle stops (rad)."""

_HALF: Final = half_turn(StepRule.EULER)


class Rotation:
    """A turn to a heading, tick by tick.

    Args:
        target: The heading wanted (rad), any finite angle.
        theta: The heading at the start (rad).

    Attributes:
        remaining: How far it still was before the last tick (rad, float32): positive to the left.
        delta: The heading at the start minus that before the last tick (rad, float32).
    """

    def __init__(self, target: float, theta: float) -> None:
        self.remaining = 0.0
        self.delta = 0.0
        (wanted,) = array("f", (target,))
        self._target = wrap(wanted, _HALF)
        self._start = theta

    def tick(self, theta: float) -> float | None:
        """How to turn in a tick that begins with this heading (rad).

        Exactly opposite turns right.

        Returns:
            The turn rate (rad/s), or None if the turtle is there and is to stand still.
        """
        now, turned = array("f", (theta, self._start - theta))
        remaining = wrap(self._target - now, _HALF)
        self.remaining, self.delta = array("f", (remaining, wrap(turned, _HALF)))
        if abs(wrap(now - self._target, _HALF)) < TOLERANCE:
            return None
        return -SPEED if remaining < 0.0 else SPEED
