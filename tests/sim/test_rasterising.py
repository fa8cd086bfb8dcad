"""The lines of a fleet: straight ways are joined, and many lines have the pixels of each."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim.canvas import Canvas, Colour, Pen
from turtleact.sim.rasterising import Runs, draw_lines

RED = Colour(255, 0, 0)

inside = st.builds(complex, st.floats(0.0, 500.0), st.floats(0.0, 500.0))
anywhere = st.builds(complex, st.floats(-900.0, 900.0), st.floats(-900.0, 900.0))
on_grid = st.builds(complex, st.integers(-4, 504), st.integers(-4, 504)).map(lambda p: p / 2.0)
short = st.tuples(inside, st.builds(complex, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))).map(
    lambda pair: (pair[0], sum(pair))
)
dots = inside.map(lambda place: (place, place))
lines = st.one_of(
    short,
    dots,
    st.tuples(on_grid, on_grid),
    st.tuples(anywhere, anywhere),
    st.tuples(inside, inside),
)


@given(st.lists(lines, min_size=1, max_size=20), st.integers(1, 255))
def test_the_pixels_are_those_of_every_line(drawn, width):
    one_by_one, at_once = Canvas(), Canvas()
    for start, end in drawn:
        one_by_one.line(start, end, width, RED)
    starts, ends = (np.array(column, np.complex128) for column in zip(*drawn, strict=True))
    draw_lines(at_once, starts, ends, width, RED)
    assert at_once.pixels == one_by_one.pixels


@pytest.mark.parametrize("count", [0, 1, 1024, 1025, 3000])
def test_any_number_of_lines_is_drawn(count):
    generator = np.random.default_rng(1)
    starts = generator.uniform(-10.0, 510.0, (count, 2)).view(np.complex128)[:, 0]
    ends = starts + generator.normal(0.0, 2.0, (count, 2)).view(np.complex128)[:, 0]
    one_by_one, at_once = Canvas(), Canvas()
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        one_by_one.line(start, end, 3, RED)
    draw_lines(at_once, starts, ends, 3, RED)
    assert at_once.pixels == one_by_one.pixels


def test_straight_ways_are_one_line_for_each_turtle():
    runs, who = Runs(Pen(), bend=1e-9), np.array([2, 5])
    step = np.array([0.25 + 0.0j, 0.0 - 0.5j])
    start = np.zeros(2, np.complex128)
    for tick in range(20):
        ended, _, _ = runs.take(who, start + tick * step, start + (tick + 1) * step)
        assert len(ended) == 0
    numbers, begin, end = runs.take_all()
    assert (numbers.tolist(), begin.tolist(), end.tolist()) == ([2, 5], [0, 0], [5, -10j])


def test_a_way_that_bends_is_two_lines():
    runs, who = Runs(Pen(), bend=1e-9), np.array([1])
    here, there, on = (np.array([place]) for place in (0j, 1 + 0j, 1 + 1j))
    runs.take(who, here, there)
    assert [column.tolist() for column in runs.take(who, there, on)] == [[1], [0j], [1 + 0j]]
