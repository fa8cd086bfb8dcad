"""The dashboard of ``serve``: what is on it, and that nothing waits for it."""

from __future__ import annotations

import io
import logging
import re
import sys
from contextlib import asynccontextmanager

import anyio
import pytest

import turtleact
from turtleact import open_world, render
from turtleact.actions.patrol import Patrol
from turtleact.commands import live, terminal
from turtleact.commands.live import Dashboard
from turtleact.commands.serve import ServerLog
from turtleact.commands.terminal import GIVE_BACK
from turtleact.interfaces.standard import Fibonacci, Point, RotateAbsolute, SetPen, Twist, Vector3

ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|[78])")
READY = "ready at tcp/127.0.0.1:7447, domain 0: /patrol"


@pytest.fixture
def anyio_backend():
    return "asyncio"


@asynccontextmanager
async def served(stream=None, **options):
    """A dashboard, and a node in the world that it shows."""
    board = Dashboard(stream or io.StringIO())
    log = ServerLog(board)
    log.say(READY)
    world = open_world(speed="max", on_start=board.begin, on_transition=log.tell, **options)
    async with world as node:
        yield board, node


def shown(board, width=99, height=37):
    content = board.compose(width=width, height=height)
    return [ESCAPE.sub("", line) for line in render.lines(content, width=width, height=height)]


def world_of(lines):
    """What is between the walls."""
    return "".join(line[1 : line.index("│", 1)] for line in lines if line.startswith("│"))


async def test_the_line_that_says_it_is_ready_is_always_there():
    async with served() as (board, _):
        assert shown(board)[0] == READY
        assert shown(board, width=59, height=10)[0].startswith("ready at tcp/127.0.0.1:7447")


async def test_a_paused_world_is_called_paused():
    async with served(paused=True) as (board, node):
        assert shown(board)[1] == "the world is paused"
        node.resume()
        assert "the world is paused" not in shown(board)


async def test_all_turtles_are_on_the_map_with_their_names():
    async with served(turtles=3) as (board, _):
        world = world_of(shown(board))
    assert all(f"turtle{number}" in world for number in (1, 2, 3))


async def test_a_trail_has_the_colour_of_the_pen(monkeypatch):
    monkeypatch.setenv("COLORTERM", "truecolor")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    async with served() as (board, node):
        pen = node.service_client(SetPen, "turtle1/set_pen")
        await pen.call(SetPen.Request(r=200, g=100, b=50, width=3))
        node.publisher(Twist, "turtle1/cmd_vel").publish(Twist(Vector3(x=2.0), Vector3()))
        await node.clock.sleep(1.0)
        content = render.lines(board.compose(width=99, height=37), width=99, height=37)
    assert re.search(r"\x1b\[38;2;200;100;50m[⠁-⣿]+", "".join(content))


async def test_a_drawing_is_where_the_turtle_has_been():
    async with served() as (board, node):
        node.publisher(Twist, "turtle1/cmd_vel").publish(Twist(Vector3(x=2.0), Vector3()))
        await node.clock.sleep(1.1)
        [line] = [line for line in shown(board) if "→" in line]
    assert re.search(r"^│⠀+[⠁-⣿]{5,}→", line)


async def test_a_goal_that_runs_is_told_with_its_state_age_and_progress():
    async with served() as (board, node):
        client = node.action_client(Patrol, "/patrol")
        targets = [Point(x=6.0, y=5.5), Point(x=1.0, y=1.0)]
        async with client.send_goal(Patrol.Goal(targets=targets)) as goal:
            await node.clock.sleep(2.0)
            lines = shown(board, width=140)
            assert re.search(
                rf"● /patrol +EXECUTING +2\.0 s  {goal.goal_id.hex()[:8]}  1 of 2 targets",
                "\n".join(lines),
            )
            assert "2" in world_of(lines).replace("turtle1", "")


async def test_goals_that_are_paused_or_resumed_are_marked(tmp_path):
    goal_id = bytes(range(16))
    for mark in ("paused", "resumed, paused", "resumed"):
        async with (
            turtleact.open_journal(tmp_path / "goals.db") as journal,
            served(journal=journal, on_restart="resume") as (board, node),
        ):
            goal = Patrol.Goal(targets=[Point(x=9.0, y=9.0), Point(x=1.0, y=1.0)])
            async with node.action_client(Patrol, "/patrol").send_goal(goal, goal_id=goal_id) as it:
                await (it.resume() if mark == "resumed" else it.pause())
                assert shown(board, width=160)[1].endswith(f"turtle1 1 2  {mark}")
                it.detach()


async def test_at_60_columns_each_goal_has_its_full_name_turtle_and_targets():
    async with served(turtles=3) as (board, node):
        patrol = node.action_client(Patrol, "/patrol")
        turn = node.action_client(RotateAbsolute, "/turtle3/rotate_absolute")
        two = [Point(x=9.0, y=9.0), Point(x=1.0, y=1.0)]
        async with (
            patrol.send_goal(Patrol.Goal(targets=[Point(x=6.0, y=5.5), *two])),
            patrol.send_goal(Patrol.Goal(targets=two, turtle="turtle2")),
            turn.send_goal(RotateAbsolute.Goal(3.0)),
        ):
            await node.clock.sleep(1.0)
            lines = shown(board, width=59, height=30)
    table = [line.rpartition("│ ")[2] for line in lines if "│ " in line or "┐ " in line]
    assert [line.rpartition("┐ ")[2] for line in table[:9]] == [
        "● /turtle3/rotate_absolute",
        "  EXECUTING  1.0 s",
        "  turtle3",
        "● /patrol",
        "  EXECUTING  1.0 s",
        "  turtle2 1 2",
        "● /patrol",
        "  EXECUTING  1.0 s",
        "  turtle1 1✓ 2 3",
    ]


async def test_targets_have_the_colour_of_the_turtle_that_heads_for_them(monkeypatch):
    boards: list[render.Board] = []
    monkeypatch.setattr(render, "board", lambda view, **_: boards.append(view))
    async with served(turtles=2) as (board, node):
        patrol = node.action_client(Patrol, "/patrol")
        goals = [Patrol.Goal([Point(x=n, y=n)], turtle=f"turtle{n}") for n in (1, 2)]
        async with patrol.send_goal(goals[0]), patrol.send_goal(goals[1]):
            board.compose(width=59, height=30)
    world = boards[0].world
    assert world is not None
    colours = {turtle.name: turtle.colour for turtle in world.turtles}
    assert {f"turtle{target.x:g}": target.colour for target in world.targets} == colours
    assert {row.turtle: row.colour for row in boards[0].goals or ()} == colours
    assert len(set(colours.values())) == 2


async def test_a_turtle_that_reverses_is_said_to_in_its_row():
    async with served() as (board, node):
        goal = Patrol.Goal(targets=[Point(x=4.1, y=5.5)])
        async with node.action_client(Patrol, "/patrol").send_goal(goal):
            await node.clock.sleep(0.3)
            assert any(line.endswith("turtle1 1  reversing") for line in shown(board))


async def test_a_goal_that_has_ended_stays_below_those_that_run():
    async with served() as (board, node):
        turn = node.action_client(RotateAbsolute, "/turtle1/rotate_absolute")
        async with turn.send_goal(RotateAbsolute.Goal(3.0)):
            await node.action_client(Fibonacci, "/fibonacci").send_goal(Fibonacci.Goal(order=1))
            told = re.findall(r"● (\S+) +(\w+)", "\n".join(shown(board)))
    assert told == [("/turtle1/rotate_absolute", "EXECUTING"), ("/fibonacci", "SUCCEEDED")]


async def test_the_places_of_a_goal_that_has_ended_are_gone():
    async with served() as (board, node):
        goal = Patrol.Goal(targets=[Point(x=6.0, y=5.5)])
        await node.action_client(Patrol, "/patrol").send_goal(goal)
        assert not re.search(r"\d", world_of(shown(board)).replace("turtle1", ""))


async def test_each_change_of_a_goal_is_a_line_of_the_log():
    async with served() as (board, node):
        async with node.action_client(Fibonacci, "/fibonacci").send_goal(
            Fibonacci.Goal(order=1)
        ) as goal:
            await goal.outcome()
        changes = [line for line in shown(board) if re.match(r"\d\d:\d\d:\d\d ", line)]
        assert [line.split()[1:] for line in changes] == [
            ["/fibonacci", goal.goal_id.hex()[:8], state]
            for state in ("ACCEPTED", "EXECUTING", "SUCCEEDED")
        ]


async def test_only_so_many_goals_that_have_ended_are_kept(monkeypatch):
    monkeypatch.setattr(live, "MOST_ENDED", 2)
    async with served() as (board, node):
        client = node.action_client(Fibonacci, "/fibonacci")
        for _ in range(3):
            await client.send_goal(Fibonacci.Goal(order=1))
        assert len([line for line in shown(board) if "●" in line]) == 2


async def test_what_is_printed_and_warned_of_is_in_the_log(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    logger = logging.getLogger("dashboard_test")
    monkeypatch.setattr(logger, "propagate", False)  # to the handlers of pytest
    async with served() as (board, _):
        with board.listening():
            print("from a body")
            logger.warning("beware")
            print("\x1b[2Jnasty", file=sys.stderr)
        lines = shown(board)
    assert "from a body" in lines
    assert "beware" in lines
    assert "·[2Jnasty" in lines


async def test_only_what_the_last_reload_said_is_in_the_log():
    async with served() as (board, _):
        log = ServerLog(board)
        with log.hearing_reloads():
            for problem in ("lab.py:10: SyntaxError", "lab.py:12: SyntaxError"):
                log.reload("reloading: lab.py changed")
                logging.getLogger("turtleact.reload").error(problem)
            assert shown(board)[-1].endswith(" lab.py:12: SyntaxError")
            log.reload("reloading: lab.py changed")
            log.reload("reloaded: /mine")
        lines = shown(board)
    assert lines[0] == READY
    assert not [line for line in lines if "SyntaxError" in line or "reloading" in line]
    assert re.fullmatch(r"\d\d:\d\d:\d\d reloaded: /mine", lines[-1])


async def test_an_error_at_the_start_is_in_the_log_until_a_reload():
    async with served() as (board, _):
        log = ServerLog(board)
        log.complain("lab.py:10: SyntaxError")
        assert shown(board)[-1].endswith(" lab.py:10: SyntaxError")
        log.reload("reloaded: /mine")
        assert not [line for line in shown(board) if "SyntaxError" in line]


async def test_an_error_that_comes_again_is_the_newest_line_again():
    async with served() as (board, _):
        log = ServerLog(board)
        with log.hearing_reloads(), board.listening():
            for _ in range(2):
                logging.getLogger("turtleact.reload").error("lab.py:10: SyntaxError")
                print("between")
            logging.getLogger("turtleact.reload").error("lab.py:10: SyntaxError")
        lines = shown(board)
    assert [line.endswith("SyntaxError") for line in lines[-2:]] == [False, True]


def test_what_is_printed_before_there_is_a_dashboard_goes_to_stderr(capsys):
    board = Dashboard(io.StringIO())
    with board.listening():
        print("too early")
    assert capsys.readouterr() == ("", "too early\n")


async def test_a_line_of_the_log_is_shown_before_the_server_is_ready(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    stream = io.StringIO()
    board = Dashboard(stream)
    with board.listening():
        async with anyio.create_task_group() as beside:
            beside.start_soon(board.run)
            await anyio.wait_all_tasks_blocked()
            assert not stream.getvalue()
            print("waiting until that has gone", file=sys.stderr)
            with anyio.fail_after(5):
                while "waiting until that has gone" not in stream.getvalue():
                    await anyio.sleep(0.01)
            beside.cancel_scope.cancel()
    assert "not ready yet" in stream.getvalue()
    assert stream.getvalue().rpartition(GIVE_BACK)[2] == "waiting until that has gone\n"


async def test_a_reload_renews_the_line_that_says_it_is_ready():
    lines = iter(["ready: /first", "ready: /first", "ready: /second"])
    board = Dashboard(io.StringIO())
    log = ServerLog(board)
    log.reload("lab.py:10: SyntaxError")
    log.say("web page, and rosbridge, at http://127.0.0.1:9090")
    log.ready(lambda: next(lines))
    log.reload("reloading: lab.py changed")
    log.reload("reloaded: /second")
    assert [line.rstrip() for line in shown(board)[:2]] == [
        "web page, and rosbridge, at http://127.0.0.1:9090",
        "ready: /second",
    ]


async def test_its_lines_are_left_standing():
    stream = io.StringIO()
    async with served(stream) as (board, node):
        async with anyio.create_task_group() as beside:
            beside.start_soon(board.run)
            client = node.action_client(Fibonacci, "/fibonacci")
            async with client.send_goal(Fibonacci.Goal(order=1)) as goal:
                await goal.outcome()
            beside.cancel_scope.cancel()
        left = stream.getvalue().rpartition(GIVE_BACK)[2].splitlines()
    assert left[0] == READY
    assert [line.split()[1:] for line in left[1:]] == [
        ["/fibonacci", goal.goal_id.hex(), state]
        for state in ("ACCEPTED", "EXECUTING", "SUCCEEDED")
    ]


async def test_a_terminal_that_goes_away_ends_the_drawing_and_nothing_else(monkeypatch):
    def draw(*_):
        raise OSError(5, "gone")

    async with served() as (board, _):
        monkeypatch.setattr(terminal, "draw", draw)
        await board.run()


async def test_many_goals_are_counted(monkeypatch):
    monkeypatch.setattr(live, "MOST_GOALS", 2)
    async with served() as (board, node):
        client = node.action_client(Fibonacci, "/fibonacci")
        for _ in range(4):
            await client.send_goal(Fibonacci.Goal(order=1))
        lines = shown(board)
        assert len([line for line in lines if "●" in line]) == 2
        assert any(line.endswith("… 2 more") for line in lines)


async def test_the_last_place_counts_though_no_frame_was_drawn_since():
    async with served() as (board, node):
        client = node.action_client(Patrol, "/patrol")
        await client.send_goal(Patrol.Goal(targets=[Point(x=6.0, y=5.5)]))
        assert any("SUCCEEDED" in line and "1 of 1 targets" in line for line in shown(board, 140))


async def test_only_so_many_turtles_are_followed_on_their_way(monkeypatch):
    monkeypatch.setattr(live, "MOST_TURTLES", 1)
    async with served(turtles=2) as (board, node):
        client = node.action_client(Patrol, "/patrol")
        targets = [Point(x=6.0, y=5.5)]
        for sent in (1, 2):  # the goals of the first round have ended in the second
            async with (
                client.send_goal(Patrol.Goal(targets=targets)),
                client.send_goal(Patrol.Goal(targets=targets, turtle="turtle2")),
            ):
                lines = shown(board, width=140)
                assert sum("of 1 targets" in line for line in lines) == sent
