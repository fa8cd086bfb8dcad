"""Steering: from a pose and a target to a speed and a turn rate.

A small library of pure functions. It knows no topic, message, clock or simulator.

- `limits`: what a turtle may do, how its speed may change, and where it aims.
- `law`: the steering law, and how long a command holds.
- `bounds`: how long a tour takes, at least and at most.
"""

from __future__ import annotations

from turtleact.actions.steering.bounds import rising_times, shortest_time, time_bound
from turtleact.actions.steering.law import STILL, Helm, Steering
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
