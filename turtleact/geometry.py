"""Angles, bearings and distances in the plane: the arithmetic of steering.

Lengths are in metres, angles in radians, counted counter-clockwise from the x axis; a pose is
``(x, y, theta)``. Everything is a plain float and every function is pure. Knows no turtle, no
world and no step length.

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
    """The same direction as an angle in [-pi, pi).

    Exactly pi becomes -pi; an angle that is in the range already comes back to the last bit;
    one that is not finite has no direction and becomes nan.

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
    """How far to turn from one heading to another, the short way round.

    Exactly opposite turns right, as turtlesim does.

    Args:
        theta: The heading now (rad), any angle.
        target: The heading wanted (rad), any angle.

    Returns:
        Angle in [-pi, pi), positive to the left.

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

    Two equal points have no direction between them; the answer is then 0.

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
    """The direction of a vector: an angle in [-pi, pi] (rad); 0 and pi by its signs for 0.

    What ``cmath.phase`` is; but CPython's raises OverflowError for an angle that is too small for a
    float.

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
    """A point as it is seen from a pose.

    Args:
        point: x and y of the point (m).
        x: Of the pose (m).
        y: Of the pose (m).
        theta: Heading of the pose (rad), any angle.

    Returns:
        How far the point is ahead and how far to the left (m); negative: behind, to the right.

    Example:
        >>> ahead, left = in_frame((1.0, 3.0), x=1.0, y=1.0, theta=math.pi / 2)
        >>> round(ahead, 9), round(left, 9)
        (2.0, 0.0)
    """
    cos, sin = math.cos(theta), math.sin(theta)
    dx, dy = point[0] - x, point[1] - y
    return cos * dx + sin * dy, cos * dy - sin * dx


def curvature(ahead: float, left: float) -> float:
    """The curvature of the circle along which a point is reached without turning first.

    The circle touches the heading; ``omega = curvature * v`` drives along it, forwards or
    backwards.

    Args:
        ahead: How far the point is ahead (m); see `in_frame`.
        left: How far it is to the left (m).

    Returns:
        One over the radius (1/m), positive to the left; 0 for the point where one stands.

    Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, equation 7.

    Example:
        >>> curvature(1.0, 1.0), curvature(2.0, 0.0)
        (1.0, 0.0)
    """
    squared = ahead * ahead + left * left
    return 2.0 * left / squared if squared else 0.0


def saturate(value: float, limit: float) -> float:
    """The value, or the nearest one within ``[-limit, limit]``.

    Args:
        value: In the unit of the limit.
        limit: Zero or more.

    Example:
        >>> saturate(-3.0, 2.0), saturate(0.5, 2.0)
        (-2.0, 0.5)
    """
    return max(-limit, min(limit, value))
