"""Steering: computes a speed and a turn rate from a pose and a target.

This is a small library that only calculates. It uses no topics, messages, clocks or simulator.

- `limits`: what a turtle may do, how its speed may change, and where it aims.
- `law`: the steering law, and `Helm`, which can use one command of the law for several ticks.
- `bounds`: lower and upper bounds of the time of a tour.
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
