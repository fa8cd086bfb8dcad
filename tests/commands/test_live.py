"""The live display: what it tells of a goal, and the whole of it on a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import subprocess
import sys
from typing import Any, cast

import anyio
import pytest

from turtleact import render
from turtleact.client.goal_handle import Outcome
from turtleact.commands import live, terminal
from turtleact.commands.live import LiveTranscript
from turtleact.commands.terminal import GIVE_BACK
from turtleact.commands.transcript import Sent
from turtleact.goal import GoalStatus
from turtleact.interfaces import Message, float64, int32, string
from turtleact.interfaces.standard import Fibonacci, PatrolCommandInterface, Point, TurtlePose
from turtleact.node import open_node

from .. import warm
from .ttys import open_terminal, read

ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|[78])")
PATROL = "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"

# --- what is told ---------------------------------------------------------------------------


class Roll(Message, type_name="live_test_interfaces/msg/Roll"):
    remaining: float64 = 0.0
    turns_remaining: string = ""


class Drive(Message, type_name="live_test_interfaces/msg/Drive"):
    targets: list[Point] = []
    loops: int32 = 0
    turtle: string = "turtle1"


class Handle:
    """What the display asks of a goal."""

    goal_id = bytes(16)
    status = GoalStatus.EXECUTING
    last_feedback: Message | None = None
    is_paused = False


@pytest.fixture
def anyio_backend():
    return "asyncio"


@contextlib.asynccontextmanager
async def displayed(goal, name="/drive", turtles=("turtle1",)):
    """A transcript of an accepted goal, and what publishes where the turtles are."""
    async with open_node("stage") as node:
        publishers = {each: node.publisher(TurtlePose, f"/{each}/pose") for each in turtles}
        handle: Any = Handle()
        sent = Sent(node, name, "pkg/action/Name", goal, handle)
        yield live.GoalPicture(sent.followed()), handle, publishers


def shown(picture, width=79, height=23):
    content = picture.compose(width=width, height=height)
    return "\n".join(
        ESCAPE.sub("", line) for line in render.lines(content, width=width, height=height)
    )


async def test_progress_is_what_no_longer_remains():
    async with displayed(Fibonacci.Goal()) as (picture, handle, _):
        handle.last_feedback = Roll(remaining=-4.0)
        assert " 0%  remaining 4.00" in shown(picture)
        handle.last_feedback = Roll(remaining=1.0)
        assert "75%  remaining 1.00" in shown(picture)


async def test_what_remains_of_a_goal_that_was_sent_before_is_no_bar():
    async with displayed(Fibonacci.Goal()) as (picture, handle, _):
        picture.shown = picture.shown._replace(goal=None)
        handle.last_feedback = Roll(remaining=4.0)
        assert "  last feedback 0.0 s ago" in shown(picture)
        assert "%" not in shown(picture)


async def test_without_a_measure_progress_is_how_fresh_the_feedback_is():
    async with displayed(Fibonacci.Goal()) as (picture, handle, _):
        handle.last_feedback = Fibonacci.Feedback()
        assert re.search(r"last feedback 0\.\d s ago", shown(picture))


async def test_before_the_first_feedback_there_is_no_progress():
    async with displayed(Fibonacci.Goal()) as (picture, _, _):
        assert "no feedback yet" in shown(picture)


async def test_places_that_the_turtle_has_passed_are_counted():
    goal = Drive(targets=[Point(x=1.0, y=1.0), Point(x=9.0, y=9.0)])
    async with displayed(goal) as (picture, _, turtles):
        turtles["turtle1"].publish(TurtlePose(x=1.1, y=1.0))
        assert "50%  1 of 2 targets" in shown(picture)


async def test_places_that_the_turtle_has_passed_have_a_tick_on_the_map():
    goal = Drive(targets=[Point(x=1.0, y=1.0), Point(x=9.0, y=9.0)])
    async with displayed(goal) as (picture, _, turtles):
        turtles["turtle1"].publish(TurtlePose(x=1.0, y=1.0))
        turtles["turtle1"].publish(TurtlePose(x=5.0, y=5.0))
        [world] = re.findall(r"┌.*┘", shown(picture).replace("turtle1", ""), re.DOTALL)
        assert re.findall(r"\d✓?", world) == ["2", "1✓"]


@pytest.mark.parametrize(("theta", "is_told"), [(0.0, False), (3.1, True), (1.5, False)])
async def test_a_turtle_that_reverses_is_said_to(theta, is_told):
    async with displayed(Drive()) as (picture, _, turtles):
        for x in (1.0, 1.03):
            turtles["turtle1"].publish(TurtlePose(x=x, y=1.0, theta=theta))
        assert ("EXECUTING 0.0 s  reversing" in shown(picture)) is is_told


async def test_places_of_further_rounds_come_back():
    goal = Drive(targets=[Point(x=1.0, y=1.0)], loops=1)
    async with displayed(goal) as (picture, _, turtles):
        turtles["turtle1"].publish(TurtlePose(x=1.0, y=1.0))
        assert "1 of 2 targets" in shown(picture)
        turtles["turtle1"].publish(TurtlePose(x=1.0, y=1.0))
        assert "2 of 2 targets" in shown(picture)


async def test_all_turtles_are_on_the_map():
    async with displayed(Drive(), turtles=("turtle1", "turtle2")) as (picture, _, turtles):
        turtles["turtle1"].publish(TurtlePose(x=1.0, y=1.0))
        turtles["turtle2"].publish(TurtlePose(x=9.0, y=9.0))
        assert shown(picture).count("→") == 2


@pytest.mark.parametrize(
    ("goal", "name", "has_map"),
    [
        (Drive(), "/drive", True),
        (Drive(turtle="nobody"), "/drive", False),
        (Fibonacci.Goal(), "/fibonacci", False),
        (Fibonacci.Goal(), "/turtle1/rotate", True),
        (PatrolCommandInterface.Goal(targets=[Point()]), "/command_turtle", True),
        (PatrolCommandInterface.Goal(), "/command_turtle", False),
        (Point(), "/go", True),
    ],
)
async def test_a_goal_that_drives_a_turtle_has_a_map(goal, name, has_map):
    async with displayed(goal, name) as (picture, _, _):
        assert ("┌" in shown(picture)) is has_map


async def test_a_goal_without_a_server_is_shown_as_such():
    async with displayed(Drive()) as (picture, _, _):
        picture.is_served = False
        assert "EXECUTING (server gone) 0.0 s" in shown(picture)
        picture.has_ended = True
        assert "(server gone)" not in shown(picture)


async def test_a_paused_goal_is_shown_as_such():
    async with displayed(Drive()) as (picture, handle, _):
        assert "EXECUTING 0.0 s" in shown(picture)
        handle.is_paused = True
        assert "EXECUTING (paused) 0.0 s" in shown(picture)
        picture.has_ended = True
        assert "(paused)" not in shown(picture)


async def test_a_map_needs_a_turtle():
    async with displayed(Point(), "/go", turtles=()) as (picture, _, _):
        assert "┌" not in shown(picture)


@pytest.fixture
def stream():
    return io.StringIO()


@pytest.fixture
def transcript(stream):
    return LiveTranscript(stream, wants_feedback=True)


def test_before_the_acceptance_there_is_nothing_to_draw(transcript, stream):
    transcript.sending(Fibonacci.Goal(order=5))
    transcript.rejected("not today")
    transcript.close()
    assert stream.getvalue() == "Sending goal:\n     order: 5\n\nGoal was rejected.\n"


def test_a_goal_of_many_lines_does_not_flood_the_terminal(transcript, stream):
    transcript.sending(Drive(targets=[Point()] * 100))
    lines = stream.getvalue().splitlines()
    assert len(lines) == 1 + live.MOST_LINES + 1
    assert "     … 264 more lines …" in lines
    assert lines[-2:] == ["     turtle: turtle1", ""]


async def test_a_note_does_not_stand_in_the_display(transcript, stream, capsys):
    async with open_node("stage") as node, anyio.create_task_group() as beside:
        handle: Any = Handle()
        transcript.accepted(Sent(node, "/x", "pkg/action/Name", Fibonacci.Goal(), handle))
        beside.start_soon(transcript.animate)
        while "/x" not in stream.getvalue():
            await anyio.sleep(0.01)
        transcript.note("by the way")
        beside.cancel_scope.cancel()
    assert stream.getvalue().endswith("\x1b[?25h")
    assert capsys.readouterr().err == "turtleact: by the way\n"


async def test_the_last_state_is_drawn_before_the_result_stands(transcript, stream):
    async with open_node("stage") as node:
        handle: Any = Handle()
        transcript.accepted(Sent(node, "/x", "pkg/action/Name", Fibonacci.Goal(), handle))
        handle.status = GoalStatus.SUCCEEDED
        transcript.status(handle.status)
        transcript.ended(Outcome(GoalStatus.SUCCEEDED, Fibonacci.Result()))
        transcript.close()
    head, *_, left = ESCAPE.sub("", stream.getvalue()).partition("● ")[2].split("\n", 2)
    assert head.startswith("/x  SUCCEEDED 0.0 s")
    assert left == (
        "  no feedback yet\nResult:\n    sequence: []\n\nGoal finished with status: SUCCEEDED\n"
    )


async def test_no_frame_is_drawn_after_the_last_one(transcript, stream):
    async with open_node("stage") as node:
        transcript.accepted(
            Sent(node, "/x", "pkg/action/Name", Fibonacci.Goal(), cast("Any", Handle()))
        )
        transcript.ended(Outcome(GoalStatus.SUCCEEDED, Fibonacci.Result()))
        before = stream.getvalue()
        with anyio.move_on_after(0.05):
            await transcript.animate()
    assert stream.getvalue() == before


@pytest.mark.parametrize(("rows", "most"), [(40, 35), (20, 15), (12, 11)])
async def test_the_last_frame_leaves_room_for_the_result(
    transcript, stream, monkeypatch, rows, most
):
    monkeypatch.setattr(terminal.Region, "size", lambda _: (80, rows))
    goal = Drive(targets=[Point(x=1.0, y=1.0)])
    async with displayed(goal) as (picture, _, _):
        transcript.follows(picture.shown)
        transcript.ended(Outcome(GoalStatus.SUCCEEDED, Fibonacci.Result()))
    frame = stream.getvalue().partition("Result:")[0]
    assert min(most - 2, 27) <= frame.count("\n") <= most


# --- on a terminal --------------------------------------------------------------------------


def on_terminal(*arguments, columns=80, rows=24, **environment):
    """What a command writes to a terminal, and its exit status."""
    main, other = open_terminal(columns, rows)
    settings = {"TERM": "xterm-256color", "PYTHONUTF8": "1"} | environment
    base = {name: each for name, each in os.environ.items() if name not in ("NO_COLOR", "COLUMNS")}
    process = warm.start(
        [sys.executable, "-m", "turtleact", "send-goal", *arguments],
        stdin=other,
        stdout=other,
        stderr=subprocess.PIPE,
        env=base | settings,
    )
    os.close(other)
    written = b""
    while chunk := read(main):
        written += chunk
    os.close(main)
    assert process.stderr is not None
    process.stderr.close()
    return written.decode().replace("\r\n", "\n"), process.wait(30)


def test_a_signal_cancels_the_goal_and_its_result_stands():
    main, other = open_terminal()
    process = warm.start(
        [sys.executable, "-m", "turtleact", "send-goal", "fibonacci", "order: 40"],
        stdout=other,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"TERM": "xterm-256color", "PYTHONUTF8": "1"},
    )
    os.close(other)
    written = b""
    while b"EXECUTING" not in written:
        written += read(main)
    process.send_signal(signal.SIGINT)
    while chunk := read(main):
        written += chunk
    os.close(main)
    assert process.wait(30) == 130
    text = ESCAPE.sub("", written.decode().replace("\r\n", "\n"))
    assert "\rCanceling goal...\n\n" in text
    assert re.search(r"● /fibonacci  CANCELED .*\n(  .*\n)+Result:\n", text)
    assert text.endswith("\nGoal finished with status: CANCELED\n")


def last_frame(text):
    """The last frame that was drawn over."""
    return ESCAPE.sub("", text.rpartition("\x1b[?2026h")[2].partition("\x1b[J")[0])


def standing(text):
    """What stays on the screen from the last frame on."""
    return ESCAPE.sub("", text.rpartition(GIVE_BACK)[2])


def test_the_last_frame_and_the_result_stand_when_the_goal_has_ended():
    text, status = on_terminal("patrol", PATROL, "--speed", "max")
    frame, _, result = standing(text).partition("Result:\n")
    assert status == 0
    assert frame.startswith("● /patrol  SUCCEEDED")
    assert re.search(r"│.*[⠁-⣿].*│", frame)
    assert frame.count("✓") == 2
    assert "%" not in frame
    assert result.startswith("    reached: 2\n")
    assert result.endswith("\nGoal finished with status: SUCCEEDED\n")
    assert len(standing(text).splitlines()) < 24


def test_a_frame_leaves_room_for_lines_that_a_narrower_window_wraps():
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", rows=20)
    assert len(last_frame(text).split("\n")) <= 20 - 1 - terminal.FULL


def test_a_window_of_30_by_10_shows_no_map():
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", columns=30, rows=10)
    lines = last_frame(text).strip("\r").split("\n")
    assert len(lines) < 10
    assert max(map(len, lines)) < 30
    assert "┌" not in text


def test_feedback_that_was_asked_for_stands_above():
    text, _ = on_terminal("fibonacci", "order: 2", "-f", "--speed", "max")
    assert "Feedback:\n    partial_sequence:\n    - 0\n    - 1\n    - 1\n\n" in text


def test_no_color_is_respected():
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", NO_COLOR="1")
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]", text)


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        ([], {"TERM": "dumb"}),
        ([], {"TERM": ""}),
        ([], {"PYTHONUTF8": "0", "PYTHONIOENCODING": "latin-1"}),
        (["--plain"], {}),
        (["--json"], {}),
    ],
)
def test_where_nothing_can_or_shall_move_no_escape_sequence_is_written(arguments, environment):
    text, status = on_terminal("fibonacci", "--speed", "max", *arguments, **environment)
    assert status == 0
    assert "\x1b" not in text


async def test_a_warning_stands_above_the_display(transcript, stream, capsys):
    async with open_node("stage") as node, anyio.create_task_group() as beside:
        handle: Any = Handle()
        transcript.accepted(Sent(node, "/x", "pkg/action/Name", Fibonacci.Goal(), handle))
        beside.start_soon(transcript.animate)
        await anyio.wait_all_tasks_blocked()
        print("hit the wall", file=sys.stderr)
        assert stream.getvalue().endswith(GIVE_BACK)
        beside.cancel_scope.cancel()
    assert capsys.readouterr().err == "hit the wall\n"
