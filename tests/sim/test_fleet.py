"""Many turtles as arrays, against a handful of them in plain floats."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim import fleet
from turtleact.sim.fleet import Fleet
from turtleact.sim.kinematics import (
    COMMAND_TICKS,
    NEVER,
    SIDE,
    Command,
    Handful,
    Hit,
    Place,
    State,
    StepRule,
    half_turn,
)

MIDDLE = Place(SIDE / 2, SIDE / 2, 0.0)

sides = st.floats(0.0, SIDE)
places = st.builds(Place, sides, sides, st.floats(-3.14, 3.14))
speeds = st.floats(-5.0, 5.0)
straight = st.builds(Command, speeds, speeds, st.just(0.0))
on_the_spot = st.builds(Command, st.just(0.0), st.just(0.0), st.floats(-500.0, 500.0))
actions = st.lists(
    st.tuples(
        st.integers(0, 3), st.one_of(straight, on_the_spot, places), st.integers(0, COMMAND_TICKS)
    ),
    max_size=8,
)


def states(turtles: Fleet | Handful) -> list[tuple[float, ...]]:
    return [turtles.state(index) for index in range(len(turtles))]


def scattered(count: int, seed: int = 0) -> list[Place]:
    rng = np.random.default_rng(seed)
    return [Place(*row) for row in rng.uniform([0, 0, -3], [SIDE, SIDE, 3], (count, 3)).tolist()]


def random_commands(count: int, seed: int = 0) -> dict[int, Command]:
    rng = np.random.default_rng(seed)
    return {
        index: Command(*row) for index, row in enumerate(rng.uniform(-3, 3, (count, 3)).tolist())
    }


def pairs(count: int, rule: StepRule = StepRule.EULER) -> tuple[Fleet, Handful]:
    return Fleet(scattered(count), rule), Handful(scattered(count), rule)


@pytest.fixture(params=[3, 8192], ids=["many-blocks", "one-block"])
def _blocks(request, monkeypatch):
    monkeypatch.setattr(fleet, "BLOCK", request.param)


@given(st.lists(places, min_size=4, max_size=4), actions)
def test_without_curves_a_fleet_has_the_bits_of_a_handful(start, actions):
    both, tick = (Fleet(start, StepRule.EULER), Handful(start, StepRule.EULER)), 0
    for index, action, pause in actions:
        for turtles in both:
            if isinstance(action, Place):
                turtles.place(index, action._replace(theta=action.theta * 4))
            else:
                turtles.drive({index: action}, tick)
        for _ in range(pause):
            fleet_hits, handful_hits = (list(turtles.step(tick)) for turtles in both)
            assert fleet_hits == handful_hits
            tick += 1
        assert states(both[0]) == states(both[1])


@pytest.mark.usefixtures("_blocks")
@pytest.mark.parametrize("rule", StepRule)
def test_along_curves_a_fleet_differs_from_a_handful_by_less_than_1e_12(rule):
    ours, theirs = pairs(20, rule)
    for tick in range(2000):
        if tick % 70 == 0:
            for turtles in (ours, theirs):
                turtles.drive(random_commands(20, seed=tick), tick)
        ours.step(tick)
        theirs.step(tick)
    places, expected = np.array(states(ours)), np.array(states(theirs))
    assert np.abs(places - expected).max() < 1e-12


def test_angles_have_the_bits_of_a_handful_along_curves_too():
    ours, theirs = pairs(20)
    for tick in range(500):
        if tick % 50 == 0:
            for turtles in (ours, theirs):
                turtles.drive(random_commands(20), tick)
        ours.step(tick)
        theirs.step(tick)
        angles = [[state[2] for state in states(turtles)] for turtles in (ours, theirs)]
        assert angles[0] == angles[1]


def test_curves_round_to_the_float32_of_a_handful():
    ours, theirs = pairs(20)
    for tick in range(1000):
        if tick % 40 == 0:
            for turtles in (ours, theirs):
                turtles.drive(random_commands(20, seed=tick), tick)
        ours.step(tick)
        theirs.step(tick)
        places = np.array(states(ours), np.float32)
        assert (places == np.array(states(theirs), np.float32)).all()


@pytest.mark.parametrize("omega", [-3.0, 3.0])
def test_many_angles_at_once_are_brought_into_range(omega):
    ours, theirs = (
        kind([MIDDLE._replace(theta=math.copysign(3.0, omega))] * 10, StepRule.EULER)
        for kind in (Fleet, Handful)
    )
    command = dict.fromkeys(range(10), Command(1.0, 0.0, omega))
    for turtles in (ours, theirs):
        turtles.drive(command, 0)
        for tick in range(COMMAND_TICKS):
            turtles.step(tick)
    assert np.array(states(ours)) == pytest.approx(np.array(states(theirs)), abs=1e-13)


@pytest.mark.parametrize("count", [2, 10])
def test_turtles_that_spin_more_than_a_turn_a_step_stay_in_range(count):
    turtles = Fleet([MIDDLE] * count, StepRule.EULER)
    turtles.drive(dict.fromkeys(range(count), Command(1.0, 0.0, 1000.0)), 0)
    for tick in range(10):
        turtles.step(tick)
        assert abs(turtles.columns()[2]).max() <= half_turn(StepRule.EULER)


@pytest.mark.usefixtures("_blocks")
def test_a_command_for_all_is_one_for_each():
    ours, each = Fleet(scattered(10), StepRule.EULER), Fleet(scattered(10), StepRule.EULER)
    commands = random_commands(10)
    ours.drive_all(np.array(list(commands.values())).T, 0)
    each.drive(commands, 0)
    for tick in range(80):
        ours.step(tick)
        each.step(tick)
    assert states(ours) == states(each)


def test_commands_end_one_by_one():
    turtles = Fleet([MIDDLE, MIDDLE], StepRule.EULER)
    moving = []
    for tick in range(100):
        if tick in (0, 10):
            turtles.drive({tick // 10: Command(1.0, 0.0, 0.0)}, tick)
        turtles.step(tick)
        moving.append(turtles.columns()[3].tolist())
    assert [sum(column) for column in zip(*moving, strict=True)] == [COMMAND_TICKS] * 2


def test_a_fleet_at_rest_is_left_alone():
    turtles = Fleet(scattered(3), StepRule.EULER)
    turtles.step(0)
    before = states(turtles)
    assert not turtles.step(1)
    assert states(turtles) == before


@pytest.mark.usefixtures("_blocks")
def test_hits_come_in_the_order_of_the_indices_and_once_for_a_corner():
    start = [MIDDLE] * 5 + [Place(20.0, -1.0, 0.0), MIDDLE, Place(-2.0, 3.0, 0.0)]
    hits = Fleet(start, StepRule.EULER).step(0)
    assert list(hits) == [Hit(5, 20.0, -1.0), Hit(7, -2.0, 3.0)]
    assert (len(hits), hits[0], hits[1:]) == (2, Hit(5, 20.0, -1.0), [Hit(7, -2.0, 3.0)])


def test_hits_outlive_the_next_step():
    turtles = Fleet([Place(20.0, 1.0, 0.0)], StepRule.EULER)
    hits = turtles.step(0)
    turtles.step(1)
    assert list(hits) == [Hit(0, 20.0, 1.0)]


def test_a_negative_zero_hits_nothing():
    turtles = Fleet([Place(-0.0, 1.0, 0.0)], StepRule.EULER)
    turtles.drive({0: Command(-0.0, 0.0, 0.0)}, 0)
    assert list(turtles.step(0)) == []


def made_anew(turtles: Fleet, rule: StepRule) -> Fleet:
    """The same turtles with the same commands, in a fleet of their own."""
    orders = turtles.orders()
    fresh = Fleet([Place(*state[:3]) for state, _ in orders], rule)
    for index, (state, expiry) in enumerate(orders):
        if expiry != NEVER:
            fresh.drive({index: Command(*state[3:])}, expiry - COMMAND_TICKS)
    return fresh


@pytest.mark.usefixtures("_blocks")
@pytest.mark.parametrize("rule", StepRule)
@pytest.mark.parametrize("index", [0, 7, 20])
def test_a_fleet_into_which_a_turtle_has_come_has_the_bits_of_one_made_anew(index, rule):
    ours, place = Fleet(scattered(20), rule), Place(20.0, 3.0, 9.0)
    ours.drive(dict(list(random_commands(20).items())[::2]), 0)
    for tick in range(30):
        ours.step(tick)
    before = ours.orders()
    ours.insert(index, place)
    at_rest = State(*place, 0.0, 0.0, 0.0), NEVER
    assert ours.orders() == [*before[:index], at_rest, *before[index:]]
    fresh = made_anew(ours, rule)
    for tick in range(30, 100):
        assert list(ours.step(tick)) == list(fresh.step(tick))
        assert states(ours) == states(fresh)


@pytest.mark.usefixtures("_blocks")
@pytest.mark.parametrize("rule", StepRule)
@pytest.mark.parametrize("index", [0, 7, 19])
def test_a_fleet_that_a_turtle_has_left_has_the_bits_of_one_made_anew(index, rule):
    ours = Fleet(scattered(20), rule)
    ours.drive(dict(list(random_commands(20).items())[::2]), 0)
    for tick in range(30):
        ours.step(tick)
    before = ours.orders()
    ours.remove(index)
    assert ours.orders() == [*before[:index], *before[index + 1 :]]
    fresh = made_anew(ours, rule)
    for tick in range(30, 100):
        assert list(ours.step(tick)) == list(fresh.step(tick))
        assert states(ours) == states(fresh)


def test_a_turtle_that_comes_to_a_fleet_at_rest_is_brought_inside_the_walls():
    turtles = Fleet(scattered(3), StepRule.EULER)
    turtles.step(0)
    turtles.insert(1, Place(20.0, 1.0, 0.0))
    assert list(turtles.step(1)) == [Hit(1, 20.0, 1.0)]
