"""Steering: from a pose and a target to a speed and a turn rate, nearly as fast as can be.

A small library of its own, pure: it knows no topic, message, clock or simulator. In `limits` is
what a turtle may do, in `law` how it is driven, in `helm` how long a command holds, in `easing` how
speeds change where acceleration is limited, in `bounds` how long a tour takes at least and at most,
in `turning` what turns take of it.
"""

from __future__ import annotations

from turtleact.actions.steering.bounds import rising_times, shortest_time, time_bound
from turtleact.actions.steering.helm import STILL, Helm
from turtleact.actions.steering.law import Steering
from turtleact.actions.steering.limits import Area, Limits, Point, Pose, Speeds, Style

__all__ = [
    "STILL",
    "Area",
    "Helm",
    "Limits",
    "Point",
    "Pose",
    "Speeds",
    "Steering",
    "Style",
    "rising_times",
    "shortest_time",
    "time_bound",
]
