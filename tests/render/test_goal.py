"""A goal in lines: what stands where, what is cut, what is left out."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from turtleact import render
from turtleact.actions.patrol import Patrol
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Message, float64, int32, string, to_dict
from turtleact.interfaces.standard import Fibonacci, PatrolCommandInterface, Point

SIDE = 11.0
ESCAPE = re.compile(r"\x1b\[[0-9;]*m")


class Feedback(Message, type_name="render_test_interfaces/msg/Feedback"):
    text: string = ""
    numbers: list[int32] = []
    target: Point = Point()
    remaining: float64 = 0.0


class Nothing(Message, type_name="render_test_interfaces/msg/Nothing"):
    pass


def text_of(content, *, width=80, height=24):
    """The lines of a renderable, without their styling."""
    return [ESCAPE.sub("", line) for line in render.lines(content, width=width, height=height)]


def view(**changes):
    goal = render.GoalView(
        name="/patrol",
        goal=Fibonacci.Goal(order=5),
        goal_id="0123456789abcdef" * 2,
        status=GoalStatus.EXECUTING,
        age=7.31,
    )
    return goal._replace(**changes)


def world(**changes):
    middle = render.Turtle(SIDE / 2, SIDE / 2, 0.0)
    return render.MapView(side=SIDE, turtles=[middle])._replace(**changes)


# --- goal, progress, feedback -------------------------------------------------------------------


def test_the_goal_is_told_with_its_state_and_age():
    head, goal = text_of(render.goal_panel(view(), width=80))
    assert re.fullmatch(r"● /patrol  EXECUTING 7\.3 s +01234567", head.rstrip())
    assert goal.strip() == "order 5"


@pytest.mark.parametrize("status", list(GoalStatus))
def test_every_state_has_its_name_shown(status):
    assert status.name in text_of(render.goal_panel(view(status=status), width=80))[0]


def test_a_long_goal_is_cut_to_the_window():
    goal = PatrolCommandInterface.Goal(targets=[Point(x=1.0, y=2.0)] * 5)
    line = text_of(render.goal_panel(view(goal=goal), width=40), width=40)[1]
    assert line == "  targets [(x 1, y 2, z 0), (x 1, y 2, …"


def test_a_long_goal_is_wrapped_where_there_is_room():
    goal = PatrolCommandInterface.Goal(targets=[Point(x=1.0, y=2.0)] * 5)
    lines = text_of(render.goal_panel(view(goal=goal), width=40, rows=2), width=40)[1:]
    assert lines == [
        "  targets [(x 1, y 2, z 0), (x 1, y 2, z",
        "  0), (x 1, y 2, z 0), (x 1, y 2, z 0),…",
    ]


def test_a_known_fraction_is_a_bar():
    [line] = text_of(render.progress_line(0.5, "3.4 m"), width=40)
    assert re.fullmatch(r"  ━+.━+ +50%  3\.4 m", line)


def test_an_unknown_fraction_is_words():
    assert text_of(render.progress_line(None, "soon")) == ["  soon"]


def table(feedback, width=60, rows=10):
    content = render.feedback_table(feedback, width=width, rows=rows)
    return [line.rstrip() for line in text_of(content, width=width)]


def test_each_field_of_the_feedback_has_its_row():
    feedback = Feedback("on", [1, 2], Point(x=1.5), 2.25)
    assert table(feedback) == [
        "  text       on",
        "  numbers    [1, 2]",
        "  target     x 1.5, y 0, z 0",
        "  remaining  2.25",
    ]


def test_no_feedback_is_said():
    assert table(None) == ["  no feedback yet"]


def test_a_message_without_fields_is_empty():
    assert table(Nothing()) == [""]


def test_a_long_name_leaves_half_of_the_window_to_its_value():
    assert table(PatrolCommandInterface.Feedback(feedback_msg="value"), width=20) == [
        "  feedback_…  value"
    ]


def test_a_long_list_is_cut_in_the_middle():
    assert table(Fibonacci.Result(sequence=list(range(20)))) == [
        "  sequence  [0, 1, 2, 3, … 12 more …, 16, 17, 18, 19]"
    ]


def test_a_long_text_is_wrapped_between_words():
    feedback = PatrolCommandInterface.Feedback(feedback_msg="Target 1 reached")
    assert table(feedback, width=30) == ["  feedback_msg  Target 1", " " * 16 + "reached"]


def test_a_very_long_text_is_cut_to_the_window():
    feedback = PatrolCommandInterface.Feedback(feedback_msg="x" * 1000)
    lines = ["  feedback_msg  " + "x" * 14, *[" " * 16 + "x" * 14] * 2]
    assert table(feedback, width=30) == [*lines, " " * 16 + "x" * 13 + "…"]
    assert table(feedback, width=30, rows=1) == ["  feedback_msg  " + "x" * 13 + "…"]


def test_every_field_has_a_line_before_a_long_one_has_two():
    lines = table(Feedback(text="word " * 20), width=30, rows=5)
    assert [line.split()[0] for line in lines] == ["text", "word", "numbers", "target", "remaining"]


def test_more_fields_than_rows_are_counted():
    assert table(Feedback(), rows=2)[-1] == "  … 2 more"


def test_control_characters_do_not_reach_the_terminal():
    assert table(PatrolCommandInterface.Feedback(feedback_msg="a\x1b[2J\nb")) == [
        "  feedback_msg  a·[2J·b"
    ]


@pytest.mark.parametrize(
    ("number", "shown"),
    [(0.0, "0"), (-1.5, "-1.5"), (1 / 3, "0.333"), (100.0, "100"), (1.5e12, "1.5e+12")],
)
def test_a_number_is_rounded(number, shown):
    assert table(Feedback(remaining=number))[-1].split() == ["remaining", shown]


# --- the frame ----------------------------------------------------------------------------------


def frame(width, height, map_view=None, **changes):
    content = render.frame(view(**changes), map_view, width=width, height=height)
    return text_of(content, width=width, height=height)


def test_the_map_stands_beside_the_feedback():
    lines = frame(79, 23, world(), feedback=Feedback(), fraction=0.5, progress="x")
    assert lines[2].startswith("┌" + "─" * 34 + "┐")
    assert any(re.match(r"│.*│ +text", line) for line in lines)


def test_in_a_narrow_window_the_feedback_stands_below_the_map():
    feedback = PatrolCommandInterface.Feedback(feedback_msg="Target 1 reached")
    lines = frame(60, 29, world(), feedback=feedback, fraction=0.5, progress="x")
    assert lines[2].startswith("┌" + "─" * 44 + "┐")
    assert lines[-2:-1] == ["  feedback_msg  Target 1 reached"]
    assert len(lines) == 28


def test_the_last_frame_of_a_patrol_has_room_for_its_feedback_in_a_narrow_window():
    feedback = Patrol.Feedback(index=1, target=Point(5.0, 1.0, 0.0))
    lines = frame(60, 18, world(), feedback=feedback)
    assert {line.split()[0] for line in lines[-8:]} >= to_dict(feedback).keys()


def test_the_map_keeps_its_size_while_numbers_in_the_feedback_change():
    numbers = [Feedback(target=Point(x, x, x), remaining=x) for x in (0.0, 1.5, -0.123)]
    frames = [frame(60, 30, world(), feedback=each, fraction=0.5) for each in numbers]
    assert len({(len(lines), sum("│" in line for line in lines)) for lines in frames}) == 1


def test_in_a_low_narrow_window_the_feedback_stands_beside_the_map():
    assert any(
        re.match(r"│.*│ +text", line) for line in frame(60, 14, world(), feedback=Feedback())
    )


@pytest.mark.parametrize(("width", "height"), [(39, 24), (80, 9), (30, 10)])
def test_a_small_window_has_no_map(width, height):
    assert not any("┌" in line for line in frame(width, height, world(), feedback=Feedback()))


@pytest.mark.parametrize("map_view", [world(), None], ids=["map", "no map"])
def test_the_feedback_of_a_watched_goal_is_missed_from_then_on_alone(map_view):
    assert any("no feedback yet" in line for line in frame(80, 24, map_view))
    watched = frame(80, 24, map_view, goal=None)
    assert any("no feedback since you began to watch" in line for line in watched)


def test_a_goal_without_a_turtle_has_no_map():
    assert not any("┌" in line for line in frame(80, 24))


@given(st.integers(1, 120), st.integers(1, 50), st.booleans())
def test_a_frame_never_leaves_its_window(width, height, has_map):
    feedback = Feedback("text" * 50, list(range(50)), Point(), 1.0)
    lines = frame(width, height, world() if has_map else None, feedback=feedback, fraction=0.3)
    assert len(lines) <= height
    assert max(map(cell_len, lines)) <= width


def test_without_color_there_are_no_colors(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    content = render.frame(view(feedback=Feedback()), world(), width=80, height=24)
    assert not re.search(
        r"\x1b\[[0-9;]*3[0-7]", "".join(render.lines(content, width=80, height=24))
    )


def test_with_colors_there_are_some(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    content = render.frame(view(feedback=Feedback()), world(), width=80, height=24)
    assert "\x1b[36m" in "".join(render.lines(content, width=80, height=24))


def test_no_line_ends_in_blanks():
    shown = text_of(render.frame(view(), world(), width=79, height=20), width=79)
    assert shown == [line.rstrip(" ") for line in shown]
