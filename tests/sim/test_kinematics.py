"""One step of a few turtles, against turtlesim's own code, transcribed line by line."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim.kinematics import (
    COMMAND_TICKS,
    DT,
    SIDE,
    Command,
    Handful,
    Hit,
    Place,
    StepRule,
    chord,
    displacement,
    half_turn,
    wrap,
)

MIDDLE = Place(SIDE / 2, SIDE / 2, 0.0)
PI = 3.14159265  # as turtle.hpp defines it

speeds = st.one_of(st.just(0.0), st.floats(-5.0, 5.0))
commands = st.builds(Command, speeds, speeds, speeds)
sides = st.floats(0.0, SIDE)
places = st.builds(Place, sides, sides, st.floats(-PI, PI, exclude_max=True))
runs = st.lists(st.tuples(st.integers(0, 80), commands), min_size=1, max_size=5)


class RealTurtle:
    """``Turtle::update`` of turtle.cpp without teleports, pens and messages."""

    def __init__(self, place: Place) -> None:
        self.x, self.y, self.orient = place
        self.vx = self.vy = self.omega = 0.0
        self.commanded = -math.inf

    def command(self, command: Command, now: float) -> None:
        self.vx, self.vy, self.omega = command
        self.commanded = now

    def update(self, now: float) -> None:
        if now - self.commanded > 1.0:
            self.vx = self.vy = self.omega = 0.0
        angle = self.orient + self.omega * DT
        self.orient = angle - (2.0 * PI * math.floor((angle + PI) / (2.0 * PI)))
        cos, sin = math.cos(self.orient), math.sin(self.orient)
        self.x += cos * self.vx * DT - sin * self.vy * DT
        self.y -= cos * self.vy * DT + sin * self.vx * DT
        self.x = min(max(self.x, 0.0), SIDE)
        self.y = min(max(self.y, 0.0), SIDE)


def drive(place: Place, command: Command, ticks: int, *, rule: StepRule) -> Handful:
    turtles = Handful([place], rule)
    turtles.drive({0: command}, 0)
    for tick in range(ticks):
        turtles.step(tick)
    return turtles


# --- wrap -----------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", StepRule)
def test_half_a_turn_wraps_to_its_negative(rule):
    half = half_turn(rule)
    assert wrap(half, half) == -half


def test_turtlesims_half_turn_is_a_rounded_pi():
    assert half_turn(StepRule.EULER) == PI


@given(st.floats(-1e300, 1e300))
def test_a_wrapped_angle_is_in_the_half_open_range(theta):
    assert -PI <= wrap(theta, PI) < PI


# --- chord, displacement --------------------------------------------------------------------


@pytest.mark.parametrize("rule", StepRule)
def test_a_step_without_a_turn_goes_straight_ahead(rule):
    assert displacement(0.0, 2.0, 0.0, chord(rule, 0.0)) == (2.0 * DT, 0.0)


def test_turtlesims_step_goes_along_its_last_heading():
    assert chord(StepRule.EULER, 0.5) == (0.0, DT)


@given(st.floats(1e-3, 5.0), st.floats(-5.0, 5.0), st.floats(-PI, PI), st.sampled_from([1, -1]))
def test_an_arc_ends_where_the_closed_form_says(omega, vx, theta, side):
    omega *= side
    end = theta + omega * DT
    dx, dy = displacement(end, vx, 0.0, chord(StepRule.ARC, omega * DT))
    assert dx == pytest.approx(vx / omega * (math.sin(end) - math.sin(theta)), abs=1e-11)
    assert dy == pytest.approx(vx / omega * (math.cos(theta) - math.cos(end)), abs=1e-11)


def test_many_arcs_make_the_circle_they_are_part_of():
    turtles = drive(MIDDLE, Command(1.0, 0.5, 1.5), 60, rule=StepRule.ARC)
    angle = 60 * DT * 1.5
    x, depth, theta, *_ = turtles.state(0)
    ahead = (1.0 * math.sin(angle) - 0.5 * (1 - math.cos(angle))) / 1.5
    left = (1.0 * (1 - math.cos(angle)) + 0.5 * math.sin(angle)) / 1.5
    assert (x, depth, theta) == pytest.approx((SIDE / 2 + ahead, SIDE / 2 - left, angle), abs=1e-12)


def test_an_arc_is_wrapped_by_the_exact_pi():
    turtles = drive(MIDDLE._replace(theta=3.14), Command(0.0, 0.0, 1.0), 1, rule=StepRule.ARC)
    assert turtles.state(0).theta == 3.14 + DT - math.tau


# --- Handful --------------------------------------------------------------------------------


@given(places, runs)
def test_a_run_has_the_bits_of_the_real_turtle(place, run):
    real, ours, tick = RealTurtle(place), Handful([place], StepRule.EULER), 0
    for pause, command in run:
        ours.drive({0: command}, tick)
        real.command(command, tick * DT)
        for _ in range(pause):
            ours.step(tick)
            real.update(tick * DT)
            tick += 1
            assert ours.state(0)[:3] == (real.x, real.y, real.orient)


@given(st.lists(st.tuples(places, commands), min_size=2, max_size=6))
def test_turtles_in_a_handful_do_what_each_does_alone(turtles):
    together = Handful([place for place, _ in turtles], StepRule.EULER)
    together.drive({index: command for index, (_, command) in enumerate(turtles)}, 0)
    for tick in range(70):
        together.step(tick)
    for index, (place, command) in enumerate(turtles):
        alone = drive(place, command, 70, rule=StepRule.EULER)
        assert together.state(index) == alone.state(0)


@pytest.mark.parametrize("rule", StepRule)
@given(places, st.builds(Command, *[st.floats(-1e308, 1e308)] * 3))
def test_no_speed_leads_out_of_the_walls(rule, place, command):
    x, depth, theta, *_ = drive(place, command, 70, rule=rule).state(0)
    assert 0.0 <= x <= SIDE
    assert 0.0 <= depth <= SIDE
    assert -half_turn(rule) <= theta < half_turn(rule)


def test_a_command_lasts_for_63_steps():
    turtles = Handful([MIDDLE], StepRule.EULER)
    turtles.drive({0: Command(1.0, 0.0, 0.0)}, 0)
    moving = []
    for tick in range(100):
        turtles.step(tick)
        moving.append(turtles.state(0).vx)
    assert moving == [1.0] * COMMAND_TICKS + [0.0] * (100 - COMMAND_TICKS)


def test_a_command_for_all_is_one_for_each():
    turtles = Handful([MIDDLE, MIDDLE], StepRule.EULER)
    turtles.drive_all(np.array([[1.0, 2.0], [0.0, 0.0], [0.5, 0.0]]), 0)
    turtles.step(0)
    assert [turtles.state(0)[3:], turtles.state(1)[3:]] == [(1.0, 0.0, 0.5), (2.0, 0.0, 0.0)]


def test_a_hit_says_from_where_the_turtle_was_brought_back():
    turtles = Handful([MIDDLE, Place(SIDE, 1.0, 0.0)], StepRule.EULER)
    turtles.drive({1: Command(2.0, 0.0, 0.0)}, 0)
    assert list(turtles.step(0)) == [Hit(1, SIDE + 0.032, 1.0)]


def test_a_turtle_that_only_touches_a_wall_does_not_hit_it():
    turtles = Handful([Place(SIDE, 0.0, math.pi / 2)], StepRule.EULER)
    assert not turtles.step(0)


def test_a_turtle_slides_along_a_wall():
    turtles = drive(Place(SIDE, 5.0, -0.5), Command(2.0, 0.0, 0.0), 10, rule=StepRule.EULER)
    x, depth, *_ = turtles.state(0)
    assert x == SIDE
    assert depth == pytest.approx(5.0 + 0.32 * math.sin(0.5))


def test_a_turtle_put_outside_is_brought_back_by_the_next_step():
    turtles = Handful([MIDDLE], StepRule.EULER)
    turtles.step(0)
    turtles.place(0, Place(-3.0, 20.0, 10.0))
    hits = list(turtles.step(1))
    x, depth, theta, *_ = turtles.state(0)
    assert (hits, x, depth) == ([Hit(0, -3.0, 20.0)], 0.0, SIDE)
    assert theta == 10.0 - 4 * PI


def test_the_columns_are_the_states_turned_over():
    turtles = Handful([MIDDLE, Place(1.0, 2.0, 3.0)], StepRule.EULER)
    assert list(zip(*turtles.columns(), strict=True)) == [turtles.state(0), turtles.state(1)]
    assert len(turtles) == 2


def test_others_keep_their_bits_when_a_turtle_comes_and_goes():
    alone, ours = (Handful([MIDDLE, Place(1.0, 2.0, 3.0)], StepRule.EULER) for _ in range(2))
    for turtles in (alone, ours):
        turtles.drive({0: Command(1.0, 0.0, 0.5), 1: Command(2.0, 0.0, 0.0)}, 0)
    for tick in range(80):
        if tick % 20 == 5:
            ours.insert(1, Place(5.0, 6.0, 0.0))
        assert [hit.x for hit in ours.step(tick)] == [hit.x for hit in alone.step(tick)]
        if tick % 20 == 15:
            assert ours.state(1) == (5.0, 6.0, 0.0, 0.0, 0.0, 0.0)
            ours.remove(1)
        if len(ours) == 2:
            assert [ours.state(0), ours.state(1)] == [alone.state(0), alone.state(1)]


def test_a_hit_has_the_index_that_a_turtle_has_now():
    turtles = Handful([Place(-1.0, 2.0, 0.0), Place(-2.0, 2.0, 0.0)], StepRule.EULER)
    turtles.remove(0)
    turtles.insert(0, MIDDLE)
    turtles.insert(2, Place(-3.0, 2.0, 0.0))
    assert list(turtles.step(0)) == [Hit(1, -2.0, 2.0), Hit(2, -3.0, 2.0)]
