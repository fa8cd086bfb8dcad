"""How long a tour takes, at least and at most."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from turtleact.actions.steering import Limits, Steering, rising_times, shortest_time, time_bound

from ...tables import together
from .track import (
    PATROL,
    START,
    eased,
    headings,
    limits,
    points,
    seconds,
    styles,
    tick,
    tours,
)


def test_nothing_to_reach_takes_no_time():
    assert (shortest_time(START, []), time_bound(START, [], Steering())) == (0.0, 0.0)


def test_the_shortest_time_to_targets_in_reach_is_zero():
    assert shortest_time((5.0, 5.0, 1.0), [(5.0, 5.05), (5.05, 5.0), (5.0, 5.0)]) == 0.0


@pytest.mark.parametrize("theta", [0.0, -math.pi])
def test_the_shortest_time_along_a_line_is_that_of_driving_it_either_way(theta):
    assert shortest_time((1.0, 5.0, theta), [(5.0, 5.0), (9.1, 5.0)]) == pytest.approx(4.0)


def test_the_shortest_time_counts_the_turn_at_the_start():
    turn = math.pi / 2 - 0.032
    expected = (4.0 - 0.1) / 2.0 + (turn - math.sin(turn)) / 2.0
    assert shortest_time((5.0, 1.0, 0.0), [(5.0, 5.0)]) == pytest.approx(expected)


def test_the_shortest_time_counts_each_corner_as_two_halves():
    tiny = Limits(tolerance=1e-6, dt=1e-6)
    expected = 4.0 + 2 * (math.pi / 4 - math.sin(math.pi / 4)) / 2.0
    actual = shortest_time((1.0, 1.0, 0.0), [(5.0, 1.0), (5.0, 5.0)], Steering(limits=tiny))
    assert actual == pytest.approx(expected, abs=1e-4)


def test_the_shortest_time_of_the_patrol_is_within_two_per_cent_of_what_is_driven():
    driven = seconds(Steering(), START, PATROL)
    assert 0.98 * driven < shortest_time(START, PATROL) < driven


@given(points, headings, tours)
def test_the_shortest_time_is_below_the_time_bound(place, theta, targets):
    pose = (*place, theta)
    assert shortest_time(pose, targets) <= time_bound(pose, targets, Steering())


@pytest.mark.parametrize(("style", "turned"), [("fastest", 0.0), ("forward", math.pi - 0.032 - 1)])
def test_only_a_turtle_that_cannot_reverse_must_turn_to_what_is_behind(style, turned):
    shortest = shortest_time((5.0, 5.0, 0.0), [(1.0, 5.0)], Steering(style))
    assert shortest == pytest.approx((4.0 - 0.1) / 2.0 + turned / 2.0)


def test_where_it_turns_first_the_shortest_time_counts_the_whole_turn():
    tiny = Limits(tolerance=1e-6, dt=1e-6)
    shortest = shortest_time(
        (1.0, 1.0, 0.0), [(1.0, 5.0), (1.0, 1.0)], Steering("rotate_then_drive", tiny)
    )
    assert shortest == pytest.approx(8.0 / 2.0 + (math.pi / 2 + math.pi) / 2.0, abs=1e-4)


def test_a_disc_that_the_turtle_is_in_asks_for_no_turn():
    steering = Steering("rotate_then_drive")
    there = shortest_time((5.0, 5.0, 0.0), [(5.0, 5.05), (9.0, 5.0)], steering)
    assert there <= (4.0 - 0.1) / 2.0


def test_from_rest_the_shortest_time_is_that_of_getting_up_to_speed():
    slow = Steering(limits=Limits(max_acceleration=0.5, tolerance=1e-6))
    assert shortest_time((1.0, 1.0, 0.0), [(2.0, 1.0)], slow) == pytest.approx(2.0, abs=1e-3)


def test_a_heading_adds_its_turn_to_the_shortest_time():
    there = [(5.0, 5.05)]
    turn = math.pi / 2 - Limits().heading_tolerance
    shortest = shortest_time((5.0, 5.0, 0.0), there, theta=math.pi / 2)
    assert shortest == pytest.approx(turn / 2.0)


def test_a_heading_at_the_end_costs_part_of_its_turn_on_the_way():
    pose, targets = (1.0, 5.0, 0.0), [(9.0, 5.0)]
    turn = math.pi / 2 - 0.05
    added = shortest_time(pose, targets, theta=1.5707963) - shortest_time(pose, targets)
    assert added == pytest.approx((turn - math.sin(turn)) / 2.0, abs=1e-6)


def test_the_shortest_time_of_short_legs_rises_in_many_steps():
    pose, targets = (5.0, 5.0, 0.0), [(5.0, 6.0), (6.0, 6.0), (5.5, 6.5), (5.0, 5.0)]
    times = list(rising_times(pose, targets, Steering()))
    assert len(times) > 20
    assert times[0] < max(times) == shortest_time(pose, targets)


def test_a_heading_without_a_target_is_no_tour():
    steering = Steering()
    assert time_bound(START, [], steering, theta=1.0) == 0.0
    assert shortest_time(START, [], steering, theta=1.0) == 0.0


@given(points, headings, tours, styles, limits | eased, headings)
def test_a_tour_with_a_heading_takes_what_the_bounds_say(
    place, theta, targets, style, limits, last
):
    steering, pose = Steering(style, limits), (*place, theta)
    least = shortest_time(pose, targets, steering, theta=last)
    took = seconds(steering, pose, targets, theta=last)
    # Poses are rounded to float32, and may so be reached by a hair too early.
    assert least - 1e-5 <= took <= time_bound(pose, targets, steering, theta=last)


speeds = st.sampled_from([(2.0, 0.0), (2.0, 2.0), (2.0, -2.0), (0.0, 2.0), (0.0, -2.0)])
pieces = st.lists(st.tuples(speeds, st.integers(1, 45)), min_size=1, max_size=3)


@given(st.lists(pieces, min_size=1, max_size=4), *[st.booleans()] * 2, st.sampled_from([0.01, 0.1]))
# Short ways to and fro.
@example([[((2.0, 2.0), 20)], [((0.0, 2.0), 90), ((2.0, -2.0), 20)]], False, True, 0.01)
# A way so short that directions back along it prove something.
@example([[((2.0, 2.0), 10)]], False, True, 0.1)
def test_nobody_who_keeps_to_the_speeds_is_faster_than_the_shortest_time(
    legs, reverses, has_heading, tolerance
):
    gear, pose, targets, ticks = 1.0, (5.0, 5.0, 0.5), [], 0
    for leg in legs:
        for (linear, angular), length in leg:
            for _ in range(length):
                pose = tick(pose, gear * linear, angular, 0.016).pose
            ticks += length
        off = 0.9 * tolerance
        targets.append((pose[0] + off * math.cos(ticks), pose[1] + off * math.sin(ticks)))
        gear *= -1.0 if reverses else 1.0
    steering = Steering("fastest" if reverses else "forward", Limits(tolerance=tolerance))
    theta = pose[2] if has_heading else None
    assert shortest_time((5.0, 5.0, 0.5), targets, steering, theta=theta) <= ticks * 0.016 + 1e-9


@together
@pytest.mark.parametrize("style", ["fastest", "forward", "rotate_then_drive"])
@pytest.mark.parametrize("seed", range(20))
def test_a_random_patrol_is_near_the_bound_of_its_own_style(style, seed):
    uniform = random.Random(seed).uniform
    pose = (uniform(0.0, 11.0), uniform(0.0, 11.0), uniform(-math.pi, math.pi))
    targets = [(uniform(0.0, 11.0), uniform(0.0, 11.0)) for _ in range(4)]
    steering = Steering(style)
    least = shortest_time(pose, targets, steering)
    assert seconds(steering, pose, targets) <= 1.25 * least
