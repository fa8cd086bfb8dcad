"""Where turtles are put, as turtlesim's float32 has it."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import SimError
from turtleact.sim.kinematics import MIDDLE, PLACINGS, SIDE, Place, place_at, starts

floats = st.floats(-20.0, 20.0, width=32)


@given(floats, floats, floats)
def test_a_spawns_depth_is_worked_out_in_float32(x, y, theta):
    assert place_at(x, y, theta) == (x, float(np.float32(SIDE) - np.float32(y)), theta)


@pytest.mark.parametrize("placing", PLACINGS)
def test_a_turtle_alone_starts_in_the_middle(placing):
    assert starts(1, placing, seed=7) == [MIDDLE] == [Place(SIDE / 2, SIDE / 2, 0.0)]


def test_where_a_turtle_is_spread_does_not_depend_on_how_many_there_are():
    assert starts(3, "random", 5) == starts(30, "random", 5)[:3]


@pytest.mark.parametrize("placing", PLACINGS)
@pytest.mark.parametrize("count", [2, 3, 10, 1000])
def test_no_two_turtles_start_in_one_place(placing, count):
    assert len({place[:2] for place in starts(count, placing)}) == count


@pytest.mark.parametrize("placing", PLACINGS)
@pytest.mark.parametrize("count", [1, 2, 5, 1000])
def test_all_start_a_metre_from_the_walls(placing, count):
    for x, depth, theta in starts(count, placing):
        assert min(x, depth) >= 0.999999
        assert max(x, depth) <= SIDE - 0.999999
        assert -math.pi <= theta <= math.pi + 1e-6


def test_a_grid_is_filled_row_by_row_from_the_lower_left():
    step = (SIDE - 2.0) / 3
    there = [(x, SIDE - depth, theta) for x, depth, theta in starts(7, "grid")]
    for index, place in enumerate(there):
        row, column = divmod(index, 3)
        wanted = (1.0 + (column + 0.5) * step, 1.0 + (row + 0.5) * step, 0.0)
        assert place == pytest.approx(wanted, abs=1e-5)


def test_on_a_ring_each_looks_ahead_along_it():
    middle = SIDE / 2
    for index, (x, depth, theta) in enumerate(starts(8, "ring")):
        way = cmath.rect(1.0, theta)
        out = complex(x - middle, SIDE - depth - middle)
        assert abs(out) == pytest.approx(middle - 1.0, abs=1e-5)
        assert math.remainder(cmath.phase(out) - index * math.pi / 4, math.tau) == pytest.approx(
            0.0, abs=1e-5
        )
        assert (way / out).real == pytest.approx(0.0, abs=1e-5)
        assert (way / out).imag > 0.0


def test_a_placing_that_is_none_is_refused():
    with pytest.raises(SimError, match="cannot be placed as 'row': give random, grid, ring"):
        starts(3, "row")
