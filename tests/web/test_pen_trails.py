"""Trails are bounded, stay near the turtle's way, and are told piece by piece."""

from __future__ import annotations

from itertools import count, pairwise
from math import cos, hypot, pi, sin

from turtleact.web.pen_trails import FIRST_PEN, MOST_LINES, MOST_POINTS, Pen, PenTrails


def trails() -> PenTrails:
    revisions = count(1)
    return PenTrails(lambda: next(revisions))


def places(trails: PenTrails, since: int = 0) -> list[tuple[float, float]]:
    return [point[:2] for point in trails.since(since)["turtle1"].points]


def drive(trails: PenTrails, *way: tuple[float, float]) -> None:
    for x, y in way:
        trails.follow("turtle1", x, y)


def test_a_straight_way_needs_few_points_and_a_corner_is_one():
    drawn = trails()
    drive(drawn, *((index / 100, 0.0) for index in range(101)))
    drive(drawn, *((1.0, index / 100) for index in range(1, 101)))
    assert (1.0, 0.0) in places(drawn)
    assert len(places(drawn)) < 12


def test_an_arc_stays_near_the_way():
    drawn = trails()
    drive(drawn, *((cos(a / 50), sin(a / 50)) for a in range(int(100 * pi))))
    points = places(drawn)
    middles = [((a + c) / 2, (b + d) / 2) for (a, b), (c, d) in pairwise(points)]
    assert all(abs(hypot(*middle) - 1.0) < 0.015 for middle in middles)


def test_a_turtle_that_stands_still_draws_nothing():
    drawn = trails()
    drive(drawn, *[(1.0, 1.0)] * 100)
    assert len(places(drawn)) == 1


def test_only_the_new_end_is_told():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (0.5, 0.0), (1.0, 0.0))
    assert not drawn.since(3)
    drive(drawn, (1.5, 0.0))
    assert not drawn.since(3)["turtle1"].is_whole
    assert places(drawn, 3) == [(1.0, 0.0)]


def test_the_pen_is_told_with_each_point():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (0.5, 0.0))
    drawn.set_pen("turtle1", Pen("#ff0000", 5))
    drive(drawn, (1.0, 0.0), (1.5, 0.0))
    drawn.set_pen("turtle1", Pen("#ff0000", 5, is_off=True))
    drive(drawn, (2.0, 0.0), (2.5, 0.0))
    pens = [(x, colour, width) for x, _, colour, width in drawn.since(0)["turtle1"].points]
    assert pens[:3] == [(0.0, "", 0), (0.5, FIRST_PEN.colour, 3), (1.0, "#ff0000", 5)]
    assert pens[-1] == (2.0, "", 5)


def test_clearing_tells_every_page_to_begin_anew_and_keeps_pens():
    drawn = trails()
    drawn.set_pen("turtle1", Pen("#ff0000", 5))
    drive(drawn, (0.0, 0.0), (1.0, 0.0))
    drawn.clear()
    tail = drawn.since(2)["turtle1"]
    assert (tail.is_whole, tail.points) == (True, [])
    drive(drawn, (5.0, 5.0), (6.0, 5.0), (7.0, 5.0))
    assert drawn.since(0)["turtle1"].points[1][2] == "#ff0000"
    drawn.reset()
    drive(drawn, (5.0, 5.0), (6.0, 5.0), (7.0, 5.0))
    assert drawn.since(0)["turtle1"].points[1][2] == FIRST_PEN.colour


def test_a_turtle_that_comes_back_elsewhere_draws_no_line_to_there():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (1.0, 0.0))
    drawn.lift("turtle1")
    drawn.lift("nobody")
    drive(drawn, (5.0, 5.0))
    assert drawn.since(0)["turtle1"].points[-1] == (5.0, 5.0, "", 0)


def test_the_lines_of_turtles_that_are_gone_are_dropped_first():
    drawn = trails()
    drive(drawn, (1.0, 1.0))
    for index in range(2 * MOST_LINES):
        drawn.follow(f"gone{index}", 0.0, 0.0)
        drawn.lift(f"gone{index}")
    kept = drawn.since(0)
    assert len(kept) == MOST_LINES
    assert "turtle1" in kept


def test_a_trail_is_bounded():
    drawn = trails()
    for index in range(4 * MOST_POINTS):
        drive(drawn, (index % 2, index / 1000))
    assert MOST_POINTS / 2 < len(places(drawn)) <= MOST_POINTS
