"""The map: where turtles, targets, trails and names stand."""

from __future__ import annotations

import math
import re

import pytest

from turtleact import render

SIDE = 11.0
BLANK = chr(0x2800)


def world(**changes):
    middle = render.Turtle(SIDE / 2, SIDE / 2, 0.0)
    return render.MapView(side=SIDE, turtles=[middle])._replace(**changes)


def drawn(map_view, rows=6):
    """A map's rows, without its walls."""
    return [line[1:-1] for line in render.world_map(map_view, rows).plain.splitlines()[1:-1]]


def trail(*places, turtle="turtle1", colour="cyan", trails=None):
    """The trail of a turtle that has been in these places, and others' before."""
    trails = trails or render.Trails(SIDE)
    for x, y in places:
        trails.follow(turtle, x, y, colour)
    return trails


# --- the map --------------------------------------------------------------------------------


def test_the_walls_are_the_border():
    lines = render.world_map(world(turtles=[]), 5).plain.splitlines()
    assert lines == ["┌──────────┐", *[f"│{BLANK * 10}│"] * 5, "└──────────┘"]


@pytest.mark.parametrize(
    ("x", "y", "row", "column"),
    [
        (0.0, 0.0, -1, 0),
        (SIDE, 0.0, -1, -1),
        (0.0, SIDE, 0, 0),
        (SIDE, SIDE, 0, -1),
        (99.0, -99.0, -1, -1),
    ],
)
def test_a_turtle_stands_where_it_is(x, y, row, column):
    assert drawn(world(turtles=[render.Turtle(x, y, 0.0)]))[row][column] == "→"


@pytest.mark.parametrize(
    ("degrees", "arrow"),
    [(0, "→"), (45, "↗"), (90, "↑"), (135, "↖"), (180, "←"), (-180, "←"), (-90, "↓"), (-44, "↘")],
)
def test_a_turtle_points_where_it_looks(degrees, arrow):
    turtle = render.Turtle(5.0, 5.0, math.radians(degrees))
    assert arrow in "".join(drawn(world(turtles=[turtle])))


def test_targets_are_numbered_from_the_first_ahead():
    shown = "".join(drawn(world(targets=[render.Target(1.0, 1.0, 3), render.Target(9.0, 9.0, 4)])))
    assert "3" in shown
    assert "4" in shown


def test_a_number_of_two_digits_is_a_cross():
    assert "×" in "".join(drawn(world(targets=[render.Target(1.0, 1.0, 10)])))


def test_a_reached_target_has_a_tick_even_below_a_turtle():
    here = render.Target(SIDE / 2, SIDE / 2, 1, is_reached=True)
    edge = render.Target(SIDE, 0.0, 2, is_reached=True)
    shown = "".join(drawn(world(targets=[here, edge])))
    assert "→✓" in shown
    assert "✓2" in shown


def test_targets_have_the_colour_of_their_turtle_until_they_are_reached():
    targets = [
        render.Target(1.0, 1.0, 1, "#123456"),
        render.Target(9.0, 9.0, 2, "#123456", is_reached=True),
    ]
    text = render.world_map(world(targets=targets), 6)
    styles = {text.plain[span.start : span.end]: str(span.style) for span in text.spans}
    assert (styles["1"], styles["2✓"]) == ("#123456", "green")


def test_a_turtle_hides_the_target_that_it_stands_on():
    shown = "".join(drawn(world(targets=[render.Target(SIDE / 2, SIDE / 2, 1)])))
    assert "1" not in shown


def test_a_trail_is_a_line_of_dots():
    shown = drawn(world(turtles=[], ink=trail((0.0, 0.0), (SIDE, 0.0))), rows=5)
    assert shown[-1] == "⣀" * 10


def test_a_trail_of_one_place_is_nothing_yet():
    assert set("".join(drawn(world(turtles=[], ink=trail((1.0, 1.0)))))) == {BLANK}


# --- names on the map -----------------------------------------------------------------------


def names(*turtles, rows=6, ink=None):
    view = render.MapView(11.0, [render.Turtle(*each) for each in turtles], ink)
    return [line[1:-1] for line in render.world_map(view, rows).plain.splitlines()[1:-1]]


def test_a_name_stands_to_the_right_or_else_to_the_left():
    blank = chr(0x2800)
    assert f"→{blank}leo" in "".join(names((2.0, 5.0, 0.0, "leo")))
    assert f"leo{blank}→" in "".join(names((11.0, 5.0, 0.0, "leo")))


def test_a_name_stands_where_it_hides_no_trail():
    trails = render.Trails(11.0)
    for x in (5.5, 11.0):
        trails.follow("leo", x, 5.5, "cyan")
    assert re.search("leo.→[⠁-⣿]{5}", "".join(names((5.5, 5.5, 0.0, "leo"), ink=trails)))


def test_names_do_not_hide_turtles_or_each_other():
    text = "".join(names((5.5, 5.5, 0.0, "leo"), (6.5, 5.5, 0.0, "mia"), (4.6, 5.5, 0.0, "eva")))
    assert text.count("→") == 3
    assert all(name in text for name in ("leo", "mia", "eva"))


def test_a_name_without_room_is_left_out():
    assert "leonardo" not in "".join(names((5.5, 5.5, 0.0, "leonardo"), rows=3))


def test_a_long_name_is_cut():
    assert "leonardo_of…" in "".join(names((1.0, 5.5, 0.0, "leonardo_of_vinci"), rows=12))
