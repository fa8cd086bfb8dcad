"""What a terminal shows of a server: what stands where, what is cut, what is left out."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from turtleact import render
from turtleact.goals.state import GoalStatus

ESCAPE = re.compile(r"\x1b\[[0-9;]*m")
WORLD = render.MapView(11.0, [render.Turtle(5.5, 5.5, 0.0, "turtle1")])
RUNS = render.GoalRow("/patrol", "ab" * 16, GoalStatus.EXECUTING, 12.34, "1 of 2 targets")


def shown(view, width=99, height=30):
    content = render.board(view, width=width, height=height)
    return [ESCAPE.sub("", line) for line in render.lines(content, width=width, height=height)]


def test_the_goals_stand_beside_the_map():
    lines = shown(render.Board(["ready"], WORLD, [RUNS]), width=140)
    assert lines[0] == "ready"
    assert re.fullmatch(r"┌─+┐ ● /patrol +EXECUTING +12\.3 s  abababab  1 of 2 targets", lines[1])


def test_a_narrow_table_leaves_out_the_id_and_the_progress():
    assert shown(render.Board(["ready"], WORLD, [RUNS]))[1].endswith(" EXECUTING    12.3 s")


def test_a_name_is_never_cut_but_folded():
    row = RUNS._replace(name="/a/very/long/name/of/an/action/that/nobody/would/choose")
    for width in (30, 45, 60, 99, 140):
        lines = [line.rpartition("│ ")[2] for line in shown(render.Board([], WORLD, [row]), width)]
        text = "".join(line.rpartition("┐ ")[2].strip() for line in lines)
        assert row.name in text


def test_a_long_heading_is_wrapped_between_words():
    names = "ready: " + ", ".join(["/fibonacci", "/patrol", "/turtle1/rotate_absolute"])
    assert shown(render.Board([names]), 30) == [
        "ready: /fibonacci, /patrol,",
        "/turtle1/rotate_absolute",
    ]


def test_a_heading_that_would_fill_the_window_is_cut():
    lines = shown(render.Board(["word " * 100], goals=[RUNS]), 30, 8)
    assert lines[0].endswith("…")
    assert lines[1].startswith("● /patrol")


def test_without_a_world_the_table_stands_in_its_place():
    assert shown(render.Board(["ready"], None, [RUNS]), width=72)[1:] == [
        "● /patrol               EXECUTING    12.3 s  abababab  1 of 2 targets"
    ]


def test_a_small_window_has_no_map():
    assert not any("┌" in line for line in shown(render.Board(["x"], WORLD, []), 39, 20))
    assert not any("┌" in line for line in shown(render.Board(["x"], WORLD, []), 99, 7))


def test_more_goals_than_there_is_room_for_are_counted():
    lines = shown(render.Board(["ready"], None, [RUNS] * 9, 90), height=5)
    assert lines[-1] == "… 96 more"


def test_keys_stand_without_a_table():
    assert shown(render.Board(["driving"], keys=["Q  quit"])) == ["driving", "Q  quit"]


def test_names_of_the_graph_command_no_terminal():
    row = RUNS._replace(name="/a\x1b[2J")
    text = "".join(shown(render.Board(["\x1b[2J"], None, [row])))
    assert "\x1b" not in text


def test_a_long_time_is_told_in_hours():
    assert "3.0 h" in shown(render.Board(["x"], None, [RUNS._replace(age=10_800.0)]))[1]


@given(st.integers(1, 120), st.integers(1, 50), st.integers(0, 20), st.booleans())
def test_a_board_never_leaves_its_window(width, height, goals, has_map):
    view = render.Board(["x" * 200] * 2, WORLD if has_map else None, [RUNS] * goals)
    lines = shown(view, width, height)
    assert len(lines) <= height
    assert max(map(cell_len, lines)) <= width
