"""``serve`` on a terminal: its dashboard, and lines where that is not wanted or cannot be."""

from __future__ import annotations

import os
import re
import signal
import sys
from contextlib import suppress

import pytest

from .. import warm
from ..lab import free_endpoint
from .ttys import Terminal

PATIENCE = 30.0


class Served(Terminal):
    """A server on a terminal."""

    def __init__(self, *arguments, columns=100, rows=40, **environment):
        self.at = free_endpoint()
        line = "serve", "--listen", self.at, *arguments
        super().__init__(*line, columns=columns, rows=rows, ROS_DOMAIN_ID="0", **environment)

    def send_goal(self, name="go_to", goal="{x: 7, y: 7}", *options):
        """The exit status of a goal that is sent to it, and what is said of it."""
        arguments = ["send-goal", name, goal, "--plain", "--connect", self.at, *options]
        sent = warm.run(
            [sys.executable, "-m", "turtleact", *arguments],
            env=os.environ | {"ROS_DOMAIN_ID": "0"},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        return sent.returncode, sent.stdout + sent.stderr

    def stop(self):
        """Stop the server, and give its exit status and all that it has shown."""
        self.process.terminate()
        return self.end()[0], self.shown


def fill(terminal):
    """Write until a terminal takes nothing more."""
    descriptor = os.open(terminal, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    with suppress(BlockingIOError):
        while os.write(descriptor, b"x" * 4096):
            pass
    os.close(descriptor)


def test_a_terminal_shows_a_dashboard_and_is_given_back_with_what_has_happened():
    with Served("--speed", "100") as served:
        served.wait_for("no goals yet")
        assert not served.echoes
        assert served.send_goal()[0] == 0
        served.wait_for("SUCCEEDED")
        status, text = served.stop()
    assert status == 0
    assert b"\x1b[?1049h" not in served.written
    said = text.replace("\r", "\n")
    assert re.findall(r"\d\d:\d\d:\d\d /go_to [0-9a-f]{8} (\w+)\n", said) == [
        "ACCEPTED",
        "EXECUTING",
        "SUCCEEDED",
    ]
    _, _, left = said.rpartition("running goals are ended")
    assert f"ready at {served.at}, domain 0: /command_turtle, " in left
    assert re.search(r"● /go_to\s+│?⠀*│?\s*SUCCEEDED", left)
    assert "turtle1" in left


def test_a_wide_dashboard_has_a_row_for_each_goal_with_its_turtle_and_its_targets():
    with Served("--speed", "10", "--turtles", "2", columns=140, NO_COLOR="1") as served:
        served.wait_for("no goals yet")
        sent = served.send_goal("turtle1/rotate_absolute", "{theta: 1.0}")
        assert sent[0] == 0, sent
        patrol = "{targets: [{x: 9, y: 9}, {x: 2, y: 2}], turtle: turtle2, loops: 1000}"
        sent = served.send_goal("patrol", patrol, "-t", "0")
        assert sent[0] == 0, sent
        served.wait_for("of 2002 targets  turtle2")
        _, text = served.stop()
    said = text.replace("\r", "\n")
    row = r"\d+\.\d s +[0-9a-f]{8}"
    targets = r"\d+ of 2002 targets +turtle2"
    assert re.search(rf"● /patrol +EXECUTING +{row} +{targets} 1✓? 2", said)
    left = said.rpartition("running goals are ended")[2]
    assert re.search(rf"● /patrol +ABORTED +{row} +{targets} *\n", left)
    assert re.search(rf"● /turtle1/rotate_absolute +SUCCEEDED +{row} +turtle1 *\n", left)


def test_a_terminal_that_takes_nothing_does_not_hold_up_the_world():
    with Served("--speed", "100") as served:
        served.wait_for("no goals yet")
        fill(served.name)
        status, said = served.send_goal()
        assert (status, said.endswith("status: SUCCEEDED\n")) == (0, True)
        served.process.terminate()
        served.process.send_signal(signal.SIGINT)
        assert served.process.wait(PATIENCE) == 0


COUNTING = """
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "count")
async def count(goal):
    for number in range(goal.order):
        print("step", number)
    yield Fibonacci.Result()
"""


def test_all_that_a_body_prints_is_shown_above_the_dashboard(tmp_path):
    (tmp_path / "lab.py").write_text(COUNTING)
    with Served(str(tmp_path / "lab.py"), "--speed", "100") as served:
        served.wait_for("no goals yet")
        assert served.send_goal("count", "order: 3")[0] == 0
        for number in range(3):
            served.wait_for(f"step {number}")


@pytest.mark.parametrize(
    ("option", "environment"),
    [(["--plain"], {}), (["--headless"], {}), ([], {"TERM": "dumb"})],
)
def test_lines_are_written_where_nothing_can_or_shall_move(option, environment):
    with Served("--no-sim", *option, **environment) as served:
        served.wait_for("ready at")
        assert served.echoes
        assert served.stop() == (
            0,
            f"ready at {served.at}, domain 0: no actions\n"
            "turtleact: no more goals are accepted; running goals are ended\n",
        )


def test_without_a_world_there_is_no_map():
    with Served("--no-sim", columns=60, rows=20, NO_COLOR="1") as served:
        served.wait_for("no goals yet")
        status, text = served.stop()
    assert status == 0
    assert "┌" not in text
    assert not re.search(rb"\x1b\[[0-9;]*3[0-9]", served.written)
