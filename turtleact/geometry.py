"""Computes angles, bearings and distances in the plane, for steering.

Lengths are in metres. Angles are in radians, counter-clockwise from the x axis. A pose is
``(x, y, theta)``. All values are plain floats and all functions are pure. This module knows nothing
about turtles, worlds or time steps.

Source: Lynch and Park, Modern Robotics, section 3.2 (frames in the plane) and 13.3 (steering).
"""

from __future__ import annotations

import math

__all__ = [
    "bearing",
    "curvature",
    "distance",
    "in_frame",
    "phase",
    "saturate",
    "shortest_turn",
    "wrap_angle",
]


def wrap_angle(angle: float) -> float:
    """Return the same direction as an angle in [-pi, pi).

    Exactly pi becomes -pi. An angle that is already in the range is returned unchanged. Infinity
    and nan have no direction and become nan.

    Args:
        angle: Any angle (rad).

    Example:
        >>> wrap_angle(3.0), wrap_angle(math.pi) == -math.pi
        (3.0, True)
        >>> round(wrap_angle(10.0), 6)
        -2.566371
    """
    if -math.pi <= angle < math.pi:
        return angle
    if not math.isfinite(angle):
        return math.nan
    wrapped = math.remainder(angle, math.tau)
    return -math.pi if wrapped == math.pi else wrapped


def shortest_turn(theta: float, target: float) -> float:
    """Return how far to turn from one heading to another, the short way round.

    If the headings are exactly opposite, the turn is to the right, as in turtlesim.

    Args:
        theta: The current heading (rad), any angle.
        target: The wanted heading (rad), any angle.

    Returns:
        How far to turn (rad), in [-pi, pi); positive means to the left.

    Example:
        >>> round(shortest_turn(3.0, -3.0), 6)
        0.283185
        >>> shortest_turn(0.0, math.pi) == -math.pi
        True
    """
    return wrap_angle(target - theta)


def distance(x0: float, y0: float, x1: float, y1: float) -> float:
    """The distance between two points (m), never negative.

    Example:
        >>> distance(1.0, 1.0, 4.0, 5.0)
        5.0
    """
    return math.hypot(x1 - x0, y1 - y0)


def bearing(x0: float, y0: float, x1: float, y1: float) -> float:
    """The direction from the first point to the second (rad), in [-pi, pi).

    If the two points are equal, the result is 0.

    Example:
        >>> bearing(0.0, 0.0, 0.0, 2.0) == math.pi / 2
        True
        >>> bearing(0.0, 0.0, -1.0, 0.0) == -math.pi
        True
    """
    if x0 == x1 and y0 == y1:
        return 0.0
    return wrap_angle(math.atan2(y1 - y0, x1 - x0))


def phase(way: complex) -> float:
    """Return the direction of a vector as an angle in [-pi, pi] (rad).

    The direction of a zero vector is 0, pi or -pi, depending on the signs of its zeros. CPython's
    ``cmath.phase`` returns the same direction, but raises OverflowError if the angle is too small
    for a float.

    Args:
        way: The vector, ``x + yj``, of any length.

    Example:
        >>> phase(-1j), phase(complex(2.0, 5e-324))
        (-1.5707963267948966, 0.0)
    """
    return math.atan2(way.imag, way.real)


def in_frame(
    point: tuple[float, float], *, x: float, y: float, theta: float
) -> tuple[float, float]:
    """Return a point's coordinates as seen from a pose.

    Args:
        point: x and y of the point (m).
        x: The x coordinate of the pose (m).
        y: The y coordinate of the pose (m).
        theta: Heading of the pose (rad), any angle.

    Returns:
        The distances ahead and to the left (m); negative means behind and to the right.

    Example:
        >>> ahead, left = in_frame((1.0, 3.0), x=1.0, y=1.0, theta=math.pi / 2)
        >>> round(ahead, 9), round(left, 9)
        (2.0, 0.0)
    """
    cos, sin = math.cos(theta), math.sin(theta)
    dx, dy = point[0] - x, point[1] - y
    return cos * dx + sin * dy, cos * dy - sin * dx


def curvature(ahead: float, left: float) -> float:
    """Return the curvature of the arc that leads from the current pose to a point.

    The arc starts in the direction of the heading, so no turn on the spot is necessary. A robot
    with the speed ``v`` follows the arc, forwards or backwards, if the robot turns with
    ``omega = curvature * v``.

    Args:
        ahead: How far ahead the point is (m); see `in_frame`.
        left: How far to the left the point is (m).

    Returns:
        One over the radius (1/m), positive to the left. The curvature is 0 if the point is the
        current position.

    Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, equation 7.

    Example:
        >>> curvature(1.0, 1.0), curvature(2.0, 0.0)
        (1.0, 0.0)
    """
    squared = ahead * ahead + left * left
    return 2.0 * left / squared if squared else 0.0


def saturate(value: float, limit: float) -> float:
    """Return the value, limited to ``[-limit, limit]``.

    Args:
        value: Any value, in the same unit as the limit.
        limit: The limit, zero or more.

    Example:
        >>> saturate(-3.0, 2.0), saturate(0.5, 2.0)
        (-2.0, 0.5)
    """
    return max(-limit, min(limit, value))
