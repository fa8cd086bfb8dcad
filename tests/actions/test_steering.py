"""The steering law, over a turtle that moves as turtlesim's does."""

from __future__ import annotations

import math
import random
import re
import struct
from typing import NamedTuple

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from turtleact.actions.steering import (
    STILL,
    Area,
    Limits,
    Pose,
    Steering,
    time_limit,
)
from turtleact.errors import InvalidMessage

from ..tables import together

DT = 0.016
SIDE = 11.088889
START = (5.544445, 5.544445, 0.0)
PATROL = [(9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0)]
BOUND = 9.93  # No turtle with these limits can drive this patrol in less time (s).
STYLES = ["natural", "rotate_then_drive"]

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
    max_angular_acceleration=st.floats(0.25, 20.0),
)


class Tick(NamedTuple):
    """A command, the pose after it, and how far the walls have pushed the turtle back."""

    linear: float
    angular: float
    pose: Pose
    pushed: float


def float32(value):
    return struct.unpack("f", struct.pack("f", value))[0]


def clamp(value):
    return max(0.0, min(SIDE, value))


def tick(pose, speeds, dt):
    """One tick of turtlesim: turn, then move, then the walls."""
    linear, angular = speeds
    theta = math.remainder(pose[2] + angular * dt, math.tau)
    x, y = pose[0] + math.cos(theta) * linear * dt, pose[1] + math.sin(theta) * linear * dt
    pushed = max(abs(x - clamp(x)), abs(y - clamp(y)))
    return Tick(linear, angular, (clamp(x), clamp(y), theta), pushed)


def drive(steering, pose, targets, *, theta=None, late=0, teleports=None, patience=1.0, held=1):
    """Every tick until all targets are reached and the turtle rests, or the time limit is over.

    Args:
        steering: The steering law.
        pose: Where the turtle starts.
        targets: Where it goes.
        theta: The wanted heading at the last target.
        late: How many ticks late each command comes.
        teleports: Poses to which somebody puts the turtle, by the number of the tick.
        patience: The time limit is multiplied by this.
        held: A command is held for this many ticks.
    """
    limits, left = steering.limits, list(targets)
    dt = limits.dt / held
    ticks: list[Tick] = []
    longest = patience * time_limit(pose, targets, limits, theta=theta) / dt
    commands = [STILL] * late
    speeds, age = STILL, 0
    while True:
        seen = tuple(float32(value) for value in pose)
        while len(left) > 1 and steering.is_reached(seen, left[0]):
            left.pop(0)
            age = 0
        heading = theta if len(left) == 1 else None
        is_at_rest = speeds == STILL or not limits.is_eased
        if steering.is_reached(seen, left[0], theta=heading) and is_at_rest:
            return ticks
        assert len(ticks) < longest, f"{seen} has not reached {left[0]}"
        if age % held == 0:
            after = left[1] if len(left) > 1 else None
            speeds = steering.command(seen, left[0], after, speeds, theta=heading)
        age += 1
        commands.append(speeds)
        ticks.append(tick(pose, commands.pop(0), dt))
        pose = (teleports or {}).get(len(ticks), ticks[-1].pose)


def seconds(steering, pose, targets, **options):
    return len(drive(steering, pose, targets, **options)) * DT


def gears(ticks):
    return {math.copysign(1.0, each.linear) for each in ticks if each.linear}


# How fast


@pytest.mark.parametrize("held", [1, 8])
@pytest.mark.parametrize(("style", "share"), [("natural", 1.10), ("rotate_then_drive", 1.30)])
def test_the_patrol_of_four_targets_is_driven_in_time(style, share, held):
    steering = Steering(style, Limits(dt=held * DT))
    assert seconds(steering, START, PATROL, held=held) <= share * BOUND


@given(points, headings, tours, styles, limits, st.sampled_from([1, 8]))
@example((5.5, 5.5), 0.0, [(5.5, 5.0), (5.125, 5.34375)], "natural", Limits(), 1)
def test_every_tour_ends_within_the_time_limit(place, theta, targets, style, limits, held):
    if max(limits.turn, limits.step / limits.tolerance) > 0.3 / 8:
        held = 1  # as `Drive` does: a fast turtle gets a command with each pose
    limits = msgspec.structs.replace(limits, dt=held * DT)
    drive(Steering(style, limits), (*place, theta), targets, held=held)


# Always arriving


@given(st.integers(1, 3), headings, st.lists(near, min_size=1, max_size=4), styles)
def test_commands_that_come_late_still_arrive(late, theta, targets, style):
    drive(Steering(style), (5.544445, 5.544445, theta), targets, late=late, patience=2.0)


@pytest.mark.parametrize("style", STYLES)
def test_a_turtle_that_is_teleported_on_the_way_still_arrives(style):
    teleports = {50: (1.0, 1.0, 3.0), 150: (10.0, 10.0, -1.0)}
    drive(Steering(style), START, PATROL, teleports=teleports, patience=2.0)


@pytest.mark.parametrize("style", STYLES)
def test_a_target_outside_the_area_is_driven_to(style):
    steering = Steering(style, Limits(area=Area(0.0, 0.0, 5.0, 5.0)))
    drive(steering, START, [(9.0, 9.0), (3.0, 3.0)])


# Within limits


@given(points, headings, tours, styles, limits)
def test_no_command_is_over_a_limit(place, theta, targets, style, limits):
    for each in drive(Steering(style, limits), (*place, theta), targets):
        assert abs(each.linear) <= limits.max_linear
        assert abs(each.angular) <= limits.max_angular


@pytest.mark.parametrize("held", [1, 8])
@given(points, headings, tours, styles)
def test_no_wall_is_ever_hit(held, place, theta, targets, style):
    steering = Steering(style, Limits(dt=held * DT))
    ticks = drive(steering, (*place, theta), targets, held=held)
    # From a pose on the wall, rounding alone may lead outside.
    assert max((tick.pushed for tick in ticks), default=0.0) < 1e-6


# The way it drives


@given(points, headings, points, limits)
def test_the_natural_style_keeps_its_gear_on_the_way_to_a_target(place, theta, target, limits):
    assert len(gears(drive(Steering(limits=limits), (*place, theta), [target]))) <= 1


# Degrees off straight behind, and metres; a turn of 1 rad takes as long as 1 m.
@pytest.mark.parametrize(
    ("off", "away", "gear"),
    [(0, 1.55, -1.0), (0, 1.75, 1.0), (30, 0.6, -1.0), (30, 0.85, 1.0), (60, 0.5, 1.0)],
)
@pytest.mark.parametrize("late", [0, 3])
def test_it_reverses_where_turning_round_takes_three_times_as_long(off, away, gear, late):
    seen = math.pi - math.radians(off)
    target = (5.0 + away * math.cos(seen), 5.0 + away * math.sin(seen))
    assert gears(drive(Steering(), (5.0, 5.0, 0.0), [target], late=late)) == {gear}


@given(headings, near)
def test_a_turtle_turns_the_short_way_round(theta, target):
    angular = Steering("rotate_then_drive").command((1.0, 1.0, theta), target)[1]
    bearing = math.atan2(target[1] - 1.0, target[0] - 1.0)
    assert angular * math.remainder(bearing - theta, math.tau) >= 0.0


def test_rotate_then_drive_turns_on_the_spot_and_then_drives_straight():
    ticks = drive(Steering("rotate_then_drive"), START, [(5.0, 9.0)])
    start = next(i for i, tick in enumerate(ticks) if tick.linear)
    assert start * DT * 2.0 > math.pi / 2 - 0.1
    assert {tick.linear for tick in ticks[start:]} == {2.0}


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
    assert Steering().command((5.0, 5.0, 0.96), (5.0, 5.05), theta=1.0) == STILL


@pytest.mark.parametrize(("theta", "is_reached"), [(1.04, True), (1.06, False), (7.28, True)])
def test_a_target_with_a_heading_is_reached_in_it(theta, is_reached):
    steering = Steering(limits=Limits(heading_tolerance=0.05))
    assert steering.is_reached((5.0, 5.0, 1.0), (5.0, 5.05), theta=theta) is is_reached


# Accelerations


@given(points, headings, tours, styles, eased)
def test_an_eased_turtle_changes_its_speeds_slowly_and_ends_at_rest(
    place, theta, targets, style, limits
):
    linear, angular = 0.0, 0.0
    for each in drive(Steering(style, limits), (*place, theta), targets):
        assert abs(each.linear - linear) <= limits.max_acceleration * DT + 1e-9
        assert abs(each.angular - angular) <= limits.max_angular_acceleration * DT + 1e-9
        assert abs(each.linear) <= limits.max_linear
        assert abs(each.angular) <= limits.max_angular
        linear, angular = each.linear, each.angular
    assert (linear, angular) == STILL


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


# Mistakes


@together
@pytest.mark.parametrize(
    "name", ["max_linear", "max_angular", "tolerance", "heading_tolerance", "dt"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_a_limit_must_be_finite_and_above_zero(name, value):
    with pytest.raises(
        InvalidMessage, match=f"^{name}: must be finite and above zero, not {value}$"
    ):
        Limits(**{name: value})


def test_a_tick_must_not_turn_more_than_a_quarter():
    with pytest.raises(InvalidMessage, match=re.escape("dt: a tick may turn pi/2 rad at most")):
        Limits(max_angular=10.0, dt=0.2)


@pytest.mark.parametrize("name", ["max_acceleration", "max_angular_acceleration"])
def test_an_acceleration_must_be_above_zero(name):
    with pytest.raises(InvalidMessage, match=f"^{name}: must be above zero, not -1.0$"):
        Limits(**{name: -1.0})  # type: ignore[arg-type]  # no area is named
