"""Live displays, on terminals of their own: what is drawn, what scrolls above, what is left."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from .ttys import HIDE, SHOW, STAGE, Terminal

PATROL = "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
ON_WINDOWS = Path(__file__).with_name("on_windows.py")


def on_terminal(*arguments, **options):
    """``send-goal`` on a terminal, to its end: what it shows, and its exit status."""
    with Terminal("send-goal", *arguments, **options) as terminal:
        status, _ = terminal.end()
        return terminal.shown, status


def standing(text):
    """What stays on the screen from the last frame on."""
    shown = text.replace("\r", "")
    return shown[shown.rindex("● /") :]


def test_the_last_frame_and_the_result_stand_when_the_goal_has_ended():
    text, status = on_terminal("patrol", PATROL, "--speed", "max")
    frame, _, result = standing(text).partition("Result:\n")
    assert status == 0
    assert re.match(r"● /patrol +SUCCEEDED \d+\.\d s +[0-9a-f]{8}\n", frame)
    assert re.search(r"│.*[⠁-⣿].*│", frame)
    assert frame.count("✓") == 2
    assert "%" not in frame
    assert result.startswith("    reached: 2\n")
    assert result.endswith("\nGoal finished with status: SUCCEEDED\n")


def test_feedback_that_was_asked_for_is_a_line_each_above():
    text, _ = on_terminal("fibonacci", "order: 3", "-f", "--speed", "10")
    lines = [line.strip() for line in text.replace("\r", "\n").splitlines()]
    told = [line for line in lines if line.startswith("Feedback: ")]
    assert told == [
        "Feedback: partial_sequence [0, 1, 1]",
        "Feedback: partial_sequence [0, 1, 1, 2]",
    ]


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        ([], {"TERM": "dumb"}),
        ([], {"PYTHONUTF8": "0", "PYTHONIOENCODING": "latin-1"}),
        (["--plain"], {}),
        (["--json"], {}),
    ],
)
def test_where_nothing_can_or_shall_move_no_escape_sequence_is_written(arguments, environment):
    line = "send-goal", "fibonacci", "--speed", "max", *arguments
    with Terminal(*line, **environment) as terminal:
        assert terminal.end() == (0, True)
        assert b"\x1b" not in terminal.written


def test_a_goal_of_many_lines_does_not_flood_the_terminal():
    targets = ", ".join(["{x: 5, y: 5}"] * 50)
    text, _ = on_terminal("patrol", f"targets: [{targets}]", "--speed", "max")
    assert re.search(r"     … \d+ more lines …\n", text)


# --- the terminal comes back ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_program_that_is_ended_gives_the_terminal_back(number, status):
    with Terminal("send-goal", "hold", program=STAGE) as screen:
        screen.wait_for("EXECUTING")
        assert not screen.echoes
        screen.process.send_signal(number)
        assert screen.end() == (status, True)
        assert screen.written.rindex(SHOW) > screen.written.rindex(HIDE)
        assert screen.shown.rstrip().endswith("Goal finished with status: CANCELED")


def test_a_program_that_lets_go_of_its_goal_gives_the_terminal_back():
    with Terminal("send-goal", "stubborn", program=STAGE) as screen:
        screen.wait_for("EXECUTING")
        screen.process.send_signal(signal.SIGINT)
        screen.wait_for("Canceling goal")
        screen.process.send_signal(signal.SIGINT)
        assert screen.end() == (130, True)
        assert screen.written.rindex(SHOW) > screen.written.rindex(HIDE)


def test_ctrl_z_does_not_stop_a_program_in_the_middle_of_a_display():
    with Terminal("send-goal", "hold", program=STAGE) as screen:
        screen.wait_for("EXECUTING")
        assert termios.tcgetattr(screen.main)[6][termios.VSUSP] == b"\0"


def test_a_terminal_that_goes_away_ends_the_program():
    with Terminal("send-goal", "hold", program=STAGE) as screen:
        screen.wait_for("EXECUTING")
        os.close(screen.main)
        screen.main = os.open(os.devnull, os.O_RDONLY)
        screen.process.send_signal(signal.SIGHUP)
        assert screen.process.wait(30) in (129, 141)


# --- keys -----------------------------------------------------------------------------------


def test_p_pauses_and_resumes_the_goal():
    with Terminal("send-goal", "fibonacci", "order: 40") as screen:
        screen.wait_for("EXECUTING")
        os.write(screen.main, b"x\x1b[AP")  # an arrow means nothing here
        screen.wait_for("  paused")
        os.write(screen.main, b"p")
        screen.written = b""
        screen.wait_for(r"EXECUTING \d+\.\d s +[0-9a-f]{8}")


# --- Windows --------------------------------------------------------------------------------


def test_every_module_is_imported_without_posix():
    import turtleact

    said = subprocess.check_output([sys.executable, ON_WINDOWS], text=True, timeout=60)
    files = Path(turtleact.__file__).parent.rglob("*.py")
    assert len(said.splitlines()) == len([each for each in files if each.name != "__main__.py"]) - 1


def test_a_goal_is_sent_without_posix():
    ran = subprocess.run(
        [sys.executable, ON_WINDOWS, "send-goal", "now", "--plain"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "Goal finished with status: SUCCEEDED" in ran.stdout, ran.stderr
