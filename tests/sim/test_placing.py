"""Where turtles are put, as turtlesim's float32 has it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim.kinematics import SIDE, Place, State
from turtleact.sim.placing import MIDDLE, Absolute, Relative, Spawn, start

HERE = State(5.0, 6.0, 0.5, 0.0, 0.0, 0.0)
floats = st.floats(-20.0, 20.0, width=32)


@given(floats, floats, floats)
def test_a_spawns_depth_is_worked_out_in_float32(x, y, theta):
    assert Spawn.of(x, y, theta).place == (x, float(np.float32(SIDE) - np.float32(y)), theta)


@given(floats, floats, floats)
def test_an_absolute_teleport_ends_below_the_upper_edge(x, y, theta):
    assert Absolute.of(x, y, theta).place_after(HERE) == (x, max(0.0, SIDE - y), theta)


def test_a_relative_teleport_turns_first():
    place = Relative.of(2.0, math.pi / 2 - 0.5).place_after(HERE)
    assert place == pytest.approx((5.0, 4.0, math.pi / 2), abs=1e-6)


def test_requests_are_rounded_to_float32():
    assert Relative.of(0.1, 0.2) == (float(np.float32(0.1)), float(np.float32(0.2)))


def test_the_first_starts_in_the_middle():
    assert start(1, seed=7) == MIDDLE == Place(SIDE / 2, SIDE / 2, 0.0)


def test_another_seed_is_another_place():
    assert start(2, seed=1) != start(2, seed=2) == start(2, seed=2)
