"""The helm: a turtle that is told only what is new gets there as one that is told all."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.actions.steering import STILL, Area, Helm, Limits, Steering, time_bound
from turtleact.actions.steering.law import LONGEST, OLDEST

from ...tables import together
from .track import (
    SIDE,
    START,
    STYLES,
    drive,
    float32,
    headings,
    limits,
    points,
    styles,
    tick,
    tours,
)

AHEAD = (10.0, START[1])


class Log:
    """What happened on the way.

    Attributes:
        told: The ticks in which something was said.
        poses: Where the turtle was seen in each tick.
        pushed: How far walls have pushed it.
    """

    def __init__(self):
        self.told = []
        self.poses = []
        self.pushed = 0.0

    @property
    def ticks(self):
        return len(self.poses) - 1


def follow(helm, pose, targets):
    """Drive through the targets; the turtle is told what the helm says."""
    log, left, steering = Log(), list(targets), helm.steering
    longest = time_bound(pose, targets, steering) / steering.limits.dt + 2 * len(targets)
    while True:
        seen = tuple(map(float32, pose))
        log.poses.append(seen)
        if not helm.holds(seen):
            while left and steering.is_reached(seen, left[0]):
                left.pop(0)
            if not left:
                return log
            assert log.ticks < longest, f"{seen} has not reached {left[0]}"
            log.told.append(log.ticks)
            helm.command(seen, *left[:2])
        linear, angular = helm.speeds
        made = tick(pose, linear, angular, steering.limits.dt)
        log.pushed = max(log.pushed, made.pushed)
        pose = made.pose


def holding(helm: Helm) -> Helm:
    """A helm that holds a command, straight ahead from the start."""
    helm.at = START
    helm.command(START, AHEAD)
    assert helm.left == 2
    return helm


def course(seed):
    uniform = random.Random(seed).uniform
    pose = (uniform(0.0, SIDE), uniform(0.0, SIDE), uniform(-math.pi, math.pi))
    return pose, [(uniform(0.0, SIDE), uniform(0.0, SIDE)) for _ in range(4)]


@together
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", range(6))
def test_it_takes_as_long_as_if_the_law_was_asked_in_each_tick(style, seed):
    pose, targets = course(seed)
    asked = len(drive(Steering(style), pose, targets))
    assert follow(Helm(Steering(style)), pose, targets).ticks == pytest.approx(asked, abs=3)


@pytest.mark.parametrize("style", STYLES)
def test_something_is_said_in_a_quarter_of_the_ticks_at_most(style):
    log = follow(Helm(Steering(style)), *course(1))
    assert len(log.told) <= log.ticks / 4


@given(points, headings, tours, styles, limits)
def test_every_tour_ends_in_time(place, theta, targets, style, limits):
    follow(Helm(Steering(style, limits)), (*place, theta), targets)


@given(points, headings, tours, styles)
def test_no_hold_ends_behind_a_wall(place, theta, targets, style):
    assert follow(Helm(Steering(style)), (*place, theta), targets).pushed <= 1e-6


@given(points, headings, points, styles, limits)
def test_no_hold_ends_behind_a_target(place, theta, target, style, limits):
    steering = Steering(style, limits)
    poses = follow(Helm(steering), (*place, theta), [target]).poses
    assert not any(steering.is_reached(pose, target) for pose in poses[:-1])


def test_a_command_that_stays_the_same_is_made_anew_long_before_it_ends():
    log = follow(Helm(Steering()), START, [AHEAD])
    assert log.told[:4] == [0, 1, 39, 71]  # a look that ends at 32 ticks or later is the last
    assert OLDEST + LONGEST < 62  # a command of turtlesim's lasts for a second


def test_each_look_ahead_is_twice_as_far_as_the_one_before_up_to_the_longest():
    helm, pose = holding(Helm(Steering())), START
    looks = [helm.left]
    while len(looks) < 4:
        left, pose = helm.left, tick(pose, *helm.speeds, 0.016).pose
        assert helm.holds(pose)
        if helm.left != left - 1:
            looks.append(helm.left)
    assert looks == [2, 4, LONGEST, LONGEST]


@pytest.mark.parametrize("axis", range(3))
def test_a_turtle_that_is_not_where_it_should_be_is_told_at_once(axis):
    helm = holding(Helm(Steering()))
    pose = list(tick(START, *helm.speeds, 0.016).pose)
    pose[axis] += 1e-4
    assert not helm.holds(tuple(pose))
    assert not helm.holds(tick(tuple(pose), *helm.speeds, 0.016).pose)


def test_a_pose_that_is_none_is_told_at_once():
    helm = holding(Helm(Steering()))
    assert not helm.holds((math.nan, math.nan, math.nan))


def test_nothing_is_held_before_the_first_command():
    assert not Helm(Steering()).holds(START)


def test_another_target_is_heeded_where_a_hold_ends():
    helm = holding(Helm(Steering(), longest=2))
    pose = START
    for _ in range(OLDEST):
        pose = tick(pose, *helm.speeds, 0.016).pose
        is_held = helm.holds(pose)
    assert not is_held
    assert helm.command(pose, (1.0, START[1]))[0] == -2.0


def test_a_turtle_that_has_not_done_as_it_was_told_is_told_in_each_tick():
    helm, x = Helm(Steering()), START[0]
    for _ in range(10):
        x -= 0.001
        assert not helm.holds((x, *START[1:]))
        helm.command((x, *START[1:]), AHEAD)


def test_another_law_ends_what_is_held():
    helm = holding(Helm(Steering()))
    helm.steering = Steering("forward")
    assert not helm.holds(tick(START, *helm.speeds, 0.016).pose)


def test_a_turtle_that_is_stopped_is_told_at_once():
    helm = holding(Helm(Steering()))
    helm.stop()
    assert helm.speeds == STILL
    assert not helm.holds(START)


@pytest.mark.parametrize(
    "helm",
    [
        Helm(Steering(), longest=1),
        Helm(Steering(limits=Limits(max_acceleration=2.0))),
    ],
    ids=["told in each tick", "eased"],
)
def test_nothing_is_held_where_each_tick_may_say_something_new(helm):
    log = follow(helm, START, [AHEAD])
    assert log.told == list(range(log.ticks))


def test_a_turn_on_the_spot_to_a_heading_is_held_until_it_is_there():
    helm, pose, told = Helm(Steering()), START, 0
    while not helm.steering.is_reached(pose, START[:2], theta=3.0):
        if not helm.holds(pose):
            told += 1
            helm.command(pose, START[:2], theta=3.0)
        pose = tick(pose, *helm.speeds, 0.016).pose
    assert pose[2] == pytest.approx(3.0, abs=0.05)
    assert told <= 8


@given(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.integers(2, LONGEST))
def test_where_a_command_leads_is_where_its_ticks_lead(x, y, ticks):
    helm, pose = Helm(Steering(limits=Limits(area=Area()))), START
    linear, angular = helm.command(pose, (x, y))
    there = helm.pose_after(ticks)
    for _ in range(ticks):
        theta = pose[2] + angular * 0.016
        along = linear * 0.016
        pose = (pose[0] + math.cos(theta) * along, pose[1] + math.sin(theta) * along, theta)
    assert there == pytest.approx(pose, abs=1e-12)
