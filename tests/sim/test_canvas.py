"""The pixels: each one that a line should colour, and no other."""

from __future__ import annotations

import cmath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from turtleact.sim.drawing import Canvas
from turtleact.sim.pictures import SIZE, Colour, Pen

RED, BLUE = Colour(255, 0, 0), Colour(0, 0, 255)

coordinates = st.floats(-20.0, 60.0)
points = st.builds(complex, coordinates, coordinates)


def drawn(canvas):
    """The pixels that are not clear, as (x, y)."""
    return {(at % SIZE, at // SIZE) for at, pixel in enumerate(canvas.pixels) if pixel}


def draw(canvas, start, end, width, colour=RED):
    canvas.draw(np.array([start], complex), np.array([end], complex), Pen(colour, width))


def line(start, end, width=3):
    canvas = Canvas()
    draw(canvas, start, end, width)
    return drawn(canvas)


def distance_inside(x, y, start, end, width):
    """How far a pixel's centre is from the nearest edge of a line: above zero inside."""
    way = end - start
    turned = (complex(x + 0.5, y + 0.5) - start) * cmath.exp(-1j * cmath.phase(way))
    half = width / 2.0
    across = half - abs(turned.imag)
    return min(across, turned.real + half, abs(way) + half - turned.real)


@settings(max_examples=25)
@given(points, points, st.integers(1, 9))
def test_a_pixel_is_coloured_if_its_centre_lies_in_the_line(start, end, width):
    found = line(start, end, float(width))
    for x in range(80):
        for y in range(80):
            inside = distance_inside(x, y, start, end, width)
            if abs(inside) > 1e-6:  # upon the edge, roundings decide
                assert ((x, y) in found) == (inside > 0.0)
    assert all(x < 80 and y < 80 for x, y in found)


@pytest.mark.parametrize("far", [1e6, 1e38, -1e38])
def test_a_line_from_far_outside_is_drawn_where_it_is_seen(far):
    pixels = line(complex(far, 250.5), 250.5 + 250.5j)
    assert {y for _, y in pixels} == {249, 250, 251}
    assert len({x for x, _ in pixels}) in (250, 251, 252)


def test_a_line_outside_draws_nothing():
    assert (
        line(-50 - 50j, -10 + 400j) == line(600 + 0j, 600 + 300j) == line(0 - 9j, 99 - 9j) == set()
    )


def test_the_later_line_covers_the_earlier():
    canvas = Canvas()
    draw(canvas, 0 + 10j, 20 + 10j, 3, RED)
    draw(canvas, 10 + 0j, 10 + 20j, 3, BLUE)
    assert [canvas.colour(x, 10) for x in (5, 10)] == [RED, BLUE]


def test_black_is_a_colour():
    canvas = Canvas()
    draw(canvas, 10 + 10j, 10 + 10j, 3, Colour(0, 0, 0))
    assert canvas.colour(10, 10) == (0, 0, 0)


@pytest.mark.parametrize("count", [0, 1, 300])
def test_any_number_of_lines_has_the_pixels_of_each(count):
    generator = np.random.default_rng(1)
    starts = generator.uniform(-10.0, 510.0, (count, 2)).view(np.complex128)[:, 0]
    ends = starts + generator.normal(0.0, 2.0, (count, 2)).view(np.complex128)[:, 0]
    one_by_one, at_once = Canvas(), Canvas()
    for start, end in zip(starts, ends, strict=True):
        draw(one_by_one, start, end, 3)
    at_once.draw(starts, ends, Pen(RED, 3))
    assert (at_once.pixels == one_by_one.pixels).all()
