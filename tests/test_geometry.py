"""Angles, bearings and distances."""

from __future__ import annotations

import doctest
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact import geometry
from turtleact.geometry import (
    bearing,
    curvature,
    distance,
    in_frame,
    saturate,
    shortest_turn,
    wrap_angle,
)

angles = st.floats(-1e6, 1e6)
lengths = st.floats(-100.0, 100.0)


def test_the_examples_of_the_docstrings_hold():
    assert doctest.testmod(geometry).failed == 0


# --- wrap_angle -----------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [math.pi, -math.pi, 3 * math.pi, -3 * math.pi])
def test_half_a_turn_wraps_to_minus_pi(angle):
    assert wrap_angle(angle) == -math.pi


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_wrapped_angle_is_in_the_half_open_range(angle):
    assert -math.pi <= wrap_angle(angle) < math.pi


@given(st.floats(-math.pi, math.pi, exclude_max=True))
def test_an_angle_in_range_comes_back_to_the_last_bit(angle):
    assert wrap_angle(angle) == angle


@given(angles)
def test_a_wrapped_angle_has_the_same_direction(angle):
    wrapped = wrap_angle(angle)
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@pytest.mark.parametrize("angle", [math.inf, -math.inf, math.nan])
def test_an_angle_that_is_not_finite_has_no_direction(angle):
    assert math.isnan(wrap_angle(angle))


# --- shortest_turn --------------------------------------------------------------------------


def test_exactly_opposite_turns_right():
    assert shortest_turn(0.0, math.pi) == -math.pi


@given(angles, angles)
def test_the_shortest_turn_leads_to_the_target(theta, target):
    reached = theta + shortest_turn(theta, target)
    assert math.isclose(math.cos(reached), math.cos(target), abs_tol=1e-9)


@given(angles, angles)
def test_the_shortest_turn_is_at_most_half_a_turn(theta, target):
    assert abs(shortest_turn(theta, target)) <= math.pi


# --- distance, bearing ----------------------------------------------------------------------


@given(lengths, lengths, lengths, lengths)
def test_distance_is_the_same_both_ways(x0, y0, x1, y1):
    assert distance(x0, y0, x1, y1) == distance(x1, y1, x0, y0) >= 0.0


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [(1.0, 0.0, 0.0), (0.0, 1.0, math.pi / 2), (-1.0, 0.0, -math.pi), (0.0, -1.0, -math.pi / 2)],
)
def test_bearing_is_counted_counter_clockwise_from_x(x, y, expected):
    assert bearing(2.0, 3.0, 2.0 + x, 3.0 + y) == expected


def test_bearing_of_a_point_from_itself_is_0():
    assert bearing(1.0, 2.0, 1.0, 2.0) == 0.0


@given(lengths, lengths, lengths, lengths)
def test_going_along_the_bearing_for_the_distance_arrives(x0, y0, x1, y1):
    angle, length = bearing(x0, y0, x1, y1), distance(x0, y0, x1, y1)
    assert math.isclose(x0 + length * math.cos(angle), x1, abs_tol=1e-9)
    assert math.isclose(y0 + length * math.sin(angle), y1, abs_tol=1e-9)


# --- in_frame, curvature --------------------------------------------------------------------


@given(lengths, lengths, lengths, lengths, angles)
def test_a_point_in_a_frame_keeps_its_distance(px, py, x, y, theta):
    ahead, left = in_frame((px, py), x=x, y=y, theta=theta)
    assert math.isclose(math.hypot(ahead, left), distance(x, y, px, py), abs_tol=1e-9)


def test_a_point_on_the_left_has_a_positive_left():
    ahead, left = in_frame((0.0, 1.0), x=0.0, y=0.0, theta=0.0)
    assert (ahead, left) == (0.0, 1.0)


@given(st.floats(-5.0, 5.0), st.floats(0.1, 5.0))
def test_a_point_lies_on_the_circle_of_its_curvature(ahead, left):
    radius = 1.0 / curvature(ahead, left)
    assert math.isclose(math.hypot(ahead, left - radius), radius, rel_tol=1e-9)


def test_no_curvature_leads_to_where_one_stands():
    assert curvature(0.0, 0.0) == 0.0


# --- saturate -------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "expected"), [(3.0, 2.0), (-3.0, -2.0), (1.5, 1.5)])
def test_saturate_keeps_a_value_within_the_limit(value, expected):
    assert saturate(value, 2.0) == expected
