"""The law of steering, over a turtle that moves as turtlesim's does."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from turtleact.actions.steering import Area, Limits, Steering, shortest_time
from turtleact.errors import InvalidMessage

from ...tables import together
from .track import (
    PATROL,
    SIDE,
    START,
    STYLES,
    angle_between,
    drive,
    eased,
    headings,
    limits,
    near,
    points,
    seconds,
    styles,
    tick,
    tours,
)

# How fast


@pytest.mark.parametrize(
    ("style", "longest"),
    [("natural", 10.8), ("fastest", 10.2), ("forward", 10.8), ("rotate_then_drive", 13.0)],
)
def test_the_patrol_of_four_targets_is_driven_in_time(style, longest):
    assert seconds(Steering(style), START, PATROL) <= longest


def test_looking_ahead_saves_time():
    steering = Steering()
    blind = seconds(steering, START, PATROL, look_ahead=False)
    assert seconds(steering, START, PATROL) < blind - 0.2


@given(points, headings, tours, styles, limits)
def test_every_tour_ends_within_the_time_bound(place, theta, targets, style, limits):
    drive(Steering(style, limits), (*place, theta), targets)


@given(points, headings, tours, styles, limits)
def test_no_tour_ends_before_the_shortest_time(place, theta, targets, style, limits):
    pose = (*place, theta)
    least = shortest_time(pose, targets, Steering(style, limits))
    # Poses are rounded to float32, and may so be reached by a hair too early.
    assert seconds(Steering(style, limits), pose, targets) >= least - 1e-5


@together
@pytest.mark.parametrize("seed", range(40))
def test_a_random_patrol_takes_at_most_a_quarter_longer_than_the_shortest_time(seed):
    uniform = random.Random(seed).uniform
    pose = (uniform(0.0, SIDE), uniform(0.0, SIDE), uniform(-math.pi, math.pi))
    targets = [(uniform(0.0, SIDE), uniform(0.0, SIDE)) for _ in range(4)]
    assert seconds(Steering(), pose, targets) <= 1.25 * shortest_time(pose, targets)


@pytest.mark.parametrize("style", STYLES)
def test_a_slow_turtle_arrives_within_the_time_bound(style):
    slow = Limits(max_linear=0.1, max_angular=0.1, tolerance=0.01)
    drive(Steering(style, slow), START, [(5.0, 5.3), (5.3, 5.6)])


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("dt", [0.001, 0.1, math.pi / 20])
def test_a_tick_may_have_any_length(style, dt):
    limits = Limits(max_linear=1.0, max_angular=10.0, dt=dt)
    drive(Steering(style, limits), START, [(5.0, 5.3), (7.0, 5.6)])


# Always arriving


@together
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("theta", [0.0, 1.0, math.pi / 2, -3.0, -math.pi])
@pytest.mark.parametrize("away", [0.11, 0.3, 0.5, 0.99, 1.5, 2.0])
def test_a_target_inside_the_turning_circle_is_reached(style, theta, away):
    drive(Steering(style), (5.0, 5.0, theta), [(5.0, 5.0 + away)])


def test_a_target_inside_the_turning_circle_is_backed_away_from_first():
    linear, angular = Steering().command((5.0, 5.0, 0.0), (5.1, 5.5))
    assert (linear, angular) == (-2.0, 2.0)


def test_a_forward_turtle_turns_on_the_spot_inside_the_turning_circle():
    assert Steering("forward").command((5.0, 5.0, 0.0), (5.1, 5.5)) == (0.0, 2.0)


@pytest.mark.parametrize("style", STYLES)
def test_the_same_target_twice_costs_nothing(style):
    steering = Steering(style)
    once, twice = [PATROL[0]], [PATROL[0], PATROL[0]]
    assert seconds(steering, START, twice) == seconds(steering, START, once)


@pytest.mark.parametrize("distance", [0.0, 0.05, 0.1])
def test_a_target_where_the_turtle_stands_is_reached_at_once(distance):
    assert drive(Steering(), (5.0, 5.0, 0.0), [(5.0, 5.0 + distance)]) == []


@pytest.mark.parametrize("style", STYLES)
def test_an_angle_that_is_too_small_for_a_float_is_none(style):
    aside, straight = [(4.0, 5e-324), (6.0, 0.0)], [(4.0, 0.0), (6.0, 0.0)]
    steering, start = Steering(style), (1.0, 0.0, 0.0)
    assert drive(steering, start, aside) == drive(steering, start, straight)


def test_a_turtle_at_its_target_stands_still():
    assert Steering().command((5.0, 5.0, 0.0), (5.0, 5.05), (9.0, 9.0)) == (0.0, 0.0)


@given(st.integers(1, 3), headings, st.lists(near, min_size=1, max_size=4), styles)
# A target comes to lie square to the heading, inside the turning circle.
@example(3, 0.0, [(5.5, 5.0), (5.125, 5.34375)], "fastest")
@example(2, -2.042812, [(5.859983, 5.84375), (5.796912, 4.84375), (5.959782, 4.962568)], "fastest")
# Two discs overlap by so little that hardly an arc leads through both.
@example(3, 2.406939867, [(5.438147016, 5.34375), (5.4375, 5.521519948)], "fastest")
def test_commands_that_come_late_still_arrive(late, theta, targets, style):
    pose = (5.544445, 5.544445, theta)
    drive(Steering(style), pose, targets, late=late, patience=2.0)


def test_a_fast_turtle_reaches_two_targets_beside_each_other_by_late_commands():
    fast = Limits(max_linear=8.88, max_angular=8.53)
    targets = [(7.018, 3.852), (6.975, 3.711)]
    drive(Steering("forward", fast), (6.012, 2.688, -1.491), targets, late=3, patience=2.0)


@pytest.mark.parametrize("style", STYLES)
def test_a_turtle_that_is_teleported_on_the_way_still_arrives(style):
    teleports = {50: (1.0, 1.0, 3.0), 150: (10.0, 10.0, -1.0)}
    drive(Steering(style), START, PATROL, teleports=teleports, patience=2.0)


@pytest.mark.parametrize("style", STYLES)
def test_a_target_outside_the_area_is_driven_to(style):
    steering = Steering(style, Limits(area=Area(0.0, 0.0, 5.0, 5.0)))
    drive(steering, START, [(9.0, 9.0), (3.0, 3.0)])


# Numbers beyond the first 30 have short legs that turn back.
@pytest.mark.parametrize(
    ("style", "others"),
    [
        ("fastest", []),
        ("forward", [3952, 4027, 4539, 5170, 6482, 6643, 9547]),
        ("rotate_then_drive", [5170, 5444, 7926]),
    ],
)
def test_patrols_drawn_by_lot_take_a_quarter_more_than_their_bound_at_most(style, others):
    steering = Steering(style)
    longest = 0.0
    for number in [*range(30), *others]:
        uniform = random.Random(number).uniform
        pose = (uniform(0.0, SIDE), uniform(0.0, SIDE), uniform(-math.pi, math.pi))
        targets = [(uniform(0.0, SIDE), uniform(0.0, SIDE)) for _ in range(4)]
        took = seconds(steering, pose, targets)
        longest = max(longest, took / shortest_time(pose, targets, steering))
    assert longest <= 1.25


@pytest.mark.parametrize("style", STYLES)
def test_two_targets_near_each_other_are_reached_together(style):
    steering = Steering(style)
    both = seconds(steering, (1.0, 5.0, 0.0), [(5.0, 4.92), (5.0, 5.08)])
    assert both < seconds(steering, (1.0, 5.0, 0.0), [(5.0, 5.0)]) + 0.05


@pytest.mark.parametrize("off", [-0.5, 0.5])
def test_the_forward_style_does_not_drive_past_a_target_that_lies_back(off):
    pose, targets = (5.0, 5.4, off - math.pi / 2), [(5.0, 5.0), (5.0, 5.16)]
    assert seconds(Steering("forward"), pose, targets) < 0.4


def test_the_forward_style_turns_to_the_next_target_before_it_reaches_one():
    assert Steering("forward").command((4.7, 5.0, 0.0), (5.0, 5.05), (3.0, 5.5)) == (2.0, 2.0)


# Within limits


@given(points, headings, tours, styles, limits)
def test_no_command_is_over_a_limit(place, theta, targets, style, limits):
    for each in drive(Steering(style, limits), (*place, theta), targets):
        assert abs(each.linear) <= limits.max_linear
        assert abs(each.angular) <= limits.max_angular


@given(points, headings, tours, styles, limits)
def test_no_wall_is_ever_hit(place, theta, targets, style, limits):
    ticks = drive(Steering(style, limits), (*place, theta), targets)
    # From a pose on the wall, rounding alone may lead outside.
    assert max((tick.pushed for tick in ticks), default=0.0) < 1e-6


@pytest.mark.parametrize("theta", [0.0, math.pi / 4, math.pi / 2])
def test_a_turtle_that_faces_a_corner_of_the_world_turns_there(theta):
    ticks = drive(Steering("forward"), (SIDE - 0.2, SIDE - 0.2, theta), [(9.0, SIDE - 0.1)])
    assert max(tick.pushed for tick in ticks) == 0.0


def test_an_approach_does_not_swing_wide_out_of_the_area():
    targets = [(SIDE - 0.05, 5.0), (5.0, 8.0)]
    ticks = drive(Steering("forward"), (SIDE - 0.05, 1.0, math.pi / 2), targets)
    assert max(tick.pose[0] for tick in ticks) < SIDE


def test_without_an_area_a_turtle_may_go_anywhere():
    steering = Steering(limits=Limits(area=Area()))
    assert steering.command((-70.0, 1e6, 0.0), (-60.0, 1e6)) == (2.0, 0.0)


# The way it drives


@given(headings, near, st.sampled_from(["forward", "rotate_then_drive"]))
def test_a_turtle_turns_the_short_way_round(theta, target, style):
    angular = Steering(style).command((1.0, 1.0, theta), target)[1]
    bearing = math.atan2(target[1] - 1.0, target[0] - 1.0)
    assert angular * math.remainder(bearing - theta, math.tau) >= 0.0


@given(headings, near)
def test_a_turtle_that_may_reverse_turns_little_more_than_a_quarter(theta, target):
    ticks = drive(Steering(), (1.0, 1.0, theta), [target])
    assert sum(abs(tick.angular) for tick in ticks) * 0.016 <= 1.2 * math.pi / 2


def gears(ticks):
    return {math.copysign(1.0, each.linear) for each in ticks if each.linear}


@given(points, headings, points, limits)
def test_the_natural_style_keeps_its_gear_on_the_way_to_a_target(place, theta, target, limits):
    assert len(gears(drive(Steering("natural", limits), (*place, theta), [target]))) <= 1


# Degrees off straight behind, and metres; a turn of 1 rad takes as long as 1 m.
@pytest.mark.parametrize(
    ("off", "away", "gear"),
    [(0, 1.55, -1.0), (0, 1.75, 1.0), (30, 0.6, -1.0), (30, 0.85, 1.0), (60, 0.5, 1.0)],
)
@pytest.mark.parametrize("late", [0, 3])
def test_the_natural_style_reverses_where_turning_round_takes_three_times_as_long(
    off, away, gear, late
):
    seen = math.pi - math.radians(off)
    target = (5.0 + away * math.cos(seen), 5.0 + away * math.sin(seen))
    assert gears(drive(Steering("natural"), (5.0, 5.0, 0.0), [target], late=late)) == {gear}


def test_exactly_opposite_turns_right():
    assert Steering("forward").command((5.0, 5.0, 0.0), (1.0, 5.0)) == (0.0, -2.0)


@pytest.mark.parametrize("turning", [1.0, -1.0])
@pytest.mark.parametrize("aside", [0.1, -0.1])
def test_almost_opposite_goes_on_turning_as_before(turning, aside):
    command = Steering("forward").command(
        (5.0, 5.0, 0.0), (1.0, 5.0 + aside), speeds=(0.0, turning)
    )
    assert command == (0.0, 2.0 * turning)


@pytest.mark.parametrize("turning", [1.0, -1.0])
@pytest.mark.parametrize("ahead", [0.1, -0.1])
def test_square_to_the_heading_goes_on_turning_as_before(turning, ahead):
    angular = Steering().command((5.0, 5.0, 0.0), (5.0 + ahead, 9.0), speeds=(0.0, turning))[1]
    assert angular == 2.0 * turning


def test_a_target_behind_is_driven_to_in_reverse():
    assert Steering().command((5.0, 5.0, 0.0), (1.0, 5.0)) == (-2.0, 0.0)


@given(points, headings, tours, limits)
def test_the_forward_style_never_reverses(place, theta, targets, limits):
    ticks = drive(Steering("forward", limits), (*place, theta), targets)
    assert all(tick.linear >= 0.0 for tick in ticks)


def test_rotate_then_drive_stands_until_it_faces_its_target():
    ticks = drive(Steering("rotate_then_drive"), START, [(5.0, 9.0)])
    assert all(tick.linear == 0.0 for tick in ticks if angle_between(tick.pose, (5.0, 9.0)) > 0.1)


def test_rotate_then_drive_drives_straight_once_it_faces_its_target():
    ticks = drive(Steering("rotate_then_drive"), START, [(5.0, 9.0)])
    start = next(i for i, tick in enumerate(ticks) if tick.linear)
    assert {tick.linear for tick in ticks[start:]} == {2.0}


def test_the_last_turn_ends_exactly_on_the_bearing():
    target = (9.0, 5.05)
    pose = tick((5.0, 5.0, 0.0), *Steering().command((5.0, 5.0, 0.0), target), 0.016).pose
    assert pose[2] == pytest.approx(math.atan2(0.05, 4.0), abs=1e-12)


def test_the_last_step_ends_where_the_target_is():
    fast = Steering(limits=Limits(max_linear=10.0, tolerance=0.01))
    linear, _ = fast.command((5.0, 5.0, 0.0), (5.08, 5.0))
    assert linear * 0.016 == pytest.approx(0.08)


def test_an_approach_swings_wide_of_the_next_turn():
    pose, target = (1.0, 5.0, 0.0), (5.0, 5.0)
    assert Steering().command(pose, target, (5.0, 9.0))[1] < 0.0


def test_two_legs_in_one_line_are_driven_straight():
    assert Steering().command((1.0, 5.0, 0.0), (5.0, 5.0), (9.0, 5.0)) == (2.0, 0.0)


def test_a_next_target_in_the_same_place_does_not_shape_the_approach():
    steering, pose, target = Steering(), (1.0, 5.0, 0.1), (5.0, 5.0)
    assert steering.command(pose, target, (5.0, 5.05)) == steering.command(pose, target)


def test_a_target_far_from_the_heading_is_faced_before_the_approach_is_shaped():
    steering, pose, target = Steering("forward"), (1.0, 5.0, 1.2), (5.0, 5.0)
    assert steering.command(pose, target, (5.0, 9.0)) == steering.command(pose, target)


def test_the_law_remembers_nothing():
    steering = Steering()
    fresh = Steering().command(START, PATROL[0], PATROL[1])
    drive(steering, (1.0, 1.0, 1.0), PATROL)
    assert steering.command(START, PATROL[0], PATROL[1]) == fresh


# Headings


@given(points, headings, styles, limits, headings)
def test_a_heading_that_is_wanted_is_taken_at_the_target(place, theta, style, limits, last):
    steering = Steering(style, limits)
    ticks = drive(steering, (*place, theta), [(5.0, 5.0)], theta=last)
    pose = ticks[-1].pose if ticks else (*place, theta)
    assert abs(math.remainder(pose[2] - last, math.tau)) <= limits.heading_tolerance + 1e-6
    assert math.hypot(pose[0] - 5.0, pose[1] - 5.0) <= limits.tolerance + 1e-6


def test_a_turtle_at_its_target_turns_to_the_heading_on_the_spot():
    assert Steering().command((5.0, 5.0, 0.0), (5.0, 5.05), theta=1.0) == (0.0, 2.0)


def test_a_turtle_in_its_heading_stands_still():
    assert Steering().command((5.0, 5.0, 0.96), (5.0, 5.05), theta=1.0) == (0.0, 0.0)


@pytest.mark.parametrize(("theta", "is_reached"), [(1.04, True), (1.06, False), (7.28, True)])
def test_a_target_with_a_heading_is_reached_in_it(theta, is_reached):
    steering = Steering(limits=Limits(heading_tolerance=0.05))
    assert steering.is_reached((5.0, 5.0, 1.0), (5.0, 5.05), theta=theta) is is_reached


# Accelerations


@given(points, headings, tours, styles, eased)
def test_speeds_change_no_faster_than_they_may(place, theta, targets, style, limits):
    before = (0.0, 0.0)
    for each in drive(Steering(style, limits), (*place, theta), targets):
        assert abs(each.linear - before[0]) <= limits.max_acceleration * limits.dt + 1e-9
        assert abs(each.angular - before[1]) <= limits.max_angular_acceleration * limits.dt + 1e-9
        assert abs(each.linear) <= limits.max_linear
        assert abs(each.angular) <= limits.max_angular
        before = each.linear, each.angular


@given(points, headings, tours, styles, eased)
def test_an_eased_turtle_ends_at_rest_at_its_last_target(place, theta, targets, style, limits):
    ticks = drive(Steering(style, limits), (*place, theta), targets)
    if ticks and limits.is_eased:
        assert (ticks[-1].linear, ticks[-1].angular) == (0.0, 0.0)


@together
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", range(20))
def test_an_eased_turtle_stops_before_the_walls(style, seed):
    uniform = random.Random(seed).uniform
    limits = Limits(
        max_linear=uniform(0.5, 5.0),
        max_angular=uniform(0.5, 5.0),
        max_acceleration=uniform(0.25, 10.0),
        max_angular_acceleration=uniform(0.25, 10.0),
    )
    pose = (uniform(0.0, SIDE), uniform(0.0, SIDE), uniform(-math.pi, math.pi))
    targets = [(uniform(0.0, SIDE), uniform(0.0, SIDE)) for _ in range(4)]
    ticks = drive(Steering(style, limits), pose, targets)
    assert max(tick.pushed for tick in ticks) < 1e-6


def test_an_eased_turtle_drives_through_a_target_on_its_way():
    limits = Limits(max_acceleration=1.0, max_angular_acceleration=2.0)
    ticks = drive(Steering(limits=limits), (1.0, 5.0, 0.0), [(5.0, 5.0), (9.0, 5.0)])
    assert min(each.linear for each in ticks if 4.0 < each.pose[0] < 6.0) == 2.0


def test_an_eased_turtle_that_rolls_the_wrong_way_brakes_first():
    steering = Steering(limits=Limits(max_acceleration=1.0))
    linear, angular = steering.command((5.0, 5.0, 0.0), (1.0, 6.0), speeds=(2.0, 0.0))
    assert (linear, angular) == pytest.approx((1.984, 0.0))


# Mistakes


def test_an_unknown_style_is_refused_with_the_known_ones():
    text = "style: 'drift' is none of natural, fastest, forward, rotate_then_drive"
    with pytest.raises(InvalidMessage, match=text):
        Steering("drift")  # type: ignore[arg-type]  # the mistake in question
