"""What ``send-goal`` and ``watch`` draw on a terminal: the goal, its feedback, a map of turtles."""

from __future__ import annotations

import io
import math
import re
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import anyio
import pytest

from turtleact import Action, Message, open_node
from turtleact.actions.patrol import Patrol
from turtleact.interfaces import float64, get_interface, int32, string
from turtleact.interfaces.standard import (
    Point,
    TurtlePose,
)

ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|[78])")
interface: Callable[[str], Any] = get_interface


class Terminal(io.StringIO):
    """A terminal that keeps what is written."""

    encoding = "utf-8"

    def isatty(self):
        return True


class Report(Action, type_name="display_test_interfaces/action/Report"):
    class Goal(Message):
        order: int32 = 5

    class Result(Message):
        pass

    class Feedback(Message):
        text: string = ""
        numbers: list[int32] = []
        place: Point = Point()
        remaining: float64 = 0.0


@pytest.fixture
def drawn(on_graph, monkeypatch):
    """What a command line writes to a terminal of some size, on a graph of these nodes."""

    def run(nodes, *arguments, columns=80, rows=30, **environment):
        monkeypatch.delenv("NO_COLOR", raising=False)
        settings = {"TERM": "xterm-256color", "COLUMNS": str(columns), "LINES": str(rows)}
        for name, value in {**settings, **environment}.items():
            monkeypatch.setenv(name, value)
        terminal = Terminal()
        monkeypatch.setattr(sys, "stdout", terminal)
        on_graph(nodes, *arguments)
        return terminal.getvalue()

    return run


def last_frame(text):
    """The lines of the last frame, without styles."""
    shown = ESCAPE.sub("", text).replace("\r", "")
    frame = shown[shown.rindex("● /") :].partition("Result:")[0]
    return [line.rstrip() for line in frame.rstrip("\n").split("\n")]


def reporting(*feedback):
    """A server whose goals publish this feedback."""

    async def body(goal):
        for each in feedback:
            yield each
            await anyio.sleep(0.15)
        yield Report.Result()

    @asynccontextmanager
    async def nodes(transport):
        async with open_node("server", transport=transport) as node:
            node.action_server(Report, "/report", body)
            yield

    return nodes


FULL = Report.Feedback("one\ntwo \x1b[2J" + " words" * 40, [*range(20)], Point(x=1 / 3), 1e7)

# --- the goal and its feedback ------------------------------------------------------------------


def test_each_field_of_the_feedback_is_shown_and_long_ones_are_cut(drawn):
    head, goal, *fields = last_frame(drawn(reporting(FULL), "send-goal", "report"))
    assert re.fullmatch(r"● /report  SUCCEEDED \d\.\d s +[0-9a-f]{8}", head)
    assert goal == "  order 5"
    assert fields == [
        "  text       one·two ·[2J words words words words words words words words words",
        "             words words words words words words words words words words words",
        "             words words words words words words words words words words words",
        "             words words words words words words words words words",
        "  numbers    [0, 1, 2, 3, … 12 more …, 16, 17, 18, 19]",
        "  place      x 0.333, y 0, z 0",
        "  remaining  1e+07",
    ]


@pytest.mark.parametrize(("columns", "rows"), [(20, 3), (30, 8), (60, 20), (80, 24), (140, 50)])
def test_a_frame_never_leaves_its_window(drawn, columns, rows):
    text = drawn(reporting(FULL), "send-goal", "report", columns=columns, rows=rows)
    frame = last_frame(text)
    assert max(map(len, frame)) <= columns
    assert len(frame) < rows


def test_what_remains_is_a_bar_and_the_rest_is_told_in_words(drawn):
    steps = [Report.Feedback(remaining=each) for each in (-4.0, 1.0)]
    text = ESCAPE.sub("", drawn(reporting(*steps), "send-goal", "report"))
    assert "  0%  remaining 4.00" in text
    assert " 75%  remaining 1.00" in text
    assert "remaining" not in last_frame(text)[0]
    assert "no feedback yet" in ESCAPE.sub("", drawn(reporting(), "send-goal", "report"))


def test_colours_are_left_out_if_the_user_wants_none(drawn):
    colour = re.compile(r"\x1b\[[0-9;]*3[0-7]")
    assert colour.search(drawn(reporting(FULL), "send-goal", "report"))
    assert not colour.search(drawn(reporting(FULL), "send-goal", "report", NO_COLOR="1"))


def test_a_goal_of_others_is_watched_with_what_is_known_of_it(drawn, graphs):
    nodes = graphs.in_turn(graphs.goals)
    frame = last_frame(drawn(nodes, "watch", "count"))
    assert re.fullmatch(r"● /count  SUCCEEDED \d+\.\d s +c53d3439", frame[0])
    assert frame[1] == "  order 120"
    assert frame[2].startswith("  sequence  [0, 1, 1, 2, … ")


# --- the map ------------------------------------------------------------------------------------


def driving(*poses, others=(), name="/patrol"):
    """A server whose goals take ``turtle1`` to these poses, and other turtles that stand still."""

    @asynccontextmanager
    async def nodes(transport):
        async with AsyncExitStack() as stack:
            node = await stack.enter_async_context(open_node("server", transport=transport))
            publishers = {"turtle1": node.publisher(TurtlePose, "/turtle1/pose")}
            publishers |= {each: node.publisher(TurtlePose, f"/{each}/pose") for each, _ in others}

            async def body(goal):
                for each, pose in others:
                    await anyio.sleep(0.02)  # the command subscribes
                    publishers[each].publish(pose)
                for pose in poses:
                    await anyio.sleep(0.02)
                    publishers["turtle1"].publish(pose)
                await anyio.sleep(0.15)
                return Patrol.Result()

            node.action_server(Patrol, name, body)
            yield

    return nodes


def at(x, y, theta=0.0):
    return TurtlePose(x=x, y=y, theta=theta)


def goal(*targets):
    return f"targets: [{', '.join(f'{{x: {x}, y: {y}}}' for x, y in targets)}]"


def map_of(text):
    """The rows of the last frame's map, without its walls."""
    rows = [line for line in last_frame(text) if line.startswith("│")]
    return [row[1 : row.index("│", 1)] for row in rows]


@pytest.mark.parametrize(
    ("pose", "row", "column", "arrow"),
    [
        (at(0, 0, 0), -1, 0, "→"),
        (at(11.1, 0, math.pi / 4), -1, -1, "↗"),
        (at(11.1, 11.1, math.pi / 2), 0, -1, "↑"),
        (at(0, 11.1, -math.pi), 0, 0, "←"),
        (at(-1, 20, -math.pi / 2), 0, 0, "↓"),
    ],
)
def test_a_turtle_is_drawn_where_it_is_and_looks_where_it_looks(drawn, pose, row, column, arrow):
    assert map_of(drawn(driving(pose), "send-goal", "patrol"))[row][column] == arrow


def test_targets_are_numbered_and_get_a_tick_when_the_turtle_has_passed_them(drawn):
    targets = [(2, 8), (8, 8), *[(2, 2)] * 7, (8, 2)]
    route = [at(1, 8), at(3, 8), at(5, 8)]
    rows = map_of(drawn(driving(*route), "send-goal", "patrol", goal(*targets)))
    marks = re.findall("[0-9×]✓?", "".join(rows).replace("turtle1", ""))
    assert marks == ["1✓", "2", "9", "×"]


def test_rounds_are_counted_and_reached_in_order(drawn):
    route = [at(2, 8), at(8, 8), at(2, 8), at(5, 5)]
    text = ESCAPE.sub(
        "", drawn(driving(*route), "send-goal", "patrol", f"{{{goal((2, 8), (8, 8))}, loops: 1}}")
    )
    assert "3 of 4 targets" in text
    assert "4 of 4" not in text


def test_a_turtle_of_another_action_is_followed_by_the_name_of_the_action(drawn):
    text = drawn(driving(at(5, 5), name="/turtle1/patrol"), "send-goal", "turtle1/patrol")
    assert any("→" in row for row in map_of(text))


def test_without_a_turtle_or_in_a_small_window_there_is_no_map(drawn):
    assert "┌" not in drawn(driving(), "send-goal", "patrol", "turtle: arm")
    assert "┌" not in drawn(driving(at(5, 5)), "send-goal", "patrol", columns=38)
    assert "┌" not in drawn(driving(at(5, 5)), "send-goal", "patrol", rows=9)
