"""Dots in braille characters, and the trails that are drawn with them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact import render

BLANK = chr(0x2800)

# --- dots and lines -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "y", "character"),
    [(0, 0, "⡀"), (1, 0, "⢀"), (0, 1, "⠄"), (1, 1, "⠠"), (0, 2, "⠂"), (0, 3, "⠁"), (1, 3, "⠈")],
)
def test_each_dot_of_a_cell_has_its_bit(x, y, character):
    canvas = render.Braille(1, 1)
    canvas.dot(x, y)
    assert canvas.rows() == [character]


def test_the_first_row_is_the_highest():
    canvas = render.Braille(1, 2)
    canvas.dot(0, 7)
    assert canvas.rows() == ["⠁", BLANK]


@pytest.mark.parametrize(("x", "y"), [(-1, 0), (0, -1), (2, 0), (0, 4)])
def test_a_dot_beyond_the_edge_is_left_out(x, y):
    canvas = render.Braille(1, 1)
    canvas.dot(x, y)
    assert canvas.rows() == [BLANK]


inside = st.integers(0, 7)


@given(inside, inside, inside, inside)
def test_a_line_sets_both_of_its_ends(x0, y0, x1, y1):
    line, ends = render.Braille(4, 2), render.Braille(4, 2)
    line.line(x0, y0, x1, y1)
    ends.dot(x0, y0)
    ends.dot(x1, y1)
    pairs = zip("".join(line.rows()), "".join(ends.rows()), strict=True)
    assert all(ord(some) & ord(few) == ord(few) for some, few in pairs)


def test_a_line_from_a_dot_to_itself_is_that_dot():
    canvas = render.Braille(1, 1)
    canvas.line(0, 0, 0, 0)
    assert canvas.rows() == ["⡀"]


# --- trails ---------------------------------------------------------------------------------


def test_a_trail_follows_in_strides():
    trails = render.Trails(11.0)
    for step in range(100):
        trails.follow("leo", step / 64, 0.0, "cyan")
    assert [round(x * 64) for x, _ in trails.places["leo"]][:4] == [0, 6, 12, 18]


def test_a_map_of_another_size_has_the_same_trails():
    small, large = render.Trails(11.0), render.Trails(11.0)
    small.canvas(10, 5)
    for trails in (small, large):
        for place in range(8):
            trails.follow("leo", place, place, "cyan")
    assert small.canvas(20, 10).rows() == large.canvas(20, 10).rows()


def test_trails_of_two_turtles_have_two_colours():
    trails = render.Trails(11.0)
    for name, y, colour in (("leo", 0.0, "cyan"), ("mia", 11.0, "red")):
        for x in (0.0, 11.0):
            trails.follow(name, x, y, colour)
    colours = trails.canvas(10, 5).colours()
    assert (set(colours[0]), set(colours[-1])) == ({"red"}, {"cyan"})
