"""What a terminal shows of a server: what stands where, what is cut, what is left out."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from turtleact import render
from turtleact.goal import GoalStatus

ESCAPE = re.compile(r"\x1b\[[0-9;]*m")
WORLD = render.MapView(11.0, [render.Turtle(5.5, 5.5, 0.0, "turtle1")])
RUNS = render.GoalRow("/patrol", "ab" * 16, GoalStatus.EXECUTING, 12.34, "1 of 2 places")


def shown(view, width=99, height=30):
    content = render.board(view, width=width, height=height)
    return [ESCAPE.sub("", line) for line in render.lines(content, width=width, height=height)]


def test_the_goals_stand_beside_the_map():
    lines = shown(render.Board(["ready"], WORLD, [RUNS]), width=140)
    assert lines[0] == "ready"
    assert re.fullmatch(r"┌─+┐ ● /patrol +EXECUTING +12\.3 s  abababab  1 of 2 places", lines[1])


def test_a_narrow_table_leaves_out_the_id_and_the_progress():
    assert shown(render.Board(["ready"], WORLD, [RUNS]))[1].endswith(" EXECUTING    12.3 s")


def test_the_newest_lines_of_the_log_fill_what_is_left():
    log = [f"line {number}" for number in range(50)]
    lines = shown(render.Board(["ready"], WORLD, [], log=log), height=20)
    assert lines[-3:] == ["line 47", "line 48", "line 49"]
    assert len(lines) == 20


def test_without_a_world_the_table_stands_in_its_place():
    assert shown(render.Board(["ready"], None, [RUNS], log=["log"]), width=72)[1:] == [
        "● /patrol               EXECUTING    12.3 s  abababab  1 of 2 places",
        "log",
    ]


def test_a_small_window_has_no_map():
    assert not any("┌" in line for line in shown(render.Board(["x"], WORLD, []), 39, 20))
    assert not any("┌" in line for line in shown(render.Board(["x"], WORLD, []), 99, 10))


def test_more_goals_than_there_is_room_for_are_counted():
    lines = shown(render.Board(["ready"], None, [RUNS] * 9, 90), height=8)
    assert lines[-1] == "… 96 more"


def test_keys_stand_above_the_log_and_without_a_table():
    assert shown(render.Board(["driving"], keys=["Q  quit"], log=["log"])) == [
        "driving",
        "Q  quit",
        "log",
    ]


def test_names_of_the_graph_command_no_terminal():
    row = RUNS._replace(name="/a\x1b[2J")
    text = "".join(shown(render.Board(["\x1b[2J"], None, [row], log=["\x1b[2J"])))
    assert "\x1b" not in text


def test_a_long_time_is_told_in_hours():
    assert "3.0 h" in shown(render.Board(["x"], None, [RUNS._replace(age=10_800.0)]))[1]


@given(st.integers(1, 120), st.integers(1, 50), st.integers(0, 20), st.booleans())
def test_a_board_never_leaves_its_window(width, height, goals, has_map):
    view = render.Board(
        ["x" * 200] * 2, WORLD if has_map else None, [RUNS] * goals, log=["y" * 200] * 30
    )
    lines = shown(view, width, height)
    assert len(lines) <= height
    assert max(map(cell_len, lines)) <= width


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


# --- trails ---------------------------------------------------------------------------------


def test_a_trail_follows_in_strides():
    trails = render.Trails(11.0)
    for step in range(100):
        trails.follow("leo", step / 64, 0.0, "cyan")
    assert [round(x * 64) for x, _ in trails._places["leo"]][:4] == [0, 6, 12, 18]


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
