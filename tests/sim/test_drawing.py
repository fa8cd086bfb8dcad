"""What was drawn: as pixels to the last one, as polylines within a tolerance, within bounds."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from turtleact.sim import drawing
from turtleact.sim.drawing import TOLERANCE, Canvas, Drawing
from turtleact.sim.pictures import METER, Colour, Pen

RED, BLUE = Pen(Colour(255, 0, 0), 3), Pen(Colour(0, 0, 255), 5)

# On a grid: a line that bends by less than a millionth of a pixel is drawn as if it was straight,
# which decides where a pixel goes that lies exactly between two.
sides = st.integers(0, 11 * 1024).map(lambda number: number / 1024)
places = st.builds(complex, sides, sides)
steps = st.builds(cmath.rect, st.floats(0.0, 0.1), st.floats(-3.14, 3.14))
turns = st.floats(-0.3, 0.3)


def path(turning, start=5.0 + 5.0j, length=0.02):
    """A way that turns by these angles, one after the other."""
    points, heading = [start], 0.0
    for turn in turning:
        heading += turn
        points.append(points[-1] + cmath.rect(length, heading))
    return points


def draw(drawing, points, turtle=1, pen=RED):
    for start, end in pairwise(points):
        drawing.line(turtle, pen, start, end)
    return drawing


def pixels_of(lines):
    """The pixels of lines (pen, start, end), drawn one by one."""
    canvas = Canvas()
    for pen, start, end in lines:
        canvas.draw(np.array([start * METER]), np.array([end * METER]), pen)
    return canvas.pixels.tobytes()


def away(point, start, end):
    """How far a point is from a straight line between two others."""
    way = end - start
    if not way:
        return abs(point - start)
    share = min(max(((point - start) * way.conjugate()).real / abs(way) ** 2, 0.0), 1.0)
    return abs(point - start - share * way)


CIRCLE = path([0.0288] * 218, length=0.032)


# As pixels


@settings(max_examples=25)
@given(st.lists(st.tuples(st.sampled_from([1, 2]), st.sampled_from([RED, BLUE]), places)))
def test_the_pixels_are_those_of_every_line_in_its_order(hops):
    ours, here, lines = Drawing(), {1: 0j, 2: 5 + 5j}, []
    for turtle, pen, there in hops:
        ours.line(turtle, pen, here[turtle], there)
        lines.append((pen, here[turtle], there))
        here[turtle] = there
    assert ours.pixels() == pixels_of(lines)


@pytest.mark.parametrize("points", [CIRCLE, path([0.0] * 200), path([0.5, 0.0, 0.0, -0.5] * 20)])
def test_straight_ways_that_are_drawn_as_one_line_have_the_same_pixels(points):
    expected = pixels_of([(RED, start, end) for start, end in pairwise(points)])
    assert draw(Drawing(), points).pixels() == expected


def test_a_colour_is_that_of_the_pixel_nearest_to_the_place():
    ours = draw(Drawing(), [1 + 1j, 2 + 1j])
    assert ours.colour_at(1.5 + 1j) == RED.colour
    assert ours.colour_at(1.5 + 1.2j) == (255, 255, 255)


# As polylines


@settings(max_examples=25)
@given(st.lists(turns, min_size=1, max_size=200), st.floats(1e-5, 0.2))
def test_no_point_that_is_left_out_lies_far_from_the_polyline(turning, length):
    points = path(turning, length=length)
    found = [stroke.points for stroke in draw(Drawing(), points).polylines()]
    ways = [way for stroke in found for way in pairwise(stroke)]
    for point in points:
        assert min(away(point * METER, *way) for way in ways) <= TOLERANCE + 1e-9


@given(st.lists(steps, min_size=1, max_size=100))
def test_nor_does_the_polyline_lead_where_nobody_was(hops):
    points = [5 + 5j]
    for hop in hops:
        points.append(points[-1] + hop)
    (stroke,) = draw(Drawing(), points).polylines()
    drawn = {point * METER for point in points}
    assert set(stroke.points) <= drawn
    assert (stroke.points[0], stroke.points[-1]) == (points[0] * METER, points[-1] * METER)


def test_a_straight_way_has_two_points():
    (stroke,) = draw(Drawing(), path([0.0] * 300)).polylines()
    assert len(stroke.points) == 2


@pytest.mark.parametrize(
    "more",
    [
        pytest.param(lambda ours: draw(ours, [6 + 5j, 7 + 5j], pen=BLUE), id="another-pen"),
        pytest.param(lambda ours: draw(ours, [8 + 5j, 9 + 5j]), id="from-elsewhere"),
        pytest.param(lambda ours: draw(ours, [6 + 5j, 7 + 5j], turtle=2), id="another-turtle"),
    ],
)
def test_a_new_polyline_begins_with(more):
    ours = draw(Drawing(), [5 + 5j, 6 + 5j])
    more(ours)
    assert len(ours.polylines()) == 2


# Bounds


def test_beyond_its_bound_a_drawing_is_kept_as_pixels_alone(monkeypatch):
    monkeypatch.setattr(drawing, "MOST_POINTS", 50)
    points = path([math.sin(n / 5) * 0.2 for n in range(1000)], start=1 + 5j, length=0.01)
    ours = draw(Drawing(), points)
    kept = sum(len(stroke.points) for stroke in ours.polylines())
    assert kept <= 51
    base = np.frombuffer(ours.base() or b"", np.uint32)
    whole = np.frombuffer(ours.pixels(), np.uint32)
    assert ours.pixels() == pixels_of([(RED, start, end) for start, end in pairwise(points)])
    assert (whole[base != 0] != 0).all()
    assert 0 < (base != 0).sum() <= (whole != 0).sum()


def test_a_cleared_drawing_is_as_new():
    ours = draw(Drawing(), CIRCLE)
    ours.polylines()
    ours.clear()
    assert (ours.polylines(), ours.base(), any(ours.pixels())) == ([], None, False)
    draw(ours, CIRCLE)
    assert len(ours.polylines()) == 1
