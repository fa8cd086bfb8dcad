"""Turtles that stop each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim.kinematics import DT
from turtleact.sim.world import BODY, World, stopped

places = st.builds(complex, st.floats(0.0, 3.0), st.floats(0.0, 3.0))
steps = st.one_of(st.just(0j), st.builds(complex, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)))


def kept_apart(before, after):
    """What becomes of a step, worked out pair by pair."""
    there = list(after)
    while True:
        met = set()
        for i, j in combinations(range(len(before)), 2):
            now, was = abs(there[i] - there[j]), abs(before[i] - before[j])
            if now < 2 * BODY and now < was:
                met |= {k for k in (i, j) if there[k] != before[k]}
        if not met:
            return [i for i in range(len(before)) if there[i] != after[i]]
        for k in met:
            there[k] = before[k]


@given(st.lists(st.tuples(places, steps), min_size=1, max_size=12))
def test_who_is_stopped_is_who_stands_in_the_way_of_another(moves):
    before = [place for place, _ in moves]
    after = [place + step for place, step in moves]
    assert stopped(before, after) == kept_apart(before, after)


def test_who_overlaps_already_can_part():
    assert stopped([1 + 1j, 1.1 + 1j], [0.9 + 1j, 1.2 + 1j]) == []


@pytest.mark.parametrize("others", [0, 30])
def test_two_that_meet_stop_a_body_apart_and_keep_their_speed(others):
    world = World(1, collide=True)
    world.spawn(8.0, world.pose("turtle1").y, 3.14159265, "other")
    for index in range(others):
        world.spawn(0.5 + 0.3 * index, 0.5, 0.0)
    for _ in range(3):
        for name in ("turtle1", "other"):
            world.set_velocity(name, 1.0)
        for _ in range(60):
            world.step()
    one, other = world.pose("turtle1"), world.pose("other")
    assert 2 * BODY <= other.x - one.x <= 2 * BODY + 2 * DT
    assert one.linear_velocity == other.linear_velocity == 1.0


def test_a_turtle_that_is_stopped_can_still_turn():
    world = World(1, collide=True)
    world.spawn(6.0, world.pose("turtle1").y, 0.0, "other")
    x = world.pose("turtle1").x
    world.set_velocity("turtle1", 1.0, 0.0, 1.0)
    world.step()
    assert world.pose("turtle1").x == x
    assert world.pose("turtle1").theta == pytest.approx(DT)


def test_turtles_pass_through_each_other_unless_they_are_asked_not_to():
    world = World(1)
    world.spawn(6.0, world.pose("turtle1").y, 0.0, "other")
    world.set_velocity("turtle1", 2.0)
    for _ in range(60):
        world.step()
    assert world.pose("turtle1").x > 7.0


def test_a_crowd_never_comes_to_overlap():
    world = World(60, placing="grid", collide=True)
    generator = np.random.default_rng(2)
    for _ in range(6):
        world.set_velocities(
            generator.uniform(-2.0, 2.0, 60), 0.0, generator.uniform(-3.0, 3.0, 60)
        )
        for _ in range(50):
            world.step()
            there = np.asarray(world.places())
            apart = np.abs(there[:, None] - there)[~np.eye(60, dtype=bool)]
            assert apart.min() >= 2 * BODY - 1e-9
