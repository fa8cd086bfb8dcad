"""Turtles as arrays, against turtlesim's own code, transcribed line by line."""

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
    DT,
    HALF_TURN,
    SIDE,
    Command,
    Hit,
    Place,
    wrap,
)

MIDDLE = Place(SIDE / 2, SIDE / 2, 0.0)
PI = 3.14159265  # as turtle.hpp defines it

sides = st.floats(0.0, SIDE)
places = st.builds(Place, sides, sides, st.floats(-PI, PI, exclude_max=True))


class RealTurtles:
    """``Turtle::update`` of turtle.cpp, for several turtles, without pens and messages."""

    def __init__(self, places: list[Place]) -> None:
        self.x, self.y, self.orient = np.array(places, np.float64).reshape(-1, 3).T.copy()
        self.vx, self.vy, self.omega = np.zeros((3, len(places)))
        self.commanded = np.full(len(places), -np.inf)

    def command(self, index, command: Command, now: float) -> None:
        self.vx[index], self.vy[index], self.omega[index] = command
        self.commanded[index] = now

    def update(self, now: float) -> None:
        is_old = now - self.commanded > 1.0
        for speeds in (self.vx, self.vy, self.omega):
            speeds[is_old] = 0.0
        angle = self.orient + self.omega * DT
        angle -= 2.0 * PI * np.floor((angle + PI) / (2.0 * PI))
        self.orient = np.where((angle >= -PI) & (angle < PI), angle, -PI)
        cos, sin = np.cos(self.orient), np.sin(self.orient)
        self.x = np.clip(self.x + (cos * self.vx - sin * self.vy) * DT, 0.0, SIDE)
        self.y = np.clip(self.y - (sin * self.vx + cos * self.vy) * DT, 0.0, SIDE)


def states(turtles: Fleet) -> list[tuple[float, ...]]:
    return [turtles.state(index) for index in range(len(turtles))]


def scattered(count: int, seed: int = 0) -> list[Place]:
    rng = np.random.default_rng(seed)
    return [Place(*row) for row in rng.uniform([0, 0, -3], [SIDE, SIDE, 3], (count, 3)).tolist()]


def random_commands(count: int, seed: int = 0) -> dict[int, Command]:
    rng = np.random.default_rng(seed)
    return {
        index: Command(*row) for index, row in enumerate(rng.uniform(-3, 3, (count, 3)).tolist())
    }


def drive(place: Place, command: Command, ticks: int) -> Fleet:
    turtles = Fleet([place])
    turtles.drive({0: command}, 0)
    for tick in range(ticks):
        turtles.step(tick)
    return turtles


@pytest.fixture(params=[3, 8192], ids=["many-blocks", "one-block"])
def _blocks(request, monkeypatch):
    monkeypatch.setattr(fleet, "BLOCK", request.param)


# As turtlesim


@pytest.mark.parametrize("count", [1, 1000])
def test_20000_ticks_of_random_driving_round_to_turtlesims_float32(count):
    rng, start = np.random.default_rng(2), scattered(count)
    ours, real, others = Fleet(start), RealTurtles(start), 0
    for tick in range(20_000):
        if tick % 40 == 0:
            speeds = rng.uniform(-2.0, 2.0, (3, count)) * rng.integers(0, 2, (3, count))
            ours.drive_all(speeds, tick)
            real.command(slice(None), Command(*speeds), tick * DT)
        ours.step(tick)
        real.update(tick * DT)
        x, depth, theta, *_ = ours.columns()
        assert (theta == real.orient).all()
        for mine, theirs in ((x, real.x), (SIDE - depth, SIDE - real.y)):
            (off,) = (mine.astype(np.float32) != theirs.astype(np.float32)).nonzero()
            assert mine[off] == pytest.approx(theirs[off], abs=1e-12)
            others += len(off)
    # A place may lie within a rounding error of the middle between two floats. On another machine,
    # sines may be rounded in another way.
    assert others <= 1e-6 * 2 * count * 20_000


def test_half_a_turn_wraps_to_its_negative():
    assert wrap(HALF_TURN) == -HALF_TURN == -PI


@given(st.floats(-1e300, 1e300))
def test_a_wrapped_angle_is_in_the_half_open_range(theta):
    assert -PI <= wrap(theta) < PI


@given(places, st.builds(Command, *[st.floats(-1e308, 1e308)] * 3))
def test_no_speed_leads_out_of_the_walls(place, command):
    with np.errstate(all="ignore"):
        x, depth, theta, *_ = drive(place, command, 70).state(0)
    assert 0.0 <= x <= SIDE
    assert 0.0 <= depth <= SIDE
    assert -PI <= theta < PI


def test_commands_end_one_by_one():
    turtles, moving = Fleet([MIDDLE, MIDDLE]), []
    for tick in range(100):
        if tick in (0, 10):
            turtles.drive({tick // 10: Command(1.0, 0.0, 0.0)}, tick)
        turtles.step(tick)
        moving.append(turtles.columns()[3].tolist())
    assert [sum(column) for column in zip(*moving, strict=True)] == [COMMAND_TICKS] * 2


# Walls


def test_a_hit_says_from_where_the_turtle_was_brought_back():
    turtles = Fleet([MIDDLE, Place(SIDE, 1.0, 0.0)])
    turtles.drive({1: Command(2.0, 0.0, 0.0)}, 0)
    assert list(turtles.step(0)) == [Hit(1, SIDE + 0.032, 1.0)]


def test_a_turtle_that_only_touches_a_wall_does_not_hit_it():
    assert list(Fleet([Place(SIDE, 0.0, math.pi / 2)]).step(0)) == []


def test_a_negative_zero_hits_nothing():
    turtles = Fleet([Place(-0.0, 1.0, 0.0)])
    turtles.drive({0: Command(-0.0, 0.0, 0.0)}, 0)
    assert list(turtles.step(0)) == []


@pytest.mark.usefixtures("_blocks")
def test_hits_come_in_the_order_of_the_indices_and_once_for_a_corner():
    start = [MIDDLE] * 5 + [Place(20.0, -1.0, 0.0), MIDDLE, Place(-2.0, 3.0, 0.0)]
    hits = Fleet(start).step(0)
    assert list(hits) == [Hit(5, 20.0, -1.0), Hit(7, -2.0, 3.0)]
    assert len(hits) == 2


# Many


@pytest.mark.usefixtures("_blocks")
def test_a_turtle_does_the_same_alone_and_among_others():
    commands, start = random_commands(20), scattered(20)
    together = Fleet(start)
    together.drive(commands, 0)
    for tick in range(70):
        together.step(tick)
    alone = [drive(place, commands[index], 70).state(0) for index, place in enumerate(start)]
    assert np.array(states(together)) == pytest.approx(np.array(alone), abs=1e-13)


def test_a_fleet_at_rest_is_left_alone():
    turtles = Fleet(scattered(3))
    turtles.step(0)
    before = states(turtles)
    assert not turtles.step(1)
    assert states(turtles) == before


@pytest.mark.usefixtures("_blocks")
@pytest.mark.parametrize("index", [0, 7, 19])
def test_the_others_go_on_when_a_turtle_comes_and_goes(index):
    commands, ours, theirs = random_commands(20), Fleet(scattered(20)), Fleet(scattered(20))
    for turtles in (ours, theirs):
        turtles.drive(commands, 0)
    for tick in range(80):
        if tick % 20 == 5:
            ours.insert(index, Place(5.0, 6.0, 0.0))
        ours.step(tick)
        theirs.step(tick)
        if tick % 20 == 15:
            assert ours.state(index) == (5.0, 6.0, 0.0, 0.0, 0.0, 0.0)
            ours.remove(index)
        if len(ours) == 20:
            assert np.array(states(ours)) == pytest.approx(np.array(states(theirs)), abs=1e-13)


def test_a_turtle_that_comes_to_a_fleet_at_rest_is_brought_inside_the_walls():
    turtles = Fleet(scattered(3))
    turtles.step(0)
    turtles.insert(1, Place(20.0, 1.0, 0.0))
    assert list(turtles.step(1)) == [Hit(1, 20.0, 1.0)]


def test_a_turtle_comes_to_an_empty_fleet():
    turtles = Fleet([MIDDLE])
    turtles.remove(0)
    turtles.step(0)
    turtles.insert(0, MIDDLE)
    assert states(turtles) == [(*MIDDLE, 0.0, 0.0, 0.0)]
