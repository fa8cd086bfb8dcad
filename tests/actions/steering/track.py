"""A track: a turtle that moves as turtlesim's does, driven by the law of steering alone."""

from __future__ import annotations

import math
import struct
from collections import deque

import msgspec
from hypothesis import strategies as st

from turtleact.actions.steering import Limits, time_bound

SIDE = 11.088889
START = (5.544445, 5.544445, 0.0)
PATROL = [(9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0)]
STYLES = ["natural", "fastest", "forward", "rotate_then_drive"]

coordinates = st.one_of(st.floats(0.0, SIDE), st.sampled_from([0.0, SIDE / 2, SIDE]))
points = st.tuples(coordinates, coordinates)
near = st.tuples(st.floats(4.5, 6.5), st.floats(4.5, 6.5))
headings = st.floats(-math.pi, math.pi, exclude_max=True)
tours = st.lists(points, min_size=1, max_size=3) | st.lists(near, min_size=1, max_size=4)
styles = st.sampled_from(STYLES)
plain = {
    "max_linear": st.floats(0.5, 10.0),
    "max_angular": st.floats(0.25, 10.0),
    "tolerance": st.floats(0.01, 1.0),
}
limits = st.builds(Limits, **plain)
eased = st.builds(
    Limits,
    **plain,
    max_acceleration=st.floats(0.25, 20.0) | st.just(math.inf),
    max_angular_acceleration=st.floats(0.25, 20.0) | st.just(math.inf),
)


class Tick(msgspec.Struct):
    """A command, the pose after it, and how far the walls have pushed the turtle back."""

    linear: float
    angular: float
    pose: tuple[float, float, float]
    pushed: float


def float32(value):
    return struct.unpack("f", struct.pack("f", value))[0]


def clamp(value):
    return max(0.0, min(SIDE, value))


def tick(pose, linear, angular, dt):
    """One tick of turtlesim: turn, then move, then the walls; a pose is published as float32."""
    theta = math.remainder(pose[2] + angular * dt, math.tau)
    x, y = pose[0] + math.cos(theta) * linear * dt, pose[1] + math.sin(theta) * linear * dt
    pushed = max(abs(x - clamp(x)), abs(y - clamp(y)))
    return Tick(linear, angular, (clamp(x), clamp(y), theta), pushed)


def drive(
    steering,
    pose,
    targets,
    *,
    theta=None,
    look_ahead=True,
    late=0,
    teleports=None,
    patience=1.0,
):
    """Every tick until all targets are reached and the turtle rests, or the time bound is over."""
    limits, left = steering.limits, list(targets)
    ticks: list[Tick] = []
    longest = patience * time_bound(pose, targets, steering, theta=theta) / limits.dt
    commands = deque([(0.0, 0.0)] * late)
    speeds = (0.0, 0.0)
    while True:
        seen = tuple(float32(value) for value in pose)
        while len(left) > 1 and steering.is_reached(seen, left[0]):
            left.pop(0)
        if steering.is_reached(seen, left[0], theta=theta if len(left) == 1 else None) and (
            speeds == (0.0, 0.0) or not limits.is_eased
        ):
            return ticks
        assert len(ticks) < longest, f"{seen} has not reached {left[0]}"
        after = left[1] if look_ahead and len(left) > 1 else None
        heading = theta if len(left) == 1 else None
        speeds = steering.command(seen, left[0], after, speeds, theta=heading)
        commands.append(speeds)
        ticks.append(tick(pose, *commands.popleft(), limits.dt))
        pose = (teleports or {}).get(len(ticks), ticks[-1].pose)


def seconds(steering, pose, targets, **options):
    return len(drive(steering, pose, targets, **options)) * steering.limits.dt


def angle_between(pose, point):
    bearing = math.atan2(point[1] - pose[1], point[0] - pose[0])
    return abs(math.remainder(bearing - pose[2], math.tau))
